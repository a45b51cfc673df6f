"""Telling on which shapes surface points are, and which surfaces let light through."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scenes.media import BOUNDARY, PLATES

LEANING = 1e-6
"""1 less the cosine between normals that count as the same."""


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


def number_of(pointer: Any) -> mi.UInt32:
    """The number by which Dr.Jit knows an emitter or a material."""
    return dr.reinterpret_array(mi.UInt32, pointer)


def materials(scene: mi.Scene) -> list[mi.BSDF]:
    """The materials of all shapes, and of those that instances repeat."""
    shapes = scene.shapes()
    if any(shape.class_name() == "Instance" for shape in shapes):
        return [node for node in mi.traverse(scene).hierarchy if isinstance(node, mi.BSDF)]
    return [shape.bsdf() for shape in shapes]


def is_boundary(bsdf: mi.BSDF | None) -> bool:
    """Whether a material is nothing but where a medium ends whose index is that of what is around.

    Example:
        >>> is_boundary(mi.load_dict({"type": "null"}))
        True
    """
    if bsdf is None or int(bsdf.flags()) != BOUNDARY:
        return False
    return bsdf.class_name() not in PLATES


class Boundaries:
    """Surfaces that are nothing but where a medium ends whose index is that of what is around.

    Args:
        scene: The scene.

    Attributes:
        exist: Whether there are any.
    """

    def __init__(self, scene: mi.Scene) -> None:
        null = [bsdf for bsdf in materials(scene) if int(bsdf.flags()) == BOUNDARY]
        plates = [bsdf for bsdf in null if bsdf.class_name() in PLATES]
        self.exist = len(plates) < len(null)
        self._plates = [bsdf for k, bsdf in enumerate(plates) if bsdf not in plates[:k]]

    def contain(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Whether surface points are on one of them."""
        active = active & (si.bsdf().flags() == BOUNDARY)
        for plate in self._plates:
            active &= si.bsdf() != mi.BSDFPtr(plate)
        return active


def first_surface(
    scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool | bool = True
) -> mi.SurfaceInteraction3f:
    """Intersect rays with surfaces that are no index-matched boundary; `t` is from the last one.

    Example:
        >>> fog = {"type": "cube", "bsdf": {"type": "null"}}
        >>> wall = {"type": "rectangle", "id": "wall"}
        >>> scene = mi.load_dict({"type": "scene", "fog": fog, "wall": wall})
        >>> first_surface(scene, mi.Ray3f([0, 0, 5], [0, 0, -1])).p
        [[0, 0, 0]]
    """
    si = scene.ray_intersect(ray, mi.Bool(active))
    boundaries = Boundaries(scene)
    return _behind(scene, boundaries, ray, si, active) if boundaries.exist else si


@dr.syntax
def _behind(scene: Any, boundaries: Any, ray: Any, si: Any, active: Any) -> Any:
    """The loop through boundaries."""
    ray = mi.Ray3f(ray)
    passing = boundaries.contain(si, mi.Bool(active) & si.is_valid())
    while passing:
        ray = dr.select(passing, spawn_ray(si, ray.d, mi.Bool(True)), ray)
        si = dr.select(passing, scene.ray_intersect(ray, passing), si)
        passing = boundaries.contain(si, passing & si.is_valid())
    return si


def transmits(scene: mi.Scene, *ways: mi.BSDFFlags) -> bool:
    """Whether a surface of the scene lets light through in one of the given ways."""
    flags = [bsdf.flags() for bsdf in materials(scene)]
    return any(mi.has_flag(each, way) for each in flags for way in ways)


def lets_straight_through(scene: mi.Scene) -> bool:
    """Whether a surface of the scene lets light straight through and is more than a boundary.

    Panes (`thindielectric`), masks and polarisers do, in part.
    """
    through = [b for b in materials(scene) if mi.has_flag(b.flags(), mi.BSDFFlags.Null)]
    return not all(map(is_boundary, through))


def has_mirrors(scene: mi.Scene) -> bool:
    """Whether a surface of the scene sends light on in single directions: mirrors, glass, masks."""
    return any(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) for bsdf in materials(scene))


def element(si: mi.SurfaceInteraction3f) -> mi.Float:
    """Area that a step of a surface's own coordinates covers, up to a constant of each surface.

    Its change is that of the area around a point that keeps its place on the surface.
    """
    flat = si.is_valid() & si.shape.is_mesh()
    mesh = mi.MeshPtr(dr.select(flat, si.shape, dr.zeros(mi.ShapePtr)))
    corners = mesh.face_indices(si.prim_index, flat)
    a, b, c = (mesh.vertex_position(each, flat) for each in corners)
    face, curved = dr.cross(b - a, c - a), dr.cross(si.dp_du, si.dp_dv)
    return dr.norm(dr.select(flat, face, curved))


def stretched(
    scene: mi.Scene,
    shapes: Sequence[mi.Shape],
    si: mi.SurfaceInteraction3f,
    p: mi.Point3f,
    active: mi.Bool,
) -> mi.Float:
    """1, with the relative change of the area around points `p` that `si` sees on some shapes."""
    with dr.suspend_grad():
        ray = si.spawn_ray(dr.normalize(p - si.p))
        found = scene.ray_intersect_preliminary(ray, active=active)
    at = found.compute_surface_interaction(ray, mi.RayFlags.All | mi.RayFlags.FollowShape, active)
    return changing(element(at), active & is_on(at, shapes))


