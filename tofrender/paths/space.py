"""Space without participating media."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .protocols import Scattering
from .records import Connection, Path, Vertex


class Vacuum:
    """Straight rays between surfaces; shadow rays are blocked or not.

    Args:
        scene: The scene.
        index: Index of refraction around the sensor.
    """

    scatters = False

    def __init__(self, scene: mi.Scene, index: float = 1.0) -> None:
        self.scene, self.index = scene, index

    def with_phase_functions(
        self,
        surfaces: Scattering,
        importance: bool = False,
        both_ways: bool = False,
        connects: bool = False,
    ) -> Scattering:
        """Return the scattering of surfaces unchanged."""
        return surfaces

    def attached(self) -> Vacuum:
        """Return the space unchanged."""
        return self

    def medium_at_sensor(self, ray: mi.Ray3f) -> None:
        """Return None: there are no media."""

    medium_at = medium_at_sensor

    def medium_behind(self, path: Path, vertex: Vertex, direction: mi.Vector3f) -> None:
        """Return None: there are no media."""

    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Intersect the ray with the surfaces.

        The length is taken from point to point, since rays start a little off the surface, and
        camera rays at the near plane.
        """
        si = self.scene.ray_intersect(
            path.ray, ray_flags=mi.RayFlags.All, coherent=(path.depth == 0), active=path.active
        )
        return path, Vertex(si, dr.norm(si.p - path.prev.p), si.is_valid())

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> mi.Float:
        """Trace a shadow ray: 1 where it is free, 0 where it is blocked."""
        tested = connection.active & ~connection.unoccluded
        blocked = self.scene.ray_test(vertex.si.spawn_ray_to(connection.point), tested)
        return dr.select(tested & blocked, mi.Float(0), 1)

    def transmittance_and_medium(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> tuple[mi.Float, None]:
        """As `transmittance`, without a medium."""
        return self.transmittance(path, vertex, connection, sampler), None
