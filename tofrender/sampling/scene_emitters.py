"""Area lights of a Mitsuba scene, converted to shapes that can be sampled."""

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

MAX_TRIANGLES = 64  # of a mesh: a group tests each of its shapes for every sample


def emitters_of(scene: mi.Scene) -> SurfaceGroup:
    """Return all lights of a scene as one group.

    Rectangles become a `Quad`, spheres a `Sphere`, meshes a `Triangle` for each face. Light leaves
    them on the same side as in Mitsuba, flipped normals included. The values of this moment are
    copied; they do not follow later changes of the scene, nor do gradients.

    Args:
        scene: A scene whose emitters are all area lights of one radiance. A ValueError names the
            first one of another kind, or says that there is none.

    Example:
        >>> light = {"type": "area", "radiance": {"type": "rgb", "value": 3.0}}
        >>> scene = mi.load_dict({"type": "scene", "lamp": {"type": "sphere", "emitter": light}})
        >>> emitters_of(scene)
        SurfaceGroup([Sphere((0, 0, 0), radius=1, emission=(3.0, 3.0, 3.0))])
    """
    checks.instance("scene", scene, mi.Scene, "a loaded scene")
    for emitter in scene.emitters():
        named = f"scene: emitter {emitter.id()!r}"
        if not mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
            raise ValueError(f"{named} has no surface; must be area lights")
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying):
            raise ValueError(f"{named} is textured; must be of one radiance")
    lights = [shape for shape in scene.shapes() if shape.is_emitter()]
    if not lights:
        raise ValueError("scene: has no emitter; must have area lights")
    return SurfaceGroup([each for shape in lights for each in _shapes_of(shape)])


def _shapes_of(shape: mi.Shape) -> list[Shape]:
    """Convert one light of the scene."""
    kind, radiance = shape.shape_type(), _radiance(shape)
    if kind not in (int(mi.ShapeType.Rectangle), int(mi.ShapeType.Sphere)):
        if isinstance(shape, mi.Mesh) and shape.face_count() <= MAX_TRIANGLES:
            return _triangles_of(shape, radiance)
        allowed = f"must be a rectangle, a sphere, or a mesh of at most {MAX_TRIANGLES} triangles"
        raise ValueError(f"scene: emitter on the shape {shape.id()!r}: {allowed}")
    to_world: Any = mi.traverse(shape)["to_world"]
    transform = np.array(to_world.matrix, dtype=np.float64).reshape(4, 4)
    sample = shape.sample_position(0.0, mi.Point2f(0.3, 0.6))
    p, n = (np.array(each, dtype=np.float64).ravel() for each in (sample.p, sample.n))
    if kind == int(mi.ShapeType.Sphere):
        sphere = Sphere(emission=radiance, transform=transform)
        sphere.flip_normals = bool(np.dot(p - sphere.centre, n) < 0)
        return [sphere]
    quad = Quad((2, 2), emission=radiance, transform=transform)
    if np.dot(quad.normal, n) < 0:
        quad = Quad.from_edges(quad.corner, quad.e1, quad.e0, emission=radiance)
    return [quad]


def _triangles_of(mesh: mi.Mesh, radiance: np.ndarray) -> list[Shape]:
    """Convert each face to a triangle, with the normal that a ray finds in the face's middle."""
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


def _radiance(shape: mi.Shape) -> np.ndarray:
    """Radiance at normal incidence, one value or three."""
    si = mi.SurfaceInteraction3f(shape.sample_position(0.0, mi.Point2f(0.5)), [])
    si.wi = mi.Vector3f(0, 0, 1)
    value = mi.unpolarized_spectrum(shape.emitter().eval(si))
    return np.array(value, dtype=np.float64).ravel()