class LampNormals:
    """Geometric normals at points of lamps, where Mitsuba gives those of a mesh's vertices.

    What a lamp sends through an area is by the geometric cosine. A mesh with smooth normals has a
    twin without, on which the same two numbers stand for the same point.

    Args:
        scene: The scene.

    Attributes:
        exist: Whether there are lamps whose normals differ.
    """

    def __init__(self, scene: mi.Scene) -> None:
        self.scene, emitters = scene, scene.emitters()
        twins = [flat_twin(emitter.get_shape()) for emitter in emitters]
        self.twins = [twin for twin in twins if twin is not None]
        self.exist = bool(self.twins)
        if not self.exist:
            return
        numbers = [int(number_of(mi.EmitterPtr(emitter))[0]) for emitter in emitters]
        which = np.zeros(max(numbers) + 1, np.uint32)
        of_twins = [number for number, twin in zip(numbers, twins, strict=True) if twin is not None]
        which[of_twins] = np.arange(1, len(of_twins) + 1)
        self.which = mi.UInt32(which)
        dr.eval(self.which)

    def at(
        self, emitter: Any, time: mi.Float, u: mi.Point2f, n: mi.Normal3f, active: Any
    ) -> tuple[mi.Normal3f, mi.Bool]:
        """The normal at the point that `u` stands for, `n` by the vertices; lanes that have one."""
        which = dr.gather(mi.UInt32, self.which, number_of(emitter), active)
        here = active & (which > 0)
        ways = [twin.sample_position for twin in self.twins]
        found = (
            ways[0](time, u, here)
            if len(ways) == 1
            else dr.switch(dr.maximum(which, 1) - 1, ways, time, u, here)
        ).n
        return dr.select(here, found * dr.sign(dr.dot(found, n)), n), here

    def sample_direction(
        self, at: mi.Interaction3f, u: mi.Point2f, active: Any = True
    ) -> tuple[Any, Any]:
        """Sample a direction to an emitter; returns it, and radiance over density."""
        ds, weight = self.scene.sample_emitter_direction(at, u, False, active)
        if not self.exist:
            return ds, weight
        return self.by_area(ds, weight, mi.Point2f(self.scene.sample_emitter(u.x)[2], u.y), active)

    def by_area(self, ds: Any, weight: Any, u: mi.Point2f, active: Any = True) -> tuple[Any, Any]:
        """A direction that an emitter has sampled by `u`, with the geometric cosine."""
        if not self.exist:
            return ds, weight
        textured = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.SpatiallyVarying)
        n, here = self.at(ds.emitter, ds.time, u, ds.n, mi.Bool(active) & ~textured)
        cos, smooth = -dr.dot(ds.d, n), -dr.dot(ds.d, ds.n)
        ratio = dr.select(here, dr.select((cos > 0) & (smooth > 0), cos / smooth, 0), 1)
        ds.n, ds.pdf = n, dr.select(ratio > 0, ds.pdf / ratio, 0)
        return ds, weight * ratio


def flat_twin(shape: mi.Shape | None) -> mi.Mesh | None:
    """A mesh without the vertex normals of a shape; None if those are the geometric ones."""
    if shape is None or not shape.is_mesh():
        return None
    own: Any = mi.traverse(shape)
    normals = np.array(own["vertex_normals"]).reshape(-1, 3) if "vertex_normals" in own else []
    if not len(normals):
        return None
    places, faces = (np.array(own[name]).reshape(-1, 3) for name in ("vertex_positions", "faces"))
    a, b, c = places[faces.T]
    flat = np.cross(b - a, c - a)
    flat /= np.maximum(np.linalg.norm(flat, axis=1), 1e-30)[:, None]
    if np.allclose(np.abs(np.einsum("fkx,fx->fk", normals[faces], flat)), 1, atol=LEANING):
        return None
    twin = mi.Mesh("twin", len(places), len(faces))
    parameters: Any = mi.traverse(twin)
    parameters["vertex_positions"], parameters["faces"] = own["vertex_positions"], own["faces"]
    parameters.update()
    return twin


def changing(value: mi.Float, active: mi.Bool) -> mi.Float:
    """1, with the relative change of a value."""
    active &= value > 0
    return dr.select(active, value / dr.detach(value), 1)


def spawn_ray(si: mi.SurfaceInteraction3f, d: mi.Vector3f, specular: mi.Bool) -> mi.Ray3f:
    """Spawn a ray from a surface point in direction `d`, offset a little from the surface.

    Mitsuba offsets along the normal. After delta lobes, whose direction is not random, that would
    shift all further vertices sideways: there the offset is along the ray, as far off the surface,
    but at most ten times that far at grazing angles.
    """
    ray = si.spawn_ray(d)
    along = dr.norm(ray.o - si.p) / dr.maximum(dr.abs(dr.dot(si.n, d)), 0.1)
    ray.o = dr.select(specular, dr.fma(d, along, si.p), ray.o)
    return ray
