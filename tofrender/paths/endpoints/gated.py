"""The light strategy of a gate: connections to points whose light comes when the gate is open."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

from .scene_lights import Connection, PathState, SceneLights

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
    """

    def __init__(
        self, scene: mi.Scene, sensor: mi.Sensor | None, gate: Callable[[mi.Float], mi.Float]
    ) -> None:
        super().__init__(scene, sensor)
        self.gate = gate

    def connect(
        self,
        si: mi.SurfaceInteraction3f,
        path: PathState,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Sample a point on a light that the gate is likely to see, as a whole lane at a time."""
        shift, xi = sampler.next_2d(), sampler.next_1d()
        total, t_chosen = mi.Float(0), mi.Float(0)
        chosen, end = dr.zeros(Connection), mi.Point3f(0)
        for k in range(CANDIDATES):
            u = shift + mi.Point2f(k / CANDIDATES, _radical_inverse(k))
            em, p = self.choose(si, u - dr.floor(u), False, active)
            cos = dr.abs(dr.dot(em.direction, si.sh_frame.n))
            t = dr.max(em.weight) * cos * self.gate(dr.fma(path.η, em.length, path.opl))
            t = dr.select(em.active & dr.isfinite(t), t, 0)

            # One random number chooses among all: what is left of it is uniform again
            total += t
            share = dr.select(t > 0, t / total, 0)
            take = xi < share
            xi = dr.select(take, xi / share, (xi - share) / (1 - share))
            chosen, end = dr.select(take, em, chosen), dr.select(take, p, end)
            t_chosen = dr.select(take, t, t_chosen)

        seen = active & (t_chosen > 0)
        seen &= ~self.scene.ray_test(si.spawn_ray_to(end), seen)
        chosen.weight *= dr.select(seen, total / (CANDIDATES * t_chosen), 0)
        chosen.active = seen
        return chosen


def _radical_inverse(k: int) -> float:
    """The digits of `k` to the base 2, mirrored at the binary point."""
    return int(f"{k:032b}"[::-1], 2) / 2**32
