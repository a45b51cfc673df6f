"""Next-event estimation for a time gate: resampled emitter samples."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..records import BSDFEval, Connection, Hit, Path, Vertex
from .emitters import EmitterEndpoint, power_heuristic

# Emitter samples per connection. Only the chosen sample needs a shadow ray
CANDIDATES = 8


class GatedEmitters(EmitterEndpoint):
    """Abstract base of the gated endpoints: resampled emitter samples.

    This is resampled importance sampling (Talbot et al. 2005). The endpoint samples `CANDIDATES`
    emitter samples, and chooses one of them in proportion to its target t. The target is the
    unoccluded contribution through the gate:

        t_k = (radiance / density)_k |cos| gate(opl_k)

    The radiance over density of the chosen sample is then multiplied by
    (sum of all t) / (`CANDIDATES` t_k). The estimate is unbiased for measurements that multiply
    contributions by the gate. The candidates are the points of a Hammersley set that is shifted by
    one random vector.

    Args:
        scene: The scene. Rough glass is not supported, because the index of refraction behind rough
            glass depends on the direction.
        sensor: As in `SceneLights`.
        gate: Weight [1/m] as a function of optical path length [m].
        hide_emitters: As in `SceneLights`.
        discard_direct_light: As in `SceneLights`.
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
        """Sample candidates, and choose one of them in proportion to its target."""
        shift = sampler.next_2d()
        xi = sampler.next_1d()

        # Sum of the targets so far, the chosen candidate, and its target
        total = mi.Float(0)
        chosen = None
        t_chosen = mi.Float(0)
        for k in range(CANDIDATES):
            # Sample the candidate, and find its target
            u = shift + mi.Point2f(k / CANDIDATES, _radical_inverse(k))
            connection = self.sample_emitter(vertex, u - dr.floor(u), active)
            t = (
                dr.max(connection.weight)
                * _cosine(vertex, connection.direction)
                * self.gate(dr.fma(path.η, connection.length, path.opl))
            )
            t = dr.select(connection.active & dr.isfinite(t), t, 0)

            # Accept the candidate with the probability t / total. Rescale the random number, so
            # that the same number is uniform again for the next candidate
            total += t
            p = dr.select(t > 0, t / total, 0)
            accept = xi < p
            xi = dr.select(accept, xi / p, (xi - p) / (1 - p))
            chosen = connection if chosen is None else dr.select(accept, connection, chosen)
            t_chosen = dr.select(accept, t, t_chosen)

        # Weight the chosen candidate
        assert chosen is not None
        chosen.active = active & (t_chosen > 0)
        chosen.weight *= dr.select(chosen.active, total / (CANDIDATES * t_chosen), 0)
        return chosen

    def mis_weight(
        self, path: Path, vertex: Vertex, connection: Connection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return the power heuristic against BSDF samples, 1 for emitters that rays cannot hit."""
        weight = power_heuristic(connection.pdf, bsdf_eval.pdf)
        return dr.select(connection.delta, 1, weight)

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the power heuristic against emitter samples, 1 after delta lobes."""
        return dr.select(path.specular, mi.Float(1), power_heuristic(path.pdf, hit.pdf))


class GatedLights(GatedEmitters):
    """Next-event estimation of light that arrives while a gate is open, see `GatedEmitters`."""

    connect = GatedEmitters.resample


def _cosine(vertex: Vertex, direction: mi.Vector3f) -> mi.Float:
    """Return the unsigned cosine between a direction and the shading normal, 1 in a medium."""
    cos = dr.abs(dr.dot(direction, vertex.si.sh_frame.n))
    return cos if vertex.in_medium is None else dr.select(vertex.in_medium.here, 1, cos)


def _radical_inverse(k: int) -> float:
    """Return the radical inverse of `k` in base 2."""
    return int(f"{k:032b}"[::-1], 2) / 2**32
