# pyright: reportArgumentType=false, reportOperatorIssue=false
"""The relay wall of a scene: the surface that a device looks at to see around the corner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi

from ...paths.surfaces import first_surface, is_on
from ...runtime import checks
from ...runtime.backend import tracing_lock

DEFAULT_ID = "relay_wall"


def is_on_relay_wall(
    si: mi.SurfaceInteraction3f, relay_wall_shapes: mi.Shape | Sequence[mi.Shape]
) -> mi.Bool:
    """Whether surface points are on the relay wall.

    Args:
        si: Surface interactions, of any number.
        relay_wall_shapes: The wall, a shape or several.

    Returns:
        A mask, one entry for each interaction.

    Raises:
        ValueError: One of them is something else; one line.

    Example:
        >>> scene = mi.load_dict({"type": "scene", "wall": {"type": "rectangle"}})
        >>> rays = mi.Ray3f(mi.Point3f([0, 5], 0, 1), mi.Vector3f(0, 0, -1))
        >>> is_on_relay_wall(scene.ray_intersect(rays), scene.shapes())
        [True, False]
    """
    given = relay_wall_shapes
    shapes = [given] if isinstance(given, mi.Shape) else given
    if not isinstance(shapes, Sequence) or not shapes or isinstance(shapes, str | bytes):
        raise ValueError(f"relay_wall_shapes = {checks.quote(given)}: must be a shape or several")
    for each in shapes:
        checks.instance("relay_wall_shapes", each, mi.Shape, "a shape or several")
    checks.instance("si", si, mi.SurfaceInteraction3f, "an mi.SurfaceInteraction3f")
    return is_on(si, shapes)


def find_relay_wall(scene: mi.Scene, wall: Any = DEFAULT_ID) -> list[mi.Shape]:
    """The shapes of a scene that are its relay wall.

    Mitsuba merges meshes of equal material when it loads a scene, and they lose their ids:
    `load_scene(..., optimize=False)` keeps them apart.

    Args:
        scene: The scene.
        wall: The shape, its id, or a list of either.

    Raises:
        ValueError: The scene has no such shape; one line with those that it has.

    Example:
        >>> scene = mi.load_dict({"type": "scene", "relay_wall": {"type": "rectangle"}})
        >>> [shape.id() for shape in find_relay_wall(scene)]
        ['relay_wall']
    """
    checks.instance("scene", scene, mi.Scene, "a loaded scene")
    return find_shapes(scene, wall, "relay_wall")


def find_shapes(scene: mi.Scene, wanted: Any, what: str) -> list[mi.Shape]:
    """Shapes of a scene by themselves, by their ids, or a list of either; `what` is for messages.

    Raises:
        ValueError: The scene has no such shape; one line with those that it has.

    Example:
        >>> scene = mi.load_dict({"type": "scene", "plate": {"type": "rectangle"}})
        >>> find_shapes(scene, "plate", "hidden_shapes") == scene.shapes()
        True
    """
    names = list(wanted) if isinstance(wanted, list | tuple) else [wanted]
    if not names:
        raise ValueError(f"{what} = []: must name at least one shape")
    found: list[mi.Shape] = []
    for each in names:
        known = isinstance(each, str | mi.Shape)
        matches = [s for s in scene.shapes() if known and each in (s, s.id())]
        if not matches:
            name = each.id() if isinstance(each, mi.Shape) else each
            raise ValueError(
                f"{what} = {checks.quote(name)}: the scene has no such shape; must be "
                f"one of {ids(scene)} (a load with optimize=False keeps meshes of equal material "
                "apart)"
            )
        found += [shape for shape in matches if shape not in found]
    return found


def ids(scene: mi.Scene) -> str:
    """The ids of a scene's shapes, for messages."""
    return ", ".join(repr(shape.id()) for shape in scene.shapes()) or "none"


def parse_ids(what: str, value: Any) -> list[str] | None:
    """Ids of shapes, separated by commas, as a plugin's parameter gives them; None stays.

    Raises:
        ValueError: It is no text; one line.
    """
    if value is None:
        return None
    if not isinstance(value, str):
        raise ValueError(
            f"{what} = {checks.quote(value)}: must be ids of shapes, separated by commas"
        )
    return [each.strip() for each in value.split(",")]


@tracing_lock()
def first_hits(scene: mi.Scene, sensor: mi.Sensor) -> tuple[mi.Ray3f, mi.SurfaceInteraction3f]:
    """Rays through the centres of a sensor's pixels, row by row, and what they meet."""
    width, height = (int(n) for n in sensor.film().crop_size())
    x, y = dr.meshgrid(dr.arange(mi.Float, width), dr.arange(mi.Float, height))
    centre = (mi.Point2f(x, y) + 0.5) / mi.ScalarPoint2f(width, height)
    ray, _ = sensor.sample_ray(0.0, 0.5, centre, mi.Point2f(0.5), mi.Bool(True))
    return mi.Ray3f(ray), first_surface(scene, mi.Ray3f(ray))


@tracing_lock()
def seen_shapes(scene: mi.Scene, sensor: mi.Sensor | None) -> list[mi.Shape]:
    """The shapes that the centres of a sensor's pixels look at; none without a sensor."""
    if sensor is None:
        return []
    _, si = first_hits(scene, sensor)
    return [s for s in scene.shapes() if dr.any(si.is_valid() & (si.shape == mi.ShapePtr(s)))]
