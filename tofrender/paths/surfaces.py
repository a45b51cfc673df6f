"""Surfaces of a scene: predicates, area elements, and corrected emitter samples."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime.interface import NORMALS, POSITIONS, make_mesh, rows
from ..scenes.media import BOUNDARY, PLATES

# Squared sine of half the angle of a narrow cone. Below it, Mitsuba uses another way to sample the
# cone of a sphere
NARROW = 0.00068523

# Ratio of a scene's extent to the radius of its smallest sphere light. Above this ratio, Mitsuba's
# densities may be infinite: they are infinite at distances above 4000 radii
VANISHING = 500

# Largest value of 1 - cos between two normals that count as equal
NORMAL_TOLERANCE = 1e-6


def is_on(si: mi.SurfaceInteraction3f, shapes: Sequence[mi.Shape]) -> mi.Bool:
    """Return lanes with a surface point on one of the given shapes."""
    found = mi.Bool(False)
    for shape in shapes:
        found |= si.shape == mi.ShapePtr(shape)
    return found & si.is_valid()


def number_of(pointer: mi.EmitterPtr | mi.BSDFPtr) -> mi.UInt32:
    """Return Dr.Jit's registry index of an emitter or a BSDF."""
    return dr.reinterpret_array(mi.UInt32, pointer)


def table_of(emitters: Sequence[mi.Emitter], values: Sequence, dtype: type) -> np.ndarray:
    """Return a table of values, by the registry index of the emitter.

    Rows without an emitter are 0.

    Args:
        emitters: The emitters.
        values: One value or one sequence of values per emitter.
        dtype: Type of the table.
    """
    rows = [int(number_of(mi.EmitterPtr(emitter))[0]) for emitter in emitters]
    table = np.zeros((max(rows, default=0) + 1, *np.shape(values)[1:]), dtype)
    table[rows] = values
    return table


def materials(scene: mi.Scene) -> list[mi.BSDF]:
    """Return the BSDFs of all shapes, including shapes in shape groups of instances.

    The list contains a BSDF several times if several shapes have it. In a scene with instances, the
    list also contains the nested BSDFs.
    """
    shapes = scene.shapes()
    if any(shape.class_name() == "Instance" for shape in shapes):
        return bsdfs_in(scene)
    return [shape.bsdf() for shape in shapes]


def groups_of(scene: mi.Scene) -> list[mi.Shape]:
    """Return the shape groups of a scene, an empty list without instances."""
    if not any(shape.class_name() == "Instance" for shape in scene.shapes()):
        return []
    nodes = mi.traverse(scene).hierarchy
    return [node for node in nodes if node.class_name() == "ShapeGroupPlugin"]


def bsdfs_in(node: mi.Object) -> list[mi.BSDF]:
    """Return all BSDFs in a scene, or a BSDF and its nested BSDFs."""
    return [each for each in mi.traverse(node).hierarchy if isinstance(each, mi.BSDF)]


def name_of(scene: mi.Scene, bsdf: mi.BSDF) -> str:
    """Return the names of a BSDF and of the first shape with this BSDF, for messages.

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
    """Return whether a BSDF only marks an index-matched boundary of a medium, without a surface."""
    if bsdf is None or int(bsdf.flags()) != BOUNDARY:
        return False
    return bsdf.class_name() not in PLATES


class Boundaries:
    """Index-matched boundaries of media.

    Args:
        scene: The scene.

    Attributes:
        exist: Whether the scene has index-matched boundaries.
    """

    def __init__(self, scene: mi.Scene) -> None:
        # Plates have the same flags as boundaries, so that lanes must exclude them one by one
        null = dict.fromkeys(b for b in materials(scene) if int(b.flags()) == BOUNDARY)
        self._plates = [bsdf for bsdf in null if not is_boundary(bsdf)]
        self.exist = len(self._plates) < len(null)

    def contain(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Return lanes with a surface point on a boundary."""
        return self.have(si.bsdf(), active)

    def have(self, bsdf: mi.BSDFPtr, active: mi.Bool) -> mi.Bool:
        """Return lanes with a BSDF that marks a boundary."""
        active = active & (bsdf.flags() == BOUNDARY)
        for plate in self._plates:
            active &= bsdf != mi.BSDFPtr(plate)
        return active


