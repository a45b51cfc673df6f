"""The lens of a camera, its importance, and connections of points to it.

Rays through uniform points of the film, whose window has the area A in the plane at distance
1, have the solid-angle density

    p(ω) = 1 / (A cos³θ)            θ: angle between the ray and the axis

and the importance We = p / cosθ (over the area of the lens, if it has one), whose integral over
directions, cosine and lens is 1: a film pixel is the mean of what arrives on it.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..paths.window import Arrival, Window


class Lens(Window):
    """The lens of a `perspective` or `thinlens` sensor.

    Args:
        sensor: The camera.

    Raises:
        ValueError: Nothing can connect to the sensor; one line.
    """

    def __init__(self, sensor: mi.Sensor) -> None:
        super().__init__(sensor)
        self.area = dr.abs(self.extent.x * self.extent.y)
        dr.make_opaque(self.area)

    def density(self, d: mi.Vector3f) -> mi.Float:
        """Density p(ω) of a camera ray's direction, which is in the window [1/sr]."""
        cos = dr.abs(dr.dot(d, self.axis))
        return dr.rcp(self.area * cos * cos * cos)

    def importance(self, d: mi.Vector3f) -> mi.Float:
        """Importance We of a camera ray's direction, which is in the window [1/sr, 1/(sr m²)]."""
        lens = dr.pi * self.radius * self.radius if self.is_thin else mi.Float(1)
        return self.density(d) / (dr.abs(dr.dot(d, self.axis)) * lens)

    def sample(self, sampler: mi.Sampler) -> mi.Point3f:
        """Sample a point uniformly on the lens; a pinhole has one, and draws no random number."""
        if not self.is_thin:
            return self.position
        disk = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d()) * self.radius
        return self.position + self.right * disk.x + self.up * disk.y

    def arrive(self, p: mi.Point3f, lens: mi.Point3f, distant: mi.Bool | bool = False) -> Arrival:
        """Connect points to a point on the lens; `distant` ones are behind any clip."""
        to_point = p - lens
        distance = dr.norm(to_point)
        d = to_point / distance
        cos, depth = dr.dot(d, self.axis), dr.dot(to_point, self.axis)
        # A lens point sees what the middle sees where the ray crosses the plane in focus
        offset = mi.Vector3f(lens - self.position) if self.is_thin else mi.Vector3f(0)
        crossing = offset + d * (self.focus / cos)
        x, y = self.plane(crossing) if self.is_thin else self.plane(d)
        uv = (mi.Point2f(x, y) - self.corner) / self.extent
        seen = (cos > 0) & (distant | ((depth >= self.near_clip) & (depth <= self.far_clip)))
        seen &= dr.all((uv >= 0) & (uv < 1))
        return Arrival(
            lens=mi.Point3f(lens),
            near=lens + d * (self.near_clip / cos),
            direction=-d,
            distance=distance,
            density=dr.select(seen, self.density(d), 0),
            position=self.first + uv * self.size,
            seen=seen,
        )
