"""The lens by the camera's own coordinates: a point at (x, y, z) is seen at (x, y) / z."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tofrender.paths.sensor_window import Arrival, Window


class Lens(Window):
    """The lens of a pinhole."""

    def __init__(self, sensor: mi.Sensor) -> None:
        super().__init__(sensor)
        width, height = self.extent
        self.area = dr.abs(width) * dr.abs(height)

    def density(self, d: mi.Vector3f) -> mi.Float:
        """The plane at distance 1 is at 1 / cos, and lies aslant by cos."""
        cos = dr.dot(d, self.axis)
        squared_distance = 1 / (cos * cos)
        return squared_distance / (self.area * cos)

    def importance(self, d: mi.Vector3f) -> mi.Float:
        """The density, and the cosine at the lens."""
        return self.density(d) / dr.dot(d, self.axis)

    def sample(self, sampler: mi.Sampler) -> mi.Point3f:
        """The only point."""
        return self.position

    def arrive(self, p: mi.Point3f, lens: mi.Point3f) -> Arrival:
        """Where light from a point lands."""
        way = p - lens
        x = dr.dot(way, self.right)
        y = dr.dot(way, self.up)
        z = dr.dot(way, self.axis)
        d = dr.normalize(way)
        u = (x / z - self.corner.x) / self.extent.x
        v = (y / z - self.corner.y) / self.extent.y
        seen = (z > 0) & (z >= self.near_clip) & (z <= self.far_clip)
        seen &= (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
        return Arrival(
            lens=mi.Point3f(lens),
            near=lens + way * (self.near_clip / z),
            direction=-d,
            distance=dr.norm(way),
            density=dr.select(seen, self.density(d), 0),
            position=self.first + mi.Point2f(u * self.size.x, v * self.size.y),
            seen=seen,
        )
