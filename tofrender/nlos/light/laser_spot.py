# pyright: reportArgumentType=false
"""The light strategy of a scanned laser: the point of a wall that it lights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ...paths.protocols import Endpoint
from ...paths.records import BSDFSample, Connection, Path, Vertex
from ...paths.surfaces import first_surface, is_on

SAME = 1e-10
"""Squared distance of two points, over that to a third, below which they are one."""


@dataclass
class Spot:
    """Where a laser beam lands.

    Attributes:
        si: The lit surface point, `si.wi` towards the laser; one, or one for each lane.
        power: Power that arrives there, the cosine included [W].
        distance: Optical length from the laser to the point that counts in path lengths [m].
        beam: The beam, one or one for each lane.
        origin: Where the beam's length starts [m].
    """

    si: mi.SurfaceInteraction3f
    power: Any
    distance: mi.Float
    beam: mi.Ray3f | None = None
    origin: mi.Point3f | None = None

    @classmethod
    def of_beam(
        cls,
        scene: mi.Scene,
        ray: mi.Ray3f,
        power: Any,
        active: mi.Bool | bool = True,
        origin: Any = None,
    ) -> Spot:
        """Follow a beam of a power [W] to the first surface; the power is 0 where there is none.

        The distance counts from `origin`, by default from where the ray starts.
        """
        si = first_surface(scene, ray, active)
        power = dr.select(si.is_valid(), power, 0)
        origin = ray.o if origin is None else origin
        return cls(si, power, dr.norm(si.p - origin), ray, origin)

    def throws(self, direction: mi.Vector3f, active: mi.Bool) -> Any:
        """What the material makes of the beam in a direction: BSDF times cosine [1/sr]."""
        return self.si.bsdf().eval(mi.BSDFContext(), self.si, self.si.to_local(direction), active)


Share = Callable[[Vertex, Path], mi.Float]
"""Takes a vertex and its path, gives the share of its connection that counts."""


class LeftWall:
    """History of paths: whether a vertex so far is off the relay wall, 0 or 1.

    Args:
        wall: Shapes of the relay wall.
    """

    def __init__(self, wall: Sequence[mi.Shape]) -> None:
        self.wall = list(wall)

    def start(self) -> mi.UInt32:
        """Return 0."""
        return mi.UInt32(0)

    def at_vertex(self, path: Path[mi.UInt32], vertex: Vertex, active: mi.Bool) -> mi.UInt32:
        """Return 1 if the vertex, or one before, is off the wall."""
        return dr.select(active & ~is_on(vertex.si, self.wall), mi.UInt32(1), path.history)

    def after_sample(
        self, path: Path[mi.UInt32], vertex: Vertex, bsdf_sample: BSDFSample
    ) -> mi.UInt32:
        """Return the history unchanged."""
        return path.history


class LaserSpot(Endpoint):
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
        share: What counts of a connection where another technique finds the same paths; by default
            all.
        hide_emitters: Whether the sensor looks through area lights.
    """

    def __init__(
        self,
        scene: mi.Scene,
        beam: Callable[[mi.Sampler, mi.Bool], Spot],
        wall: Sequence[mi.Shape] = (),
        hidden_only: bool = False,
        bounces: int = -1,
        share: Share | None = None,
        hide_emitters: bool = False,
    ) -> None:
        self.scene, self.hide_emitters = scene, hide_emitters
        self.beam, self.bounces, self.share = beam, bounces, share
        self.hidden_only = hidden_only
        self.history = LeftWall(wall) if hidden_only else None

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect to the lit point; the share of it that counts here."""
        connection = self.lit(vertex, path, sampler, active)
        if self.share is not None:
            connection.weight *= self.share(vertex, path)
        return connection

    def source(self, sampler: mi.Sampler, active: mi.Bool) -> Spot:
        """The point that is connected to."""
        return self.beam(sampler, active)

    def lit(self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool) -> Connection:
        """Connect to the lit point."""
        if self.bounces >= 0:
            active = active & (path.depth + 2 == self.bounces)
        if self.hidden_only:
            active = active & (path.history != 0)
        spot = self.source(sampler, active)
        lit = spot.si
        to_spot = lit.p - vertex.si.p
        r2 = dr.squared_norm(to_spot)
        active = active & (r2 > 0) & dr.any(spot.power > 0)
        d = to_spot * dr.rsqrt(r2)
        f = spot.throws(-d, active)
        weight = spot.power * mi.unpolarized_spectrum(f) / r2
        return Connection(
            point=lit.p,
            direction=d,
            weight=dr.select(active, weight, 0),
            pdf=mi.Float(1),
            delta=mi.Bool(True),
            length=dr.sqrt(r2) + spot.distance,
            active=active & ~dr.all(weight == 0),
            # A path that goes back to where it has come from has nothing in its way
            unoccluded=dr.squared_norm(lit.p - path.prev.p) <= SAME * r2,
        )
