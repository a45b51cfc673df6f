# pyright: reportArgumentType=false, reportCallIssue=false
"""Space: how a path finds its next vertex, and what is lost on the way."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .protocols import Scattering
from .records import Connection, Path, Vertex


class Vacuum:
    """Straight rays from surface to surface; nothing is lost but what a surface hides.

    Args:
        scene: The scene.
        index: Index of refraction around the sensor.
    """

    scatters = False

    def __init__(self, scene: mi.Scene, index: float = 1.0) -> None:
        self.scene, self.index = scene, index

    def scattering(
        self,
        surfaces: Scattering,
        importance: bool = False,
        both_ways: bool = False,
        connects: bool = False,
    ) -> Scattering:
        """What is given: there is nothing but surfaces."""
        return surfaces

    def place(self, ray: mi.Ray3f) -> None:
        """Nothing: it is the same everywhere."""
        return None

    around = place

    def leave(self, path: Path, vertex: Vertex, direction: mi.Vector3f) -> None:
        """Nothing."""
        return None

    def attached(self) -> Vacuum:
        """The same."""
        return self

    def next(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """The first surface along the ray.

        Its length is taken from point to point, since rays start a little off the surface, and
        camera rays at the near plane.
        """
        si = self.scene.ray_intersect(
            path.ray, ray_flags=mi.RayFlags.All, coherent=(path.depth == 0), active=path.active
        )
        return path, Vertex(si, dr.norm(si.p - path.prev.p), si.is_valid())

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> mi.Float:
        """1 where a connection is free, 0 where a surface is in the way."""
        asked = connection.active & ~connection.clear
        shadow = self.scene.ray_test(vertex.si.spawn_ray_to(connection.point), asked)
        return dr.select(asked & shadow, mi.Float(0), 1)

    def through(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> tuple[mi.Float, None]:
        """The same, and nothing of where it ends."""
        return self.transmittance(path, vertex, connection, sampler), None
