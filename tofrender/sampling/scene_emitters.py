# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""The area lights of a Mitsuba scene as shapes that can be sampled."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from .emitter_records import Shape
from .patches import Quad, Triangle
from .shapes import SurfaceGroup
from .spheres import Sphere

MAX_TRIANGLES = 64
"""Most triangles of a mesh; a group tests each of its shapes for every sample."""


def emitters_of(scene: mi.Scene) -> SurfaceGroup:
    """Return all lights of a scene as one group.

    Rectangles become a `Quad`, spheres a `Sphere`, meshes a `Triangle` for each face. Light leaves
    them on the same side as in Mitsuba, flipped normals included. Values are taken as they are now;
    they do not follow later changes of the scene, nor do gradients.

    Args:
        scene: A scene whose emitters are all area lights of one radiance.

    Raises:
        ValueError: The scene has no light, or one of another kind; one line with its name.

    Example:
        >>> light = {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}
        >>> scene = mi.load_dict({"type": "scene", "lamp": {"type": "sphere", "emitter": light}})
        >>> emitters_of(scene)
        SurfaceGroup([Sphere((0, 0, 0), radius=1, emission=(3.0, 3.0, 3.0))])
    """
    checks.instance("scene", scene, mi.Scene, "a loaded scene")
    shapes: list[Shape] = []
    for emitter in scene.emitters():
        if not mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
            raise ValueError(f"scene: emitter {emitter.id()!r} has no surface; must be area lights")
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying):
            raise ValueError(
                f"scene: emitter {emitter.id()!r} is textured; must be of one radiance"
            )
    for shape in scene.shapes():
        if shape.is_emitter():
            shapes += _shapes_of(shape)
    if not shapes:
        raise ValueError("scene: has no emitter; must have area lights")
    return SurfaceGroup(shapes)


def _shapes_of(shape: mi.Shape) -> list[Shape]:
    """One light of the scene."""
    kind, radiance = shape.shape_type(), _radiance(shape)
    if kind == int(mi.ShapeType.Rectangle):
        quad = Quad((2, 2), emission=radiance, transform=_to_world(shape))
        if np.dot(quad.normal, _point_and_normal(shape)[1]) < 0:
            quad = Quad.from_edges(quad.corner, quad.e1, quad.e0, emission=radiance)
        return [quad]
    if kind == int(mi.ShapeType.Sphere):
        sphere = Sphere(emission=radiance, transform=_to_world(shape))
        p, n = _point_and_normal(shape)
        sphere.flip_normals = bool(np.dot(p - sphere.centre, n) < 0)
        return [sphere]
    if isinstance(shape, mi.Mesh) and shape.face_count() <= MAX_TRIANGLES:
        return _triangles_of(shape, radiance)
    allowed = f"must be a rectangle, a sphere, or a mesh of at most {MAX_TRIANGLES} triangles"
    raise ValueError(f"scene: emitter on the shape {shape.id()!r}: {allowed}")


def _triangles_of(mesh: mi.Mesh, radiance: np.ndarray) -> list[Shape]:
    """A triangle for each face, with the normal that a ray finds in the middle of the face."""
    index = dr.arange(mi.UInt32, mesh.face_count())
    a, b, c = (mesh.vertex_position(each) for each in mesh.face_indices(index))
    middle, normal = (a + b + c) / 3, mi.Vector3f(dr.normalize(dr.cross(b - a, c - a)))
    ray = mi.Ray3f(middle + normal, -normal)
    si = mesh.ray_intersect_triangle(index, ray).compute_surface_interaction(ray)
    flipped = np.array(dr.dot(si.sh_frame.n, normal) < 0)
    corners = np.array([a, b, c], dtype=np.float64).transpose(2, 0, 1)
    return [
        Triangle(*(each[::-1] if flip else each), emission=radiance)
        for each, flip in zip(corners, flipped, strict=True)
    ]


def _to_world(shape: mi.Shape) -> np.ndarray:
    to_world: Any = mi.traverse(shape)["to_world"]
    return np.array(to_world.matrix, dtype=np.float64).reshape(4, 4)


def _radiance(shape: mi.Shape) -> np.ndarray:
    """Radiance at normal incidence, one value or three."""
    si = mi.SurfaceInteraction3f(shape.sample_position(0.0, mi.Point2f(0.5)), [])
    si.wi = mi.Vector3f(0, 0, 1)
    value = mi.unpolarized_spectrum(shape.emitter().eval(si))
    return np.array(value, dtype=np.float64).ravel()


def _point_and_normal(shape: mi.Shape) -> list[np.ndarray]:
    """A point of the surface and the normal there."""
    sample = shape.sample_position(0.0, mi.Point2f(0.3, 0.6))
    return [np.array(each, dtype=np.float64).ravel() for each in (sample.p, sample.n)]
