"""Space without participating media, and transmittance between two points of any space."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .protocols import Space
from .records import Connection, Path, Vertex


class Vacuum(Space):
    """Straight rays between surfaces; shadow rays are blocked or not.

    Args:
        scene: The scene.
        index: Index of refraction around the sensor.
    """

    def __init__(self, scene: mi.Scene, index: float = 1.0) -> None:
        self.scene, self.index = scene, index

    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Intersect the ray with the surfaces.

        The length is measured from point to point, since rays start a little off the surface, and
        camera rays at the near plane.
        """
        si = self.scene.ray_intersect(
            path.ray,
            ray_flags=mi.RayFlags.All,
            coherent=(path.depth == 0),
            reorder=True,  # Group threads with equal shapes, if the GPU can
            active=path.active,
        )
        return path, Vertex(si, dr.norm(si.p - path.prev.p), si.is_valid())

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> mi.Float:
        """Trace a shadow ray: 1 where it is free, 0 where it is blocked."""
        tested = connection.active & ~connection.unoccluded
        blocked = self.scene.ray_test(vertex.si.spawn_ray_to(connection.point), tested)
        return dr.select(tested & blocked, mi.Float(0), 1)


def transmittance_between(
    space: Space,
    si: mi.SurfaceInteraction3f,
    point: mi.Point3f,
    sampler: mi.Sampler,
    active: mi.Bool,
    medium_length: mi.Float | None = None,
) -> mi.Spectrum:
    """Estimate the transmittance from a surface point to another point, 0 behind other surfaces.

    A surface point without a normal has no offset; `medium_length` as in `Connection`.
    """
    ray = si.spawn_ray_to(point)
    path = Path.start(ray, si.p, active, medium=space.medium_at(ray))
    connection = Connection.to_point(point, ray.d, mi.Float(0), active, medium_length)
    return space.transmittance(path, Vertex(si, mi.Float(0), mi.Bool(active)), connection, sampler)
