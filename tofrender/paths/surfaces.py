"""Telling on which shapes surface points are, and which surfaces let light through."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi


def is_on(si: mi.SurfaceInteraction3f, shapes: Sequence[mi.Shape]) -> mi.Bool:
    """Whether surface points are on one of some shapes.

    Args:
        si: Surface interactions, of any number.
        shapes: Shapes of the scene.

    Example:
        >>> scene = mi.load_dict({"type": "scene", "wall": {"type": "rectangle", "id": "wall"}})
        >>> rays = mi.Ray3f(mi.Point3f([0, 5], 0, 1), mi.Vector3f(0, 0, -1))
        >>> is_on(scene.ray_intersect(rays), scene.shapes())
        [True, False]
    """
    found = mi.Bool(False)
    for shape in shapes:
        found |= si.shape == mi.ShapePtr(shape)
    return found & si.is_valid()


def transmits(scene: mi.Scene, *ways: mi.BSDFFlags) -> bool:
    """Whether a surface of the scene lets light through in one of the given ways."""
    bsdfs = [shape.bsdf().flags() for shape in scene.shapes()]
    return any(mi.has_flag(flags, way) for flags in bsdfs for way in ways)
