"""The lens of a camera: its importance, and connections of points to the lens.

Camera rays go through uniform points of the film. Let A be the area of the film's window on a plane
at distance 1, and θ the angle between ray and axis. Then the solid-angle density of the rays is

    p(ω) = 1 / (A cos³θ).

The importance is We = p / cosθ, divided by the area of the lens for thin lenses. The integral of
We cosθ over directions and over the lens is 1, so a pixel of the film is the mean of the radiance
that arrives.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..paths.sensor_window import Arrival, Window


class Lens(Window):
    """The lens of a `perspective` or `thinlens` sensor, to which points of the scene are connected.

    Light tracing and bidirectional path tracing use these connections. `Window` describes the
    attributes.

    Args:
        sensor: The camera.

    Raises:
        ValueError: If connections to the sensor are not supported.
    """

    def __init__(self, sensor: mi.Sensor) -> None:
        super().__init__(sensor)
        self.area = dr.abs(self.extent.x * self.extent.y)
        dr.make_opaque(self.area)

    def density(self, d: mi.Vector3f) -> mi.Float:
        """Return the density p(ω) of the direction of a camera ray inside of the window [1/sr]."""
        cos = dr.abs(dr.dot(d, self.axis))
        return dr.rcp(self.area * cos * cos * cos)

    def importance(self, d: mi.Vector3f) -> mi.Float:
        """Return the importance We of the direction of a camera ray inside of the window.

        The unit is 1/sr for a pinhole and 1/(sr m²) for a thin lens.
        """
        lens = dr.pi * self.radius * self.radius if self.is_thin else mi.Float(1)
        return self.density(d) / (dr.abs(dr.dot(d, self.axis)) * lens)

    def sample(self, sampler: mi.Sampler) -> mi.Point3f:
        """Sample a uniform point on the lens. A pinhole does not use random numbers."""
        if not self.is_thin:
            return self.position
        disk = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d()) * self.radius
        return self.position + self.right * disk.x + self.up * disk.y

    def arrive(self, p: mi.Point3f, lens: mi.Point3f, distant: mi.Bool | bool = False) -> Arrival:
        """Connect points to a point on the lens.

        Args:
            p: The points.
            lens: The point on the lens.
            distant: Lanes with points that the clip planes do not affect.
        """
        # Direction and distance of the point
        to_point = p - lens
        distance = dr.norm(to_point)
        d = to_point / distance
        cos = dr.dot(d, self.axis)
        depth = dr.dot(to_point, self.axis)

        # Position on the film. For a thin lens, all rays through one point of the plane in focus
        # arrive at the same position
        offset = mi.Vector3f(lens - self.position) if self.is_thin else mi.Vector3f(0)
        crossing = offset + d * (self.focus / cos)
        x, y = self.plane(crossing) if self.is_thin else self.plane(d)
        uv = (mi.Point2f(x, y) - self.corner) / self.extent

        # Is the point between the clip planes, and inside of the film's window?
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
