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

# Largest number of triangles of a mesh, because a group tests all its shapes for each sample
MAX_TRIANGLES = 64


def emitters_of(scene: mi.Scene) -> SurfaceGroup:
    """Return all lights of a scene as one group.

    Rectangles become a `Quad`, spheres a `Sphere`, and meshes a `Triangle` for each face. Shapes
    emit on the same side as in Mitsuba, also with flipped normals. Current values are copied:
    later changes of the scene have no effect, and gradients are not tracked.

    Args:
        scene: A scene. All its emitters must be area lights with constant radiance.

    Raises:
        ValueError: The scene contains another emitter or none.

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
            raise ValueError(f"{named} has no surface; must be an area light")
        if mi.has_flag(emitter.flags(), mi.EmitterFlags.SpatiallyVarying):
            raise ValueError(f"{named} is textured; must have a constant radiance")
    lights = [shape for shape in scene.shapes() if shape.is_emitter()]
    if not lights:
        raise ValueError("scene: emitters are missing. Add an area light")
    return SurfaceGroup([each for shape in lights for each in _shapes_of(shape)])


def _shapes_of(shape: mi.Shape) -> list[Shape]:
    """Convert a light of the scene to one or more shapes."""
    # Meshes
    kind = shape.shape_type()
    radiance = _radiance(shape)
    if kind not in (int(mi.ShapeType.Rectangle), int(mi.ShapeType.Sphere)):
        if isinstance(shape, mi.Mesh) and shape.face_count() <= MAX_TRIANGLES:
            return _triangles_of(shape, radiance)
        allowed = f"must be a rectangle, a sphere, or a mesh of at most {MAX_TRIANGLES} triangles"
        raise ValueError(f"scene: emitter on the shape {shape.id()!r}: {allowed}")

    # Read the transform, and the side that emits
    to_world: Any = mi.traverse(shape)["to_world"]
    transform = np.array(to_world.matrix, dtype=np.float64).reshape(4, 4)
    sample = shape.sample_position(0.0, mi.Point2f(0.3, 0.6))
    p = np.array(sample.p, dtype=np.float64).ravel()
    n = np.array(sample.n, dtype=np.float64).ravel()

    # Spheres
    if kind == int(mi.ShapeType.Sphere):
        sphere = Sphere(emission=radiance, transform=transform)
        sphere.flip_normals = bool(np.dot(p - sphere.center, n) < 0)
        return [sphere]

    # Rectangles
    quad = Quad((2, 2), emission=radiance, transform=transform)
    if np.dot(quad.normal, n) < 0:
        quad = Quad.from_edges(quad.corner, quad.e1, quad.e0, emission=radiance)
    return [quad]


def _triangles_of(mesh: mi.Mesh, radiance: np.ndarray) -> list[Shape]:
    """Convert each face to a triangle, with the normal that a ray finds at its center."""
    # Trace a ray to the center of each face
    index = dr.arange(mi.UInt32, mesh.face_count())
    a, b, c = (mesh.vertex_position(each) for each in mesh.face_indices(index))
    middle = (a + b + c) / 3
    normal = mi.Vector3f(dr.normalize(dr.cross(b - a, c - a)))
    ray = mi.Ray3f(middle + normal, -normal)
    si = mesh.ray_intersect_triangle(index, ray).compute_surface_interaction(ray)

    # Reverse the corners of faces with a flipped normal
    flipped = np.array(dr.dot(si.sh_frame.n, normal) < 0)
    corners = np.array([a, b, c], dtype=np.float64).transpose(2, 0, 1)
    return [
        Triangle(*(each[::-1] if flip else each), emission=radiance)
        for each, flip in zip(corners, flipped, strict=True)
    ]


def _radiance(shape: mi.Shape) -> np.ndarray:
    """Return the radiance at normal incidence, one or three values."""
    si = mi.SurfaceInteraction3f(shape.sample_position(0.0, mi.Point2f(0.5)), [])
    si.wi = mi.Vector3f(0, 0, 1)
    value = mi.unpolarized_spectrum(shape.emitter().eval(si))
    return np.array(value, dtype=np.float64).ravel()
