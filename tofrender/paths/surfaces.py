"""Surfaces of a scene: predicates, area elements, and the normals of emitters."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.interface import NORMALS, POSITIONS, make_mesh, rows
from ..scenes.media import BOUNDARY, PLATES

NARROW = 0.00068523  # Squared sine below which Mitsuba samples the cone of a sphere otherwise
# Extent of a scene over the radius of its smallest sphere light, above which densities of Mitsuba
# may be infinite. They are infinite at distances above 4000 radii.
VANISHING = 500
NORMAL_TOLERANCE = 1e-6  # 1 less the cosine between normals that count as the same


def is_on(si: mi.SurfaceInteraction3f, shapes: Sequence[mi.Shape]) -> mi.Bool:
    """Return lanes whose surface points are on one of some shapes."""
    found = mi.Bool(False)
    for shape in shapes:
        found |= si.shape == mi.ShapePtr(shape)
    return found & si.is_valid()


def number_of(pointer: mi.EmitterPtr | mi.BSDFPtr) -> mi.UInt32:
    """Return Dr.Jit's registry index of an emitter or a BSDF."""
    return dr.reinterpret_array(mi.UInt32, pointer)


def table_of(emitters: Sequence[mi.Emitter], values: Sequence, dtype: type) -> np.ndarray:
    """Return a table of values by the registry index of emitters, 0 for all others."""
    rows = [int(number_of(mi.EmitterPtr(emitter))[0]) for emitter in emitters]
    table = np.zeros((max(rows, default=0) + 1, *np.shape(values)[1:]), dtype)
    table[rows] = values
    return table


def materials(scene: mi.Scene) -> list[mi.BSDF]:
    """Return the BSDFs of all shapes, and of those that instances repeat."""
    shapes = scene.shapes()
    if any(shape.class_name() == "Instance" for shape in shapes):
        return bsdfs_in(scene)
    return [shape.bsdf() for shape in shapes]


def groups_of(scene: mi.Scene) -> list[mi.Shape]:
    """Return the shape groups that instances repeat."""
    if not any(shape.class_name() == "Instance" for shape in scene.shapes()):
        return []
    nodes = mi.traverse(scene).hierarchy
    return [node for node in nodes if node.class_name() == "ShapeGroupPlugin"]


def bsdfs_in(node: mi.Object) -> list[mi.BSDF]:
    """Return all BSDFs in a scene, or a BSDF and those that it is made of."""
    return [each for each in mi.traverse(node).hierarchy if isinstance(each, mi.BSDF)]


def name_of(scene: mi.Scene, bsdf: mi.BSDF) -> str:
    """Return the names of a BSDF and of the first shape that has it, for messages.

    Example:
        >>> scene = mi.load_dict({"type": "scene", "wall": {"type": "rectangle", "id": "wall"}})
        >>> name_of(scene, scene.shapes()[0].bsdf()).startswith("shape 'wall'")
        True
    """
    nodes = mi.traverse(scene).hierarchy
    shapes = [node for node in nodes if isinstance(node, mi.Shape) and node.bsdf() == bsdf]
    plain = f"bsdf {bsdf.id()!r}"
    return f"shape {shapes[0].id()!r} ({plain})" if shapes else plain


def is_boundary(bsdf: mi.BSDF | None) -> bool:
    """Whether a BSDF only marks an index-matched boundary of a medium."""
    if bsdf is None or int(bsdf.flags()) != BOUNDARY:
        return False
    return bsdf.class_name() not in PLATES


