"""The light strategy of a gate: connections to points whose light comes when the gate is open."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..records import Connection, Path, Vertex
from .scene_lights import SceneLights

CANDIDATES = 8
"""Points on lights that a connection is chosen from; only the chosen one costs a shadow ray."""


class GatedLights(SceneLights):
    """Next-event estimation that looks for light of the right path length.

    Resampled importance sampling (Talbot et al. 2005): of `CANDIDATES` points on lights, one is
    taken with a probability in proportion to its target t, the light it would give if nothing were
    in the way, seen through the gate:

        t_k = (radiance / density)_k |cos| gate(opl_k)

    Its radiance over density is then multiplied by (sum of all t) / (candidates t_k). That is
    unbiased for everything that is multiplied by the gate, and for nothing else. The candidates
    are the points of a Hammersley set, moved together by one random number.

    Args:
        scene: The scene, without rough glass, behind which a connection's index depends on where
            it goes.
        sensor: As in `SceneLights`.
        gate: Takes an optical path length [m], gives its weight [1/m].
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

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """A point on a light that the gate is likely to see."""
        shift, xi = sampler.next_2d(), sampler.next_1d()
        total, t_chosen = mi.Float(0), mi.Float(0)
        chosen: Any = None
        for k in range(CANDIDATES):
            u = shift + mi.Point2f(k / CANDIDATES, _radical_inverse(k))
            link = self.choose(vertex, u - dr.floor(u), active)
            t = (
                dr.max(link.weight)
                * _cosine(vertex, link.direction)
                * self.gate(dr.fma(path.η, link.length, path.opl))
            )
            t = dr.select(link.active & dr.isfinite(t), t, 0)

            # One random number chooses among all: what is left of it is uniform again
            total += t
            share = dr.select(t > 0, t / total, 0)
            take = xi < share
            xi = dr.select(take, xi / share, (xi - share) / (1 - share))
            chosen = link if chosen is None else dr.select(take, link, chosen)
            t_chosen = dr.select(take, t, t_chosen)

        chosen.active = active & (t_chosen > 0)
        chosen.weight *= dr.select(chosen.active, total / (CANDIDATES * t_chosen), 0)
        return chosen


def _cosine(vertex: Vertex, direction: mi.Vector3f) -> mi.Float:
    """Cosine of a direction at a surface; 1 in a medium, which has none."""
    n: Any = vertex.si.sh_frame.n
    cos = dr.abs(dr.dot(direction, n))
    return cos if vertex.inside is None else dr.select(vertex.inside.here, 1, cos)


def _radical_inverse(k: int) -> float:
    """The digits of `k` to the base 2, mirrored at the binary point."""
    return int(f"{k:032b}"[::-1], 2) / 2**32