@dr.syntax
def first_surface(
    scene: mi.Scene, ray: mi.Ray3f, active: mi.Bool | bool = True, more_flags: int = 0
) -> mi.SurfaceInteraction3f:
    """Find the first surface along rays that is not an index-matched boundary.

    The distance `t` of the result starts at the last boundary that a ray has passed.

    Args:
        scene: The scene.
        ray: The rays.
        active: Active lanes.
        more_flags: Flags `mi.RayFlags` in addition to `mi.RayFlags.All`.

    Example:
        >>> fog = {"type": "cube", "bsdf": {"type": "null"}}
        >>> wall = {"type": "rectangle", "id": "wall"}
        >>> scene = mi.load_dict({"type": "scene", "fog": fog, "wall": wall})
        >>> first_surface(scene, mi.Ray3f([0, 0, 5], [0, 0, -1])).p
        [[0, 0, 0]]
    """
    # Find the first intersection
    flags = int(mi.RayFlags.All) | more_flags
    si = scene.ray_intersect(ray, flags, False, mi.Bool(active))

    # Continue behind boundaries
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
    """Return whether a surface of the scene has at least one of the given lobes."""
    flags = [bsdf.flags() for bsdf in materials(scene)]
    return any(mi.has_flag(each, lobe) for each in flags for lobe in lobes)


def lets_straight_through(scene: mi.Scene) -> bool:
    """Return whether a scene has panes (`thindielectric`), masks or polarizers."""
    through = [b for b in materials(scene) if mi.has_flag(b.flags(), mi.BSDFFlags.Null)]
    return not all(map(is_boundary, through))


def element(si: mi.SurfaceInteraction3f) -> mi.Float:
    """Return the area element of a surface at given points.

    The derivative of the area element follows points that are fixed on a moving surface.
    """
    # Meshes: the area of the triangle
    flat = si.is_valid() & si.shape.is_mesh()
    mesh = mi.MeshPtr(dr.select(flat, si.shape, dr.zeros(mi.ShapePtr)))
    corners = mesh.face_indices(si.prim_index, flat)
    a, b, c = (mesh.vertex_position(each, flat) for each in corners)
    face = dr.cross(b - a, c - a)

    # Other shapes: the area of a parameter element
    curved = dr.cross(si.dp_du, si.dp_dv)
    return dr.norm(dr.select(flat, face, curved))


def area_change(
    scene: mi.Scene,
    shapes: Sequence[mi.Shape],
    si: mi.SurfaceInteraction3f,
    p: mi.Point3f,
    active: mi.Bool,
) -> mi.Float:
    """Return 1 with the relative derivative of the area around points on some shapes.

    Args:
        scene: The scene.
        shapes: Shapes with derivatives of their area.
        si: Interactions that see the points.
        p: The points [m].
        active: Active lanes.
    """
    # Find the surfaces of the points without derivatives
    with dr.suspend_grad():
        ray = si.spawn_ray(dr.normalize(p - si.p))
        found = scene.ray_intersect_preliminary(ray, active=active)

    # Attach the derivatives of moving surfaces
    at = found.compute_surface_interaction(ray, mi.RayFlags.All | mi.RayFlags.FollowShape, active)
    return changing(element(at), active & is_on(at, shapes))


