"""Planes where light from emitters at infinity starts."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..runtime.interface import world_transform


@dataclass
class Wavefronts:
    """Planes where distant light starts, one plane for each direction.

    All planes touch the sphere around scene and sensor.
    """

    center: mi.Point3f  # Center of the sphere [m]
    radius: mi.Float  # Radius of the sphere [m]

    @classmethod
    def around(cls, scene: mi.Scene, sensor: mi.Sensor | None) -> Wavefronts:
        """Return the planes for the sphere around a scene and a sensor.

        Without a sensor, the sphere surrounds the scene only.
        """
        # Include the sensor in the bounding box
        box = scene.bbox()
        if sensor is not None:
            position = world_transform(sensor) @ mi.Point3f(0)
            box.expand(mi.ScalarPoint3f([float(x[0]) for x in position]))

        # Opaque numbers give one kernel for all scenes
        sphere = box.bounding_sphere()
        center = mi.Point3f(sphere.center)
        radius = mi.Float(sphere.radius)
        dr.make_opaque(center, radius)
        return cls(center, radius)

    def length(self, p: mi.Point3f, d: mi.Vector3f) -> mi.Float:
        """Return the length from `p` along a unit vector `d` to the plane of this direction [m]."""
        return self.radius - dr.dot(d, p - self.center)
