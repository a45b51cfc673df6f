# pyright: reportArgumentType=false, reportCallIssue=false
"""What of light goes straight from one point to another, outside of any path."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from .protocols import Space
from .records import Connection, Path, Vertex


def arriving(
    space: Space,
    si: mi.SurfaceInteraction3f,
    point: mi.Point3f,
    sampler: mi.Sampler,
    active: mi.Bool,
    reach: Any = None,
) -> Any:
    """What of the light of a surface point arrives at another point: 0 behind other surfaces.

    Args:
        space: What it goes through.
        si: The surface point; of one without a normal, light starts at the very point.
        point: The other point [m].
        sampler: Random numbers.
        active: Lanes that are asked for.
        reach: As in `Connection`.
    """
    ray = si.spawn_ray_to(point)
    path = Path.start(ray, si.p, active, place=space.around(ray))
    link = Connection.plain(point, ray.d, mi.Float(0), active, reach)
    return space.transmittance(path, Vertex(si, mi.Float(0), mi.Bool(active)), link, sampler)
