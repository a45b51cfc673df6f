"""Transmittance between two points, outside of any path."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from .protocols import Space
from .records import Connection, Path, Vertex


def transmittance_between(
    space: Space,
    si: mi.SurfaceInteraction3f,
    point: mi.Point3f,
    sampler: mi.Sampler,
    active: mi.Bool,
    medium_length: Any = None,
) -> Any:
    """Estimate the transmittance from a surface point to another point, 0 behind other surfaces.

    Args:
        space: The space between them.
        si: The surface point; one without a normal is taken as it is.
        point: The other point [m].
        sampler: Random numbers.
        active: Active lanes.
        medium_length: As in `Connection`.
    """
    ray = si.spawn_ray_to(point)
    path = Path.start(ray, si.p, active, medium=space.medium_at(ray))
    connection = Connection.to_point(point, ray.d, mi.Float(0), active, medium_length)
    return space.transmittance(path, Vertex(si, mi.Float(0), mi.Bool(active)), connection, sampler)
