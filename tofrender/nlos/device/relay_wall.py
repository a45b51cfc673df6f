"""The relay wall of a scene, and the points on it at which a sensor's pixels look."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...paths.surfaces import first_surface, is_on
from ...runtime import checks
from ...runtime.backend import tracing_lock
from .laser import axis, find_laser

DEFAULT_ID = "relay_wall"
APART = "a load with optimize=False keeps meshes of equal material apart"

# A wall is flat if its points deviate less from a plane, relative to the size of the wall
FLAT = 1e-4


def is_on_relay_wall(
    si: mi.SurfaceInteraction3f, relay_wall_shapes: mi.Shape | Sequence[mi.Shape]
) -> mi.Bool:
    """Return a mask of the surface points that are on the relay wall, one or more shapes.

    Raises:
        ValueError: An argument has the wrong type.

    Example:
        >>> scene = mi.load_dict({"type": "scene", "wall": {"type": "rectangle"}})
        >>> rays = mi.Ray3f(mi.Point3f([0, 5], 0, 1), mi.Vector3f(0, 0, -1))
        >>> is_on_relay_wall(scene.ray_intersect(rays), scene.shapes())
        [True, False]
    """
    given = relay_wall_shapes
    shapes = [given] if isinstance(given, mi.Shape) else given
    several = isinstance(shapes, Sequence) and shapes and not isinstance(shapes, str | bytes)
    checks.require("relay_wall_shapes", given, several, "a shape or several")
    for each in shapes:
        checks.instance("relay_wall_shapes", each, mi.Shape, "a shape or several")
    checks.instance("si", si, mi.SurfaceInteraction3f, "an mi.SurfaceInteraction3f")
    return is_on(si, shapes)


def find_relay_wall(scene: mi.Scene, wall: Any = DEFAULT_ID) -> list[mi.Shape]:
    """Find the shapes of a scene that are its relay wall.

    When Mitsuba loads a scene, it merges meshes of equal material, and their ids are lost.
    `load_scene(..., optimize=False)` keeps them separate.

    Args:
        scene: The scene.
        wall: The shape, its id, or a list of shapes or ids.

    Raises:
        ValueError: The scene does not contain the shape. The message lists its shapes.

    Example:
        >>> scene = mi.load_dict({"type": "scene", "relay_wall": {"type": "rectangle"}})
        >>> [shape.id() for shape in find_relay_wall(scene)]
        ['relay_wall']
    """
    checks.instance("scene", scene, mi.Scene, "a loaded scene")
    return find_shapes(scene, wall, "relay_wall")


def find_shapes(scene: mi.Scene, wanted: Any, name: str) -> list[mi.Shape]:
    """Find shapes of a scene, given as shapes, ids, or a list of both.

    Args:
        scene: The scene.
        wanted: The shapes.
        name: Name of the parameter, for messages.
    """
    keys = list(wanted) if isinstance(wanted, list | tuple) else [wanted]
    checks.require(name, keys, keys, "at least one shape")
    found: list[mi.Shape] = []
    for key in keys:
        known = isinstance(key, str | mi.Shape)
        matches = [s for s in scene.shapes() if known and key in (s, s.id())]
        if not matches:
            shown = checks.quote(key.id() if isinstance(key, mi.Shape) else key)
            rule = f"must be one of {ids(scene.shapes())} ({APART})"
            raise ValueError(f"{name} = {shown}: the scene has no such shape; {rule}")
        found += [shape for shape in matches if shape not in found]
    return found


def ids(shapes: list[mi.Shape]) -> str:
    """Return the ids of shapes as text, for messages."""
    return ", ".join(repr(shape.id()) for shape in shapes) or "none"


def parse_ids(name: str, value: Any) -> list[str] | None:
    """Split a plugin's parameter into ids of shapes, which are separated by commas."""
    if value is None:
        return None
    checks.instance(name, value, str, "ids of shapes, separated by commas")
    return [each.strip() for each in value.split(",")]


@tracing_lock()
def trace_laser_spot(scene: mi.Scene, wall: list[mi.Shape]) -> tuple[np.ndarray, np.ndarray]:
    """Trace the laser to the wall, or to any surface if the wall is unknown.

    Returns:
        Point [m] and unit normal of the laser spot, both (1, 1, 3).
    """
    ray = mi.Ray3f(*axis(find_laser(scene)))
    si: Any = first_surface(scene, ray)
    lit = is_on(si, wall) if wall else si.is_valid()
    if not lit[0]:
        raise ValueError(
            "laser: its beam misses the relay wall. Aim it at the wall with tofrender.focus_laser"
        )
    normal = si.n * dr.sign(-dr.dot(si.n, ray.d))
    point = np.array(si.p, dtype=np.float64).reshape(1, 1, 3)
    normal = np.array(normal, dtype=np.float64).reshape(1, 1, 3)
    return point, normal


