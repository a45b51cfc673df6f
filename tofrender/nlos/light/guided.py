"""Path guiding to target surfaces: hidden geometry that BSDF samples rarely find.

With the probability s, the next direction points to a uniform random point on the target surfaces.
Otherwise the direction is sampled from the BSDF. Let y be the next vertex, seen from x at the
distance r, with the cosine cos at y. The combined density per solid angle at x is

    p(y) = (1 - s) p_bsdf + s r² / (A |cos|)

with the total area A of the targets. The second term applies only if y is on a target. Target
points that are occluded contribute nothing. The throughput is divided by p(y) for both techniques.
This is Veach's one-sample model with the balance heuristic (1997, section 9.2.4). Both sides of
a surface count.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import copy

import drjit as dr
import mitsuba as mi
import numpy as np

from ...paths.protocols import Scattering, ScatteringWrapper
from ...paths.records import BSDFEval, BSDFSample, Connection, Path, Vertex
from ...paths.surfaces import is_on

# Value of `Path.guide` if the direction was sampled from the BSDF
MATERIAL = -1.0

# Relative distance by which rounding may move the end of a ray away from its target point
REACHED = 1e-3

# Shapes for which a sampled point has the same normal as a ray intersection (`Sphere` differs)
PLAIN_SHAPES = ("Rectangle", "Cube", "Disk", "Cylinder")

# Parameters of BSDFs that do not vary over the surface
PLAIN_MATERIALS = re.compile(r"(\w+\.)*(reflectance\.value|lobe_exponent)")


def is_plain(shape: mi.Shape) -> bool:
    """Return whether a BSDF depends on position and geometric normal only, without textures."""
    flat = shape.is_mesh() and not shape.has_vertex_normals()
    if not flat and shape.class_name() not in PLAIN_SHAPES:
        return False
    names = list(mi.traverse(shape.bsdf()).keys())
    return bool(names) and all(PLAIN_MATERIALS.fullmatch(name) for name in names)


class Targets:
    """Target surfaces of a scene. Points on them are sampled uniformly by area.

    Args:
        scene: The scene.
        shapes: Target shapes of this scene.

    Raises:
        ValueError: A target is an instance.
    """

    def __init__(self, scene: mi.Scene, shapes: Sequence[mi.Shape]) -> None:
        self.shapes = list(shapes)
        for shape in self.shapes:
            if shape.class_name() == "Instance":
                raise ValueError(
                    f"hidden_shapes = {shape.id()!r}: instances are not supported as targets. Use "
                    "a plain shape, or set nlos_hidden_geometry_sampling to false"
                )
        areas = np.array([shape.surface_area()[0] for shape in self.shapes])
        cumulative = np.cumsum(areas) / areas.sum()

        # Total area of all targets [m²]
        self.area = dr.opaque(mi.Float, float(areas.sum()))

        # Interval of the random number that selects each target
        self.upper = mi.Float(cumulative.tolist())
        self.lower = mi.Float([0.0, *cumulative[:-1].tolist()])

        # Pointers to the targets
        everything = scene.shapes()
        indices = [everything.index(shape) for shape in self.shapes]
        self.pointers = dr.gather(mi.ShapePtr, scene.shapes_dr(), mi.UInt32(indices))

        self.plain = all(map(is_plain, self.shapes))
        dr.eval(self.upper, self.lower, self.pointers)

    def sample(self, u: mi.Point2f, active: mi.Bool) -> tuple[mi.PositionSample3f, mi.ShapePtr]:
        """Sample a point uniformly by area, and return the point and its shape."""
        # Choose a target
        index = mi.UInt32(0)
        for k in range(len(self.shapes) - 1):
            index[u.x >= dr.gather(mi.Float, self.upper, k)] = k + 1

        # Reuse the random number for the position on the target
        low = dr.gather(mi.Float, self.lower, index)
        high = dr.gather(mi.Float, self.upper, index)
        inside = dr.clip((u.x - low) / (high - low), 0, dr.one_minus_epsilon(mi.Float))

        # Call a single target directly. A call by pointer compiles the code of all shapes in
        # memory, also of other scenes
        shape = dr.gather(mi.ShapePtr, self.pointers, index, active)
        called = self.shapes[0] if len(self.shapes) == 1 else shape
        return called.sample_position(0.0, mi.Point2f(inside, u.y), active), shape

    def density(self, si: mi.SurfaceInteraction3f, previous: mi.Interaction3f) -> mi.Float:
        """Return the density r² / (A |cos|) of sampling the direction to `si` [1/sr]."""
        to_target = si.p - previous.p
        r2 = dr.squared_norm(to_target)
        cos = dr.abs(dr.dot(si.n, to_target)) * dr.rsqrt(r2)
        return dr.select(is_on(si, self.shapes) & (cos > 0), r2 / (self.area * cos), 0)


class Guided(ScatteringWrapper):
    """Scattering that also samples directions to targets, at points of given shapes.

    `Path.guide` is the distance to the target point if the path's ray was sampled towards a
    target. If the ray was sampled from the BSDF instead, `Path.guide` is `MATERIAL`. Elsewhere it
    is 0.

    Args:
        inner: Scattering without guiding.
        targets: The target surfaces.
        guided_shapes: Shapes on which paths are guided, usually the relay wall.
        probability: Probability s of sampling a target, in (0, 1]. With 1, the BSDF is not sampled.
    """

    def __init__(
        self,
        inner: Scattering,
        targets: Targets,
        guided_shapes: Sequence[mi.Shape],
        probability: float,
    ) -> None:
        super().__init__(inner)
        self.targets = targets
        self.guided_shapes = list(guided_shapes)
        self.probability = probability

    def guide(self) -> mi.Float:
        """Return the initial value of `Path.guide`, 0."""
        return mi.Float(0)

    def guides_at(self, vertex: Vertex, active: mi.Bool) -> mi.Bool:
        """Return the lanes in which a vertex samples directions to targets."""
        return active & self.smooth(vertex) & is_on(vertex.si, self.guided_shapes)

    def is_combined(self, path: Path) -> mi.Bool:
        """Return the lanes in which both techniques could have sampled the path's ray."""
        return (path.guide != 0) & ~path.specular

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the BSDF. The density includes the probability of sampling the BSDF."""
        bsdf_eval = self.inner.eval_pdf(vertex, direction, active)
        bsdf_eval.pdf *= self._bsdf_probability(vertex)
        return bsdf_eval

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample a direction to a target with the probability s, otherwise from the BSDF.

        The density of the sample is the BSDF's density. The weight is the BSDF value over the
        density of the technique that was chosen. It lacks the cosine at the target, which
        `complete_sample` adds.
        """
        # Sample the BSDF
        bsdf_eval, bsdf_sample = self.inner.sample(vertex, connection, sampler, active)
        if bsdf_eval is not None:
            bsdf_eval.pdf *= self._bsdf_probability(vertex)

        # Sample a point on a target, and evaluate the BSDF for its direction
        xi = sampler.next_1d()
        u = sampler.next_2d()
        guided = self.guides_at(vertex, active)
        chosen = guided & (xi < self.probability)
        si = vertex.si
        to_target = self.targets.sample(u, chosen)[0].p - si.p
        r = dr.norm(to_target)
        d = to_target / r
        sent = self.inner.eval_pdf(vertex, d, chosen)

        # Divide by the probability of the chosen technique
        by_material = 1 - self.probability
        factor = dr.select(guided, dr.rcp(by_material) if by_material > 0 else 0.0, 1)
        reflected = mi.unpolarized_spectrum(sent.f) / self.target_density(r)
        weight = mi.unpolarized_spectrum(bsdf_sample.weight) * factor

        # Select the chosen technique
        bsdf_sample.ray = dr.select(chosen, ray_to(si, d, r), bsdf_sample.ray)
        bsdf_sample.weight = dr.select(chosen, reflected, weight)
        bsdf_sample.pdf = dr.select(chosen, sent.pdf, bsdf_sample.pdf)
        bsdf_sample.η = dr.select(chosen, 1, bsdf_sample.η)
        bsdf_sample.specular &= ~chosen
        bsdf_sample.guide = dr.select(chosen, r, dr.select(guided, MATERIAL, 0))
        return bsdf_eval, bsdf_sample

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Weight a sample with the combined density of BSDF sampling and target sampling.

        This is the one-sample model of the module. The throughput is multiplied by the density of
        the chosen technique, divided by the combined density. A path whose target point is occluded
        ends.

        Returns:
            A copy of the path with its new throughput, density and mask.
        """
        path = copy(self.inner.complete_sample(path, vertex))
        assert path.guide is not None

        # Did the ray reach its target point?
        sent = path.guide > 0
        missed = ~vertex.valid | (dr.abs(vertex.length - path.guide) > REACHED * path.guide)

        # One-sample model: multiply by the chosen technique's density over the combined density
        shared = sent | ((path.guide < 0) & ~path.specular)
        by_material = (1 - self.probability) * path.pdf
        by_area = self.probability * self.targets.density(vertex.si, path.prev)
        mixed = by_material + by_area
        chosen = dr.select(sent, self.target_density(path.guide), by_material)

        # A target that is seen edge-on contributes nothing
        counts = (mixed > 0) & ~(sent & (by_area == 0))
        path.β = dr.select(shared, path.β * dr.select(counts, chosen / mixed, 0), path.β)
        path.pdf = dr.select(shared, mixed, path.pdf)
        path.active &= ~(sent & missed)
        return path

    def target_density(self, r: mi.Float) -> mi.Float:
        """Return the density of sampling a target point at distance r, times |cos| [1/sr]."""
        return self.probability * r * r / self.targets.area

    def _bsdf_probability(self, vertex: Vertex) -> mi.Float:
        """Return the probability of sampling the BSDF at a vertex."""
        return dr.select(is_on(vertex.si, self.guided_shapes), 1 - self.probability, 1)


def ray_to(si: mi.SurfaceInteraction3f, d: mi.Vector3f, r: mi.Float) -> mi.Ray3f:
    """Spawn a ray that passes through the point at distance `r` [m] along `d`, despite its offset.

    A spawned ray starts slightly off the surface. Its direction is corrected accordingly.
    """
    ray = si.spawn_ray(d)
    ray.d = dr.normalize(mi.Vector3f(dr.fma(d, r, si.p) - ray.o))
    return ray
