"""The relay wall of a scene: the surface that a device looks at to see around the corner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mitsuba as mi

from .targets import is_on

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

    Example:
        >>> scene = mi.load_dict({"type": "scene", "wall": {"type": "rectangle"}})
        >>> rays = mi.Ray3f(mi.Point3f([0, 5], 0, 1), mi.Vector3f(0, 0, -1))
        >>> is_on_relay_wall(scene.ray_intersect(rays), scene.shapes())
        [True, False]
    """
    one = isinstance(relay_wall_shapes, mi.Shape)
    return is_on(si, [relay_wall_shapes] if one else relay_wall_shapes)


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
    wanted = list(wall) if isinstance(wall, list | tuple) else [wall]
    if not wanted:
        raise ValueError("relay_wall = []: must name at least one shape")
    found = []
    for each in wanted:
        matches = [s for s in scene.shapes() if each in (s, s.id())]
        if not matches:
            ids = ", ".join(repr(shape.id()) for shape in scene.shapes()) or "none"
            name = each if isinstance(each, str) else each.id()
            raise ValueError(
                f"relay_wall = {name!r}: the scene has no such shape; must be one of {ids} "
                "(a load with optimize=False keeps meshes of equal material apart)"
            )
        found += matches
    return found
