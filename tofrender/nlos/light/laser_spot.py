"""The light strategy of a scanned laser: the point of a wall that it lights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ...paths.endpoints.scene_lights import Connection, PathState
from ...paths.targets import is_on

SAME = 1e-10
"""Squared distance of two points, over that to a third, below which they are one."""


@dataclass
class Spot:
    """Where a laser beam lands.

    Attributes:
        si: The lit surface point, `si.wi` towards the laser; one, or one for each lane.
        power: Power that arrives there, the cosine included [W].
        distance: Optical length from the laser to the point that counts in path lengths [m].
    """

    si: mi.SurfaceInteraction3f
    power: Any
    distance: mi.Float

    @classmethod
    def of_beam(
        cls, scene: mi.Scene, ray: mi.Ray3f, power: Any, active: mi.Bool = True, origin: Any = None
    ) -> Spot:
        """Follow a beam to the first surface; the power is 0 where there is none.

        Args:
            scene: The scene.
            ray: The beam.
            power: What it carries [W].
            active: Lanes in which there is a beam.
            origin: Point from which the distance counts, by default where the ray starts.
        """
        si = scene.ray_intersect(ray, active)
        power = dr.select(si.is_valid(), power, 0)
        return cls(si, power, dr.norm(si.p - (ray.o if origin is None else origin)))


class LaserSpot:
    """Connections to the lit point, a point light whose light has left the laser before.

    A laser of power Phi [W] that lands on p makes it a source of intensity

        I(w) = Phi f_p(w_laser, w) cos_p   [W/sr]

    so that a connection from y at the distance r receives I / r^2 and has the optical length
    r + |p - laser|. Nothing else finds the light: rays that run into the lit wall see none.

    Args:
        scene: The scene.
        beam: Takes a sampler and the active lanes, gives the `Spot`. It is called for each
            connection: a beam with a width lands on another point each time.
        wall: Shapes of the relay wall; needed for `hidden_only`.
        hidden_only: Whether only paths count that have met something else than the wall.
        bounces: Count only paths of so many surface points, the lit one included; -1 means all.

    Attributes:
        shared: Takes a vertex and its `PathState`, gives the share of its connection that counts
            where another technique finds the same paths; None if nothing else does.
    """

    connects = True
    finds_all = True

    def __init__(
        self,
        scene: mi.Scene,
        beam: Callable[[mi.Sampler, mi.Bool], Spot],
        wall: Sequence[mi.Shape] = (),
        hidden_only: bool = False,
        bounces: int = -1,
    ) -> None:
        self.scene, self.beam = scene, beam
        self.wall, self.hidden_only, self.bounces = list(wall), hidden_only, bounces
        self.shared: Callable[[mi.SurfaceInteraction3f, PathState], mi.Float] | None = None

    def remember(self, memory: mi.Bool, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Whether a vertex so far, `si` included, is off the wall."""
        return memory | (active & ~is_on(si, self.wall)) if self.hidden_only else memory

    def connect(
        self,
        si: mi.SurfaceInteraction3f,
        path: PathState,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Connect to the lit point, with its shadow ray; the share of it that counts here."""
        em = self.lit(si, path, sampler, active)
        if self.shared is not None:
            em.weight *= self.shared(si, path)
        return em

    def lit(
        self,
        si: mi.SurfaceInteraction3f,
        path: PathState,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Connect to the lit point, with its shadow ray."""
        if self.bounces >= 0:
            active = active & (path.depth + 2 == self.bounces)
        if self.hidden_only:
            active = active & path.memory
        spot = self.beam(sampler, active)
        to_spot = spot.si.p - si.p
        r2 = dr.squared_norm(to_spot)
        active = active & (r2 > 0) & dr.any(spot.power > 0)
        d = to_spot * dr.rsqrt(r2)
        lit, leaving = spot.si, spot.si.to_local(-d)
        f = lit.bsdf().eval(mi.BSDFContext(), lit, leaving, active)
        weight = spot.power * mi.unpolarized_spectrum(f) / r2
        active = active & dr.any(weight != 0)
        # A path that goes back to where it has come from has nothing in its way
        back = dr.squared_norm(lit.p - path.previous.p) <= SAME * r2
        active = active & ~self.scene.ray_test(si.spawn_ray_to(lit.p), active & ~back)
        weight = dr.select(active, weight, 0)
        length = dr.sqrt(r2) + spot.distance
        return Connection(d, weight, mi.Float(1), mi.Bool(True), length, active)

    def hit(self, si, previous, ray, active):
        """No light: what rays run into is lit by connections."""
        return mi.UnpolarizedSpectrum(0), mi.Float(0), dr.norm(si.p - previous.p)

    def nearest(self, p: mi.Point3f) -> mi.Float:
        """No bound."""
        return mi.Float(0)