@tracing_lock()
def first_hits(scene: mi.Scene, sensor: mi.Sensor) -> tuple[mi.Ray3f, mi.SurfaceInteraction3f]:
    """Trace rays through the centers of a sensor's pixels, row by row, to the first surface."""
    width, height = (int(n) for n in sensor.film().crop_size())
    x, y = dr.meshgrid(dr.arange(mi.Float, width), dr.arange(mi.Float, height))
    center = (mi.Point2f(x, y) + 0.5) / mi.ScalarPoint2f(width, height)
    ray, _ = sensor.sample_ray(0.0, 0.5, center, mi.Point2f(0.5), mi.Bool(True))
    return mi.Ray3f(ray), first_surface(scene, mi.Ray3f(ray))


@tracing_lock()
def seen_shapes(scene: mi.Scene, sensor: mi.Sensor | None) -> list[mi.Shape]:
    """Return the shapes at the centers of a sensor's pixels, or [] without a sensor."""
    if sensor is None:
        return []
    _, si = first_hits(scene, sensor)
    return [s for s in scene.shapes() if dr.any(si.is_valid() & (si.shape == mi.ShapePtr(s)))]


@tracing_lock()
def wall_points(
    scene: mi.Scene, sensor: mi.Sensor, wall: list[mi.Shape]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the points and normals of the wall at the centers of a sensor's pixels.

    Returns:
        Points [m] and unit normals towards the sensor, both (height, width, 3) for the crop window
        of the film, and a mask of the pixels that look at the wall (height, width). Other pixels
        get the point where they look at the plane of a flat wall, otherwise the point of the
        nearest pixel.

    Raises:
        ValueError: No pixel looks at the wall.
    """
    # Trace the pixel centers
    width, height = (int(n) for n in sensor.film().crop_size())
    ray, si = first_hits(scene, sensor)
    count = width * height
    on_wall = np.broadcast_to(np.array(is_on_relay_wall(si, wall)), count)
    if not on_wall.any():
        raise ValueError(
            f"sensor: 0 of {count} pixels look at the relay wall, {ids(wall)}; must be 1 or more"
        )

    # Convert to arrays (pixels, 3)
    normal = si.n * dr.sign(-dr.dot(si.n, ray.d))
    points, normals, origins, directions = (
        np.broadcast_to(np.array(v, dtype=np.float64).reshape(3, -1).T, (count, 3))
        for v in (si.p, normal, ray.o, ray.d)
    )

    # Continue the wall to pixels that miss it
    if not on_wall.all():
        points, normals = _continue_wall(points, normals, on_wall, origins, directions)
    shape = (height, width, 3)
    return points.reshape(shape), normals.reshape(shape), on_wall.reshape(height, width)


def _continue_wall(
    points: np.ndarray,
    normals: np.ndarray,
    on_wall: np.ndarray,
    origins: np.ndarray,
    directions: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Set the points and normals of pixels that miss the wall.

    Such a pixel gets the point and the normal of the nearest pixel on the wall, in the order of the
    arrays. On a flat wall, the point is instead the intersection of the pixel's ray with the plane
    of the wall, if the ray meets the plane.

    Args:
        points: Point of each pixel [m], (n, 3).
        normals: Unit normal of each pixel, (n, 3).
        on_wall: Whether each pixel looks at the wall, (n,).
        origins: Origin of the ray of each pixel [m], (n, 3).
        directions: Direction of the ray of each pixel, (n, 3).

    Returns:
        Points and normals of all pixels.
    """
    # Use the point of the nearest pixel on the wall
    index = np.arange(len(points))
    known = np.flatnonzero(on_wall)
    after = np.minimum(np.searchsorted(known, index), len(known) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(known[before] - index) < np.abs(known[after] - index)
    near = np.where(closer, known[before], known[after])
    seen = points[known]
    points = points[near]
    normals = normals[near]

    # On a flat wall, intersect the rays with its plane
    normal = normals[known[0]]
    if np.abs((seen - seen[0]) @ normal).max() <= FLAT * max(np.ptp(seen, axis=0).max(), FLAT):
        towards = directions @ normal
        meets = ~on_wall & (towards < -1e-3)
        r = ((seen[0] - origins) @ normal)[meets] / towards[meets]
        points[meets] = origins[meets] + r[:, None] * directions[meets]
    return points, normals