class NarrowCones:
    """Densities of directions to sphere lights in narrow cones.

    Mitsuba samples such directions correctly. However, Mitsuba computes the density of the cone,
    1 / (2 pi (1 - cos)), in single precision, where 1 - cos cancels. With s = radius / distance,
    this class computes the solid angle of the cone as

        2 pi s^2 / (1 + sqrt(1 - s^2)).

    Lights with a texture are excluded, because Mitsuba samples them by area.

    Args:
        scene: The scene.

    Attributes:
        exist: Whether the scene has sphere lights without a texture.
        vanish: Whether Mitsuba's densities may be infinite in this scene.
        spheres: Center and radius of each sphere light [m], by the registry index of the emitter.
        total: Sum of the sampling weights of all emitters.
    """

    def __init__(self, scene: mi.Scene) -> None:
        # Find the sphere lights without a texture
        emitters = scene.emitters()
        textured = mi.EmitterFlags.SpatiallyVarying
        spheres = np.zeros((len(emitters), 4))
        for row, emitter in zip(spheres, emitters, strict=True):
            shape = emitter.get_shape()
            is_sphere = shape is not None and shape.class_name() == "Sphere"
            if is_sphere and not mi.has_flag(emitter.flags(), textured):
                to_world = np.array(mi.traverse(shape)["to_world"].matrix, float).reshape(4, 4)
                row[:3] = to_world[:3, 3]
                row[3] = np.linalg.norm(to_world[:3, 0])
        self.exist = bool(np.any(spheres))
        if not self.exist:
            return

        # Where Mitsuba's densities are infinite, its weights do not contain the radiance
        smallest = spheres[spheres[:, 3] > 0, 3].min()
        self.vanish = float(dr.norm(scene.bbox().extents())) > VANISHING * smallest

        # Create the tables
        self.spheres = mi.Float(table_of(emitters, spheres, np.float32).ravel())
        self.total = dr.opaque(mi.Float, sum(float(each.sampling_weight()) for each in emitters))
        dr.eval(self.spheres)

    def pdf(
        self, p: mi.Point3f, emitter: mi.EmitterPtr, active: mi.Bool
    ) -> tuple[mi.Float, mi.Bool]:
        """Return the density of directions from points to an emitter [1/sr].

        The density does not include the probability of choosing the emitter. The second result is
        the mask of lanes with a sphere light in a narrow cone. In other lanes, the density is 0.

        Args:
            p: Points that see the emitter [m].
            emitter: Emitter of each lane.
            active: Active lanes.
        """
        # Center and radius of the sphere light, 0 for other emitters
        row = number_of(emitter) * 4
        center = mi.Point3f(*(dr.gather(mi.Float, self.spheres, row + k, active) for k in range(3)))
        radius = dr.gather(mi.Float, self.spheres, row + 3, active)

        # Is the cone narrow?
        sin2 = dr.square(radius) / dr.squared_norm(center - p)
        narrow = active & (sin2 > 0) & (sin2 < NARROW)

        # Density: 1 over the solid angle
        pdf = (1 + dr.sqrt(1 - sin2)) / (dr.two_pi * sin2)
        return dr.detach(dr.select(narrow, pdf, 0)), narrow

    def choice(self, emitter: mi.EmitterPtr) -> mi.Float:
        """Return the probability that the scene chooses an emitter."""
        return emitter.sampling_weight() / self.total


