"""Space without participating media, and transmittance between two points in any space."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .protocols import Space
from .records import Connection, Path, Transmittance, Vertex


class Vacuum(Space):
    """Space without media: straight rays between surfaces.

    Args:
        scene: The scene.
        index: Index of refraction around the sensor.
    """

    def __init__(self, scene: mi.Scene, index: float = 1.0) -> None:
        self.scene = scene
        self.index = index

    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Intersect the path's ray with the surfaces.

        The length of the vertex is the distance from `path.prev`. The distance along the ray would
        be too short: rays start slightly off a surface, and camera rays start at the near plane.
        """
        # Camera rays are coherent: neighboring lanes have similar rays
        si = self.scene.ray_intersect(
            path.ray,
            ray_flags=mi.RayFlags.All,
            coherent=(path.depth == 0),
            reorder=True,  # Group threads with equal shapes, if the GPU supports this
            active=path.active,
        )
        length = dr.norm(si.p - path.prev.p)
        return path, Vertex(si=si, length=length, valid=si.is_valid())

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> Transmittance:
        """Trace a shadow ray. The value is 0 if a surface blocks the ray, otherwise 1."""
        tested = connection.active & ~connection.unoccluded
        blocked = self.scene.ray_test(vertex.si.spawn_ray_to(connection.point), tested)
        return Transmittance(dr.select(tested & blocked, mi.Float(0), 1))


def transmittance_between(
    space: Space,
    si: mi.SurfaceInteraction3f,
    point: mi.Point3f,
    sampler: mi.Sampler,
    active: mi.Bool,
    medium_length: mi.Float | None = None,
) -> mi.Spectrum:
    """Estimate the transmittance between a surface point and another point.

    The result is 0 if a surface blocks the segment between both points.

    Args:
        space: The space.
        si: Surface point. If its normal is 0, the ray starts exactly at this point.
        point: The other point [m].
        sampler: The sampler.
        active: Active lanes.
        medium_length: Length over which media attenuate [m], None for the distance of both points.
    """
    # Create a path that consists of the surface point only
    ray = si.spawn_ray_to(point)
    path = Path.start(ray, si.p, active, medium=space.medium_at(ray))
    vertex = Vertex(si=si, length=mi.Float(0), valid=mi.Bool(active))

    # Connect the other point. The transmittance does not depend on the geometric length
    connection = Connection.to_point(point, ray.d, mi.Float(0), active, medium_length)
    return space.transmittance(path, vertex, connection, sampler).value
