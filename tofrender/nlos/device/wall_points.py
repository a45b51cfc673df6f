# pyright: reportArgumentType=false, reportCallIssue=false
"""Points of a relay wall that a sensor's pixels look at."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ...runtime.backend import tracing_lock
from .relay_wall import first_hits, is_on_relay_wall

FLAT = 1e-4
"""Distance from a plane, over a wall's size, up to which the wall is flat."""


@tracing_lock()
def wall_points(
    scene: mi.Scene, sensor: mi.Sensor, wall: list[mi.Shape]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the wall that the centres of a sensor's pixels look at, and normals.

    Returns:
        Points [m] and unit normals on the side that the sensor sees, both (height, width, 3) of its
        film's crop window, and whether each pixel looks at the wall, (height, width). A pixel that
        does not gets the point where it looks at the plane of a flat wall, else that of a pixel
        nearby.

    Raises:
        ValueError: No pixel looks at the wall; one line.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    ray, si = first_hits(scene, sensor)
    count = width * height
    on_wall = np.broadcast_to(np.array(is_on_relay_wall(si, wall)), count)
    if not on_wall.any():
        names = ", ".join(repr(shape.id()) for shape in wall)
        raise ValueError(
            f"sensor: 0 of {count} pixels look at the relay wall, {names}; must be 1 or more"
        )
    normal = si.n * dr.sign(-dr.dot(si.n, ray.d))
    points, normals, origins, directions = (
        np.broadcast_to(np.array(v, dtype=np.float64).reshape(3, -1).T, (count, 3))
        for v in (si.p, normal, ray.o, ray.d)
    )
    if not on_wall.all():
        points, normals = _continue(points, normals, on_wall, origins, directions)
    shape = (height, width, 3)
    return points.reshape(shape), normals.reshape(shape), on_wall.reshape(height, width)


def _continue(
    points: np.ndarray,
    normals: np.ndarray,
    on_wall: np.ndarray,
    origins: np.ndarray,
    directions: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Replace points and normals, all (n, 3), of pixels that are not `on_wall`."""
    index, known = np.arange(len(points)), np.flatnonzero(on_wall)
    after = np.minimum(np.searchsorted(known, index), len(known) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(known[before] - index) < np.abs(known[after] - index)
    near = np.where(closer, known[before], known[after])
    points, normals, seen = points[near], normals[near], points[known]

    normal = normals[known[0]]
    if np.abs((seen - seen[0]) @ normal).max() <= FLAT * max(np.ptp(seen, axis=0).max(), FLAT):
        towards = directions @ normal
        meets = ~on_wall & (towards < -1e-3)
        r = ((seen[0] - origins) @ normal)[meets] / towards[meets]
        points[meets] = origins[meets] + r[:, None] * directions[meets]
    return points, normals