class EmitterSamples:
    """Direction samples of emitters, with corrections of Mitsuba's densities.

    There are two corrections. First, the flux of an emitter through an area depends on the cosine
    to the geometric normal, but Mitsuba uses the vertex normals of a mesh. Therefore each mesh with
    smooth normals has a flat twin: a mesh without vertex normals. Equal random numbers sample equal
    points on a mesh and its twin, and the twin returns the geometric normal. `NarrowCones`
    describes the second correction.

    Args:
        scene: The scene.

    Attributes:
        exist: Whether the scene has emitters with a flat twin.
    """

    def __init__(self, scene: mi.Scene) -> None:
        self.scene = scene
        emitters = scene.emitters()
        self.cones = NarrowCones(scene)

        # Create the twins
        twins = [flat_twin(emitter.get_shape()) for emitter in emitters]
        self.twins = [twin for twin in twins if twin is not None]
        self.exist = bool(self.twins)
        if not self.exist:
            return

        # 1 + index of each emitter's twin, 0 for emitters without a twin
        which = np.cumsum([twin is not None for twin in twins])
        which[[twin is None for twin in twins]] = 0
        self.which = mi.UInt32(table_of(emitters, which, np.uint32))
        dr.eval(self.which)

    def at(
        self, emitter: mi.EmitterPtr, time: mi.Float, u: mi.Point2f, n: mi.Normal3f, active: mi.Bool
    ) -> tuple[mi.Normal3f, mi.Bool]:
        """Return the geometric normals of emitter samples, and the lanes with a flat twin.

        In other lanes, the normal is `n`.

        Args:
            emitter: Emitter of each lane.
            time: Time of each ray [s].
            u: Uniform random numbers that sample the point on the emitter.
            n: Normal of the emitter sample, as Mitsuba returns it.
            active: Active lanes.
        """
        # Sample the point on the twin of each emitter
        which = dr.gather(mi.UInt32, self.which, number_of(emitter), active)
        here = active & (which > 0)
        sample = [twin.sample_position for twin in self.twins]
        if len(sample) == 1:
            ps = sample[0](time, u, here)
        else:
            ps = dr.switch(dr.maximum(which, 1) - 1, sample, time, u, here)

        # Point to the same side as Mitsuba's normal
        return dr.select(here, ps.n * dr.sign(dr.dot(ps.n, n)), n), here

    def sample_direction(
        self, at: mi.Interaction3f, u: mi.Point2f, active: mi.Bool | bool = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample an emitter of the scene, and a direction to this emitter.

        Returns the direction sample, and radiance over density.

        Args:
            at: Interactions that see the emitter.
            u: Uniform random numbers.
            active: Active lanes.
        """
        ds, weight = self.scene.sample_emitter_direction(at, u, False, active)

        # Correct the density of narrow cones
        if self.cones.exist:
            choice = self.cones.choice(ds.emitter)
            ds, weight = self._in_cone(at, ds, weight, mi.Bool(active), choice)
        if not self.exist:
            return ds, weight

        # Correct the cosine. The choice of an emitter rescales the first random number
        rescaled = self.scene.sample_emitter(u.x)[2]
        return self.by_area(ds, weight, mi.Point2f(rescaled, u.y), active)

    def sample_emitter(
        self, emitter: mi.EmitterPtr, at: mi.Interaction3f, u: mi.Point2f
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction to a given emitter.

        Returns the direction sample, and radiance over density.

        Args:
            emitter: The emitter.
            at: Interactions that see the emitter.
            u: Uniform random numbers.
        """
        ds, weight = emitter.sample_direction(at, u, True)
        if self.cones.exist:
            ds, weight = self._in_cone(at, ds, weight, mi.Bool(True), mi.Float(1))
        return self.by_area(ds, weight, u)

    def pdf_direction(
        self, at: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool | bool = True
    ) -> mi.Float:
        """Return the density of a direction sample of `sample_direction` [1/sr]."""
        pdf = self.scene.pdf_emitter_direction(at, ds, active)
        if self.cones.exist:
            in_cone, narrow = self.cones.pdf(at.p, ds.emitter, mi.Bool(active))
            corrected = self._scaled(pdf, in_cone * self.cones.choice(ds.emitter))
            pdf = dr.select(narrow, corrected, pdf)
        return pdf

    def _in_cone(
        self,
        at: mi.Interaction3f,
        ds: mi.DirectionSample3f,
        weight: mi.Spectrum,
        active: mi.Bool,
        choice: mi.Float,
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Return a direction sample and its weight, with the density of narrow cones.

        Samples outside of narrow cones do not change.

        Args:
            at: Interactions that see the emitter.
            ds: Direction sample of Mitsuba. The density of this object changes.
            weight: Radiance over density.
            active: Active lanes.
            choice: Probability of choosing the emitter.
        """
        # Correct the density
        pdf, narrow = self.cones.pdf(at.p, ds.emitter, active)
        narrow &= ds.pdf > 0
        pdf = self._scaled(ds.pdf, pdf * choice)

        # Find the radiance. Mitsuba's weight contains the radiance if its density is finite
        if self.cones.vanish:
            radiance = ds.emitter.eval_direction(at, ds, narrow)
        else:
            narrow &= dr.isfinite(ds.pdf)
            radiance = weight * ds.pdf
        ds.pdf = dr.select(narrow, pdf, ds.pdf)
        return ds, dr.select(narrow, radiance / pdf, weight)

    def _scaled(self, pdf: mi.Float, value: mi.Float) -> mi.Float:
        """Return a value with the relative derivative of a density `pdf`.

        The derivative is 0 if the density is 0 or infinite.
        """
        detached = dr.detach(pdf)
        return value * dr.select(dr.isfinite(detached) & (detached > 0), pdf / detached, 1)

    def by_area(
        self, ds: mi.DirectionSample3f, weight: mi.Spectrum, u: mi.Point2f, active: mi.Bool = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Return a direction sample and its weight, with the geometric cosine of the emitter.

        Args:
            ds: Direction sample of Mitsuba. Normal and density of this object change.
            weight: Radiance over density.
            u: Uniform random numbers that have sampled the point on the emitter.
            active: Active lanes.
        """
        if not self.exist:
            return ds, weight

        # Find the geometric normal. Mitsuba samples emitters with a texture in another way
        textured = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.SpatiallyVarying)
        n, here = self.at(ds.emitter, ds.time, u, ds.n, mi.Bool(active) & ~textured)

        # Multiply by the ratio of the geometric cosine to the cosine of the vertex normals
        cos = -dr.dot(ds.d, n)
        smooth_cos = -dr.dot(ds.d, ds.n)
        ratio = dr.select(here, dr.select((cos > 0) & (smooth_cos > 0), cos / smooth_cos, 0), 1)
        ds.n = n
        ds.pdf = dr.select(ratio > 0, ds.pdf / ratio, 0)
        return ds, weight * ratio


def flat_twin(shape: mi.Shape | None) -> mi.Mesh | None:
    """Return a copy of a mesh without vertex normals.

    Returns None for other shapes, and for meshes without vertex normals. Also returns None if the
    vertex normals are equal to the geometric normals.
    """
    if shape is None or not shape.is_mesh():
        return None

    # Read the mesh
    parameters = mi.traverse(shape)
    normals = rows(parameters, NORMALS)
    if not len(normals):
        return None
    points = rows(parameters, POSITIONS)
    faces = np.array(parameters["faces"]).reshape(-1, 3)

    # Compare its vertex normals with the normals of the triangles
    a, b, c = points[faces.T]
    flat = np.cross(b - a, c - a)
    flat /= np.maximum(np.linalg.norm(flat, axis=1), 1e-30)[:, None]
    if np.allclose(np.abs(np.einsum("fkx,fx->fk", normals[faces], flat)), 1, atol=NORMAL_TOLERANCE):
        return None
    return make_mesh("twin", points, faces)


def changing(value: mi.Float, active: mi.Bool) -> mi.Float:
    """Return 1 with the relative derivative of a value.

    The derivative is 0 in inactive lanes, and if the value is not positive.
    """
    active &= value > 0
    return dr.select(active, value / dr.detach(value), 1)


def spawn_ray(si: mi.SurfaceInteraction3f, d: mi.Vector3f, specular: mi.Bool) -> mi.Ray3f:
    """Spawn a ray from a surface point, with a small offset from the surface.

    Mitsuba's offset is along the normal. After a delta lobe, this offset would shift all later
    vertices to the side. Therefore the offset of these rays is along the ray. Its distance from the
    surface is the same. At grazing angles, the offset is at most ten times as long.

    Args:
        si: Surface interaction.
        d: Unit vector in world space.
        specular: Lanes with a ray from a delta lobe.
    """
    ray = si.spawn_ray(d)
    along = dr.norm(ray.o - si.p) / dr.maximum(dr.abs(dr.dot(si.n, d)), 0.1)
    ray.o = dr.select(specular, dr.fma(d, along, si.p), ray.o)
    return ray
