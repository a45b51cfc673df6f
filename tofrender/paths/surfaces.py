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


def materials(scene: mi.Scene) -> list[mi.BSDF]:
    """The materials of all shapes, and of those that instances repeat."""
    shapes = scene.shapes()
    if any(shape.class_name() == "Instance" for shape in shapes):
        return [node for node in mi.traverse(scene).hierarchy if isinstance(node, mi.BSDF)]
    return [shape.bsdf() for shape in shapes]


def transmits(scene: mi.Scene, *ways: mi.BSDFFlags) -> bool:
    """Whether a surface of the scene lets light through in one of the given ways."""
    flags = [bsdf.flags() for bsdf in materials(scene)]
    return any(mi.has_flag(each, way) for each in flags for way in ways)


def has_mirrors(scene: mi.Scene) -> bool:
    """Whether a surface of the scene sends light on in single directions: mirrors, glass, masks."""
    return any(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) for bsdf in materials(scene))
