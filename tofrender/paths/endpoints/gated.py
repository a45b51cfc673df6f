"""Next-event estimation for a time gate: resampled emitter samples."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..records import BSDFEval, Connection, Hit, Path, Vertex
from .emitters import EmitterEndpoint, power_heuristic

# Emitter samples that a connection is resampled from; only the chosen one costs a shadow ray
CANDIDATES = 8


class GatedEmitters(EmitterEndpoint):
    """Abstract base of the gated techniques: resampled emitter samples.

    Resampled importance sampling (Talbot et al. 2005): of `CANDIDATES` emitter samples, one is
    chosen in proportion to its target t, its unoccluded contribution seen through the gate:

        t_k = (radiance / density)_k |cos| gate(opl_k)

    Its radiance over density is then multiplied by (sum of all t) / (candidates t_k). That is
    unbiased for what is multiplied by the gate only. The candidates are the points of a Hammersley
    set, shifted together by one random number.

    Args:
        scene: The scene, without rough glass, behind which the index depends on the direction.
        sensor: As in `SceneLights`.
        gate: Weight [1/m] as a function of optical path length [m].
        hide_emitters, discard_direct_light: As in `SceneLights`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None,
        gate: Callable[[mi.Float], mi.Float],
        hide_emitters: bool = False,
        discard_direct_light: bool = False,
    ) -> None:
        super().__init__(scene, sensor, hide_emitters, discard_direct_light)
        self.gate = checks.function("gate", gate)

    def resample(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Choose one of several emitter samples by what the gate sees of them."""
        shift, xi = sampler.next_2d(), sampler.next_1d()
        total, t_chosen = mi.Float(0), mi.Float(0)
        chosen = None
        for k in range(CANDIDATES):
            u = shift + mi.Point2f(k / CANDIDATES, _radical_inverse(k))
            connection = self.sample_emitter(vertex, u - dr.floor(u), active)
            t = (
                dr.max(connection.weight)
                * _cosine(vertex, connection.direction)
                * self.gate(dr.fma(path.η, connection.length, path.opl))
            )
            t = dr.select(connection.active & dr.isfinite(t), t, 0)

            # One random number chooses among all: what remains of it is uniform again
            total += t
            p = dr.select(t > 0, t / total, 0)
            accept = xi < p
            xi = dr.select(accept, xi / p, (xi - p) / (1 - p))
            chosen = connection if chosen is None else dr.select(accept, connection, chosen)
            t_chosen = dr.select(accept, t, t_chosen)

        assert chosen is not None
        chosen.active = active & (t_chosen > 0)
        chosen.weight *= dr.select(chosen.active, total / (CANDIDATES * t_chosen), 0)
        return chosen

    def mis_weight(
        self, path: Path, vertex: Vertex, connection: Connection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return the power heuristic against BSDF samples; 1 for emitters that cannot be hit."""
        weight = power_heuristic(connection.pdf, bsdf_eval.pdf)
        return dr.select(connection.delta, 1, weight)

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the power heuristic against emitter samples; 1 after delta lobes."""
        return dr.select(path.specular, mi.Float(1), power_heuristic(path.pdf, hit.pdf))


class GatedLights(GatedEmitters):
    """Next-event estimation whose light arrives while a gate is open, see `GatedEmitters`."""

    connect = GatedEmitters.resample


def _cosine(vertex: Vertex, direction: mi.Vector3f) -> mi.Float:
    """Return the cosine to the shading normal; 1 in a medium."""
    cos = dr.abs(dr.dot(direction, vertex.si.sh_frame.n))
    return cos if vertex.in_medium is None else dr.select(vertex.in_medium.here, 1, cos)


def _radical_inverse(k: int) -> float:
    """Return the radical inverse of `k` to the base 2."""
    return int(f"{k:032b}"[::-1], 2) / 2**32
