"""Start of distant light, from which its path length counts."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class Wavefronts:
    """Planes on which distant light starts; they touch the sphere around scene and sensor.

    Attributes:
        centre: The sphere's centre [m].
        radius: Its radius [m].
    """

    centre: mi.Point3f
    radius: mi.Float

    @classmethod
    def around(cls, scene: mi.Scene, sensor: mi.Sensor | None) -> Wavefronts:
        """The sphere around the scene, and the sensor's position if there is one."""
        box = scene.bbox()
        if sensor is not None:
            position = sensor.world_transform() @ mi.Point3f(0)
            box.expand(mi.ScalarPoint3f([float(x[0]) for x in position]))
        sphere = box.bounding_sphere()
        centre, radius = mi.Point3f(sphere.center), mi.Float(sphere.radius)
        dr.make_opaque(centre, radius)
        return cls(centre, radius)

    def length(self, p: mi.Point3f, d: mi.Vector3f) -> mi.Float:
        """Return the length from `p` along `d` to the plane where its light starts [m]."""
        return self.radius - dr.dot(d, p - self.centre)