class Boundaries:
    """Index-matched boundaries of media; `exist` says whether the scene has any."""

    def __init__(self, scene: mi.Scene) -> None:
        null = dict.fromkeys(b for b in materials(scene) if int(b.flags()) == BOUNDARY)
        self._plates = [bsdf for bsdf in null if not is_boundary(bsdf)]
        self.exist = len(self._plates) < len(null)

    def contain(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Return lanes whose surface points are on one."""
        return self.have(si.bsdf(), active)

    def have(self, bsdf: mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
        """Return lanes in which a BSDF marks a boundary."""
        active = active & (bsdf.flags() == BOUNDARY)
        for plate in self._plates:
            active &= bsdf != mi.BSDFPtr(plate)
        return active


@dr.syntax
def first_surface(
    scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool | bool = True, more_flags: int = 0
) -> mi.SurfaceInteraction3f:
    """Intersect rays with surfaces that are no index-matched boundary; `t` is from the last one.

    `more_flags` are `mi.RayFlags` in addition to `All`.

    Example:
        >>> fog = {"type": "cube", "bsdf": {"type": "null"}}
        >>> wall = {"type": "rectangle", "id": "wall"}
        >>> scene = mi.load_dict({"type": "scene", "fog": fog, "wall": wall})
        >>> first_surface(scene, mi.Ray3f([0, 0, 5], [0, 0, -1])).p
        [[0, 0, 0]]
    """
    flags = int(mi.RayFlags.All) | more_flags
    si = scene.ray_intersect(ray, flags, False, mi.Bool(active))
    boundaries = Boundaries(scene)
    if boundaries.exist:
        ray = mi.Ray3f(ray)
        passing = boundaries.contain(si, mi.Bool(active) & si.is_valid())
        while passing:
            ray = dr.select(passing, spawn_ray(si, ray.d, mi.Bool(True)), ray)
            si = dr.select(passing, scene.ray_intersect(ray, flags, False, passing), si)
            passing = boundaries.contain(si, passing & si.is_valid())
    return si


def has_lobes(scene: mi.Scene, *lobes: mi.BSDFFlags) -> bool:
    """Whether a surface of the scene has one of the given lobes."""
    flags = [bsdf.flags() for bsdf in materials(scene)]
    return any(mi.has_flag(each, lobe) for each in flags for lobe in lobes)


def lets_straight_through(scene: mi.Scene) -> bool:
    """Whether a scene has panes (`thindielectric`), masks or polarisers."""
    through = [b for b in materials(scene) if mi.has_flag(b.flags(), mi.BSDFFlags.Null)]
    return not all(map(is_boundary, through))


def element(si: mi.SurfaceInteraction3f) -> mi.Float:
    """Return a surface's area element, whose derivative is that around a point fixed on it."""
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
    """Return 1, with the relative derivative of the area around points `p` that `si` sees."""
    with dr.suspend_grad():
        ray = si.spawn_ray(dr.normalize(p - si.p))
        found = scene.ray_intersect_preliminary(ray, active=active)
    at = found.compute_surface_interaction(ray, mi.RayFlags.All | mi.RayFlags.FollowShape, active)
    return changing(element(at), active & is_on(at, shapes))


class NarrowCones:
    """Densities of directions to sphere lights that fill narrow cones.

    Mitsuba samples such directions correctly, but computes the density 1 / (2 pi (1 - cos)) of the
    cone in single precision, where 1 - cos cancels. With s = radius / distance, the solid angle is

        2 pi s^2 / (1 + sqrt(1 - s^2)).

    Lights with a texture are excluded: Mitsuba samples them by area.
    """

    def __init__(self, scene: mi.Scene) -> None:
        emitters = scene.emitters()
        textured = mi.EmitterFlags.SpatiallyVarying
        spheres = np.zeros((len(emitters), 4))
        for row, emitter in zip(spheres, emitters, strict=True):
            shape = emitter.get_shape()
            is_sphere = shape is not None and shape.class_name() == "Sphere"
            if is_sphere and not mi.has_flag(emitter.flags(), textured):
                to_world = np.array(mi.traverse(shape)["to_world"].matrix, float).reshape(4, 4)
                row[:] = [*to_world[:3, 3], np.linalg.norm(to_world[:3, 0])]
        self.exist = bool(np.any(spheres))
        if not self.exist:
            return
        # Mitsuba's densities may be infinite, so that the weights do not contain the radiance
        smallest = spheres[spheres[:, 3] > 0, 3].min()
        self.vanish = float(dr.norm(scene.bbox().extents())) > VANISHING * smallest
        self.spheres = mi.Float(table_of(emitters, spheres, np.float32).ravel())
        self.total = dr.opaque(mi.Float, sum(float(each.sampling_weight()) for each in emitters))
        dr.eval(self.spheres)

    def pdf(
        self, p: mi.Point3f, emitter: mi.EmitterPtr, active: mi.Bool
    ) -> tuple[mi.Float, mi.Bool]:
        """Return the density of directions from points to an emitter [1/sr].

        Also returns the lanes in which the emitter is a sphere light that fills a narrow cone. The
        density does not include the probability of choosing the emitter.
        """
        row = number_of(emitter) * 4
        center = mi.Point3f(*(dr.gather(mi.Float, self.spheres, row + k, active) for k in range(3)))
        radius = dr.gather(mi.Float, self.spheres, row + 3, active)
        sin2 = dr.square(radius) / dr.squared_norm(center - p)
        narrow = active & (sin2 > 0) & (sin2 < NARROW)
        pdf = (1 + dr.sqrt(1 - sin2)) / (dr.two_pi * sin2)
        return dr.detach(dr.select(narrow, pdf, 0)), narrow

    def choice(self, emitter: mi.EmitterPtr) -> mi.Float:
        """Return the probability that the scene chooses an emitter."""
        return emitter.sampling_weight() / self.total


class EmitterSamples:
    """Direction samples of emitters, corrected where Mitsuba's densities are wrong.

    There are two corrections. The power of an emitter through an area has the geometric cosine,
    where Mitsuba uses the normals of a mesh's vertices. A mesh with smooth normals has a flat twin
    without, on which a random number samples the same point. `NarrowCones` describes the
    other correction.
    """

    def __init__(self, scene: mi.Scene) -> None:
        self.scene, emitters = scene, scene.emitters()
        self.cones = NarrowCones(scene)
        twins = [flat_twin(emitter.get_shape()) for emitter in emitters]
        self.twins = [twin for twin in twins if twin is not None]
        self.exist = bool(self.twins)
        if not self.exist:
            return
        # 1 + index into `twins`
        which = np.cumsum([twin is not None for twin in twins])
        which[[twin is None for twin in twins]] = 0
        self.which = mi.UInt32(table_of(emitters, which, np.uint32))
        dr.eval(self.which)

    def at(
        self, emitter: mi.EmitterPtr, time: mi.Float, u: mi.Point2f, n: mi.Normal3f, active: mi.Bool
    ) -> tuple[mi.Normal3f, mi.Bool]:
        """Return the normal at the point that `u` samples, else `n`, and lanes with such a one."""
        which = dr.gather(mi.UInt32, self.which, number_of(emitter), active)
        here = active & (which > 0)
        sample = [twin.sample_position for twin in self.twins]
        if len(sample) == 1:
            ps = sample[0](time, u, here)
        else:
            ps = dr.switch(dr.maximum(which, 1) - 1, sample, time, u, here)
        return dr.select(here, ps.n * dr.sign(dr.dot(ps.n, n)), n), here

    def sample_direction(
        self, at: mi.Interaction3f, u: mi.Point2f, active: mi.Bool | bool = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction to an emitter; returns it, and radiance over density."""
        ds, weight = self.scene.sample_emitter_direction(at, u, False, active)
        if self.cones.exist:
            ds, weight = self._in_cone(
                at, ds, weight, mi.Bool(active), self.cones.choice(ds.emitter)
            )
        if not self.exist:
            return ds, weight
        return self.by_area(ds, weight, mi.Point2f(self.scene.sample_emitter(u.x)[2], u.y), active)

    def sample_emitter(
        self, emitter: mi.EmitterPtr, at: mi.Interaction3f, u: mi.Point2f
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction to an emitter; returns it, and radiance over density."""
        ds, weight = emitter.sample_direction(at, u, True)
        if self.cones.exist:
            ds, weight = self._in_cone(at, ds, weight, mi.Bool(True), mi.Float(1))
        return self.by_area(ds, weight, u)

    def pdf_direction(
        self, at: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool | bool = True
    ) -> mi.Float:
        """Return the density of a direction in `sample_direction` [1/sr]."""
        pdf = self.scene.pdf_emitter_direction(at, ds, active)
        if self.cones.exist:
            in_cone, narrow = self.cones.pdf(at.p, ds.emitter, mi.Bool(active))
            pdf = dr.select(narrow, self._scaled(pdf, in_cone * self.cones.choice(ds.emitter)), pdf)
        return pdf

    def _in_cone(
        self,
        at: mi.Interaction3f,
        ds: mi.DirectionSample3f,
        weight: mi.Spectrum,
        active: mi.Bool,
        choice: mi.Float,
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Return a direction sample with the density of `NarrowCones` where that applies."""
        pdf, narrow = self.cones.pdf(at.p, ds.emitter, active)
        narrow &= ds.pdf > 0
        pdf = self._scaled(ds.pdf, pdf * choice)
        if self.cones.vanish:
            radiance = ds.emitter.eval_direction(at, ds, narrow)
        else:
            narrow &= dr.isfinite(ds.pdf)
            radiance = weight * ds.pdf
        ds.pdf = dr.select(narrow, pdf, ds.pdf)
        return ds, dr.select(narrow, radiance / pdf, weight)

    def _scaled(self, pdf: mi.Float, value: mi.Float) -> mi.Float:
        """Return a value with the relative derivative of a density, if that is finite."""
        own = dr.detach(pdf)
        return value * dr.select(dr.isfinite(own) & (own > 0), pdf / own, 1)

    def by_area(
        self, ds: mi.DirectionSample3f, weight: mi.Spectrum, u: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Return an emitter's direction sample by `u` with the geometric cosine."""
        if not self.exist:
            return ds, weight
        textured = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.SpatiallyVarying)
        n, here = self.at(ds.emitter, ds.time, u, ds.n, mi.Bool(active) & ~textured)
        cos, smooth = -dr.dot(ds.d, n), -dr.dot(ds.d, ds.n)
        ratio = dr.select(here, dr.select((cos > 0) & (smooth > 0), cos / smooth, 0), 1)
        ds.n, ds.pdf = n, dr.select(ratio > 0, ds.pdf / ratio, 0)
        return ds, weight * ratio


def flat_twin(shape: mi.Shape | None) -> mi.Mesh | None:
    """Return a mesh without the vertex normals of a shape; None if they are the geometric ones."""
    if shape is None or not shape.is_mesh():
        return None
    own = mi.traverse(shape)
    normals = rows(own, NORMALS)
    if not len(normals):
        return None
    points, faces = rows(own, POSITIONS), np.array(own["faces"]).reshape(-1, 3)
    a, b, c = points[faces.T]
    flat = np.cross(b - a, c - a)
    flat /= np.maximum(np.linalg.norm(flat, axis=1), 1e-30)[:, None]
    if np.allclose(np.abs(np.einsum("fkx,fx->fk", normals[faces], flat)), 1, atol=NORMAL_TOLERANCE):
        return None
    return make_mesh("twin", points, faces)


def changing(value: mi.Float, active: mi.Bool) -> mi.Float:
    """Return 1, with the relative derivative of a value."""
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
