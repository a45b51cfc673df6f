"""Path guiding to target surfaces: hidden geometry, which BSDF samples rarely find.

The next direction is sampled from the BSDF with the probability 1 - s, or towards a point that is
uniform on the target surfaces with s. Hidden points count nothing; so the next vertex y, seen from
x at the distance r and the cosine cos, has the density (per solid angle at x)

    p(y) = (1 - s) p_bsdf + s r² / (A |cos|)

where the second term is there only if y is on a target, and A is the area of all targets. The
throughput is divided by that sum, whichever of the two has found y: the one-sample model with the
balance heuristic (Veach 1997, section 9.2.4). Both sides of a surface count.
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

MATERIAL = -1.0  # value of `Path.guide` where the BSDF has sampled the direction
REACHED = 1e-3  # relative distance by which a ray may miss its target point, by rounding
# Shapes whose sampled points have the normal that a ray finds there; unlike `Sphere`
PLAIN_SHAPES = ("Rectangle", "Cube", "Disk", "Cylinder")
PLAIN_MATERIALS = re.compile(r"(\w+\.)*(reflectance\.value|lobe_exponent)")


def is_plain(shape: mi.Shape) -> bool:
    """Whether a BSDF depends on position and normal alone: no texture, no shading normals."""
    flat = shape.is_mesh() and not shape.has_vertex_normals()
    if not flat and shape.class_name() not in PLAIN_SHAPES:
        return False
    names = list(mi.traverse(shape.bsdf()).keys())
    return bool(names) and all(PLAIN_MATERIALS.fullmatch(name) for name in names)


class Targets:
    """Surfaces of a scene whose points are sampled uniformly by area."""

    def __init__(self, scene: mi.Scene, shapes: Sequence[mi.Shape]) -> None:
        self.shapes = list(shapes)
        for shape in self.shapes:
            if shape.class_name() == "Instance":
                raise ValueError(
                    f"hidden_shapes = {shape.id()!r}: is an instance, whose points cannot be "
                    "chosen by area; must be a plain shape, or nlos_hidden_geometry_sampling false"
                )
        areas = np.array([shape.surface_area()[0] for shape in self.shapes])
        cumulative = np.cumsum(areas) / areas.sum()
        everything = scene.shapes()
        numbers = [everything.index(shape) for shape in self.shapes]
        self.area = dr.opaque(mi.Float, float(areas.sum()))  # of all of them [m²]
        self.upper = mi.Float(cumulative.tolist())
        self.lower = mi.Float([0.0, *cumulative[:-1].tolist()])
        self.pointers = dr.gather(mi.ShapePtr, scene.shapes_dr(), mi.UInt32(numbers))
        self.plain = all(map(is_plain, self.shapes))
        dr.eval(self.upper, self.lower, self.pointers)

    def sample(self, u: mi.Point2f, active: mi.Bool) -> tuple[mi.PositionSample3f, mi.ShapePtr]:
        """Sample a point uniformly by area; returns it, and its shape."""
        index = mi.UInt32(0)
        for k in range(len(self.shapes) - 1):
            index[u.x >= dr.gather(mi.Float, self.upper, k)] = k + 1
        low, high = dr.gather(mi.Float, self.lower, index), dr.gather(mi.Float, self.upper, index)
        inside = dr.clip((u.x - low) / (high - low), 0, dr.one_minus_epsilon(mi.Float))
        shape = dr.gather(mi.ShapePtr, self.pointers, index, active)
        # A call by pointer compiles that of every shape there is, those of other scenes too
        called = self.shapes[0] if len(self.shapes) == 1 else shape
        return called.sample_position(0.0, mi.Point2f(inside, u.y), active), shape

    def density(self, si: mi.SurfaceInteraction3f, previous: mi.Interaction3f) -> mi.Float:
        """Return the density r² / (A |cos|) of the direction to a target point [1/sr]."""
        to_target = si.p - previous.p
        r2 = dr.squared_norm(to_target)
        cos = dr.abs(dr.dot(si.n, to_target)) * dr.rsqrt(r2)
        return dr.select(is_on(si, self.shapes) & (cos > 0), r2 / (self.area * cos), 0)


class Guided(ScatteringWrapper):
    """Scattering mixed with directions to targets, at points of `senders`.

    The path's `guide` is the distance to the target point that its ray was sent to, MATERIAL where
    the BSDF was sampled instead, 0 elsewhere. The probability s is above 0 and at most 1, with
    which only targets are found.
    """

    def __init__(
        self, inner: Scattering, targets: Targets, senders: Sequence[mi.Shape], probability: float
    ) -> None:
        super().__init__(inner)
        self.targets, self.senders, self.probability = targets, list(senders), probability

    def guide(self) -> mi.Float:
        """Return 0: nothing is sent to targets yet."""
        return mi.Float(0)

    def sends(self, vertex: Vertex, active: mi.Bool) -> mi.Bool:
        """Whether paths are sent to targets from here."""
        return active & self.smooth(vertex) & is_on(vertex.si, self.senders)

    def competed(self, path: Path) -> mi.Bool:
        """Whether targets and material competed for the direction of the path's ray."""
        return (path.guide != 0) & ~path.specular

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the BSDF; the density is that of its own sampling."""
        bsdf_eval = self.inner.eval_pdf(vertex, direction, active)
        bsdf_eval.pdf *= self._bsdf_probability(vertex)
        return bsdf_eval

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample a direction from the BSDF, or to a target with the probability `probability`.

        The sample has the BSDF's density, and as weight the BSDF over the density of the sampled
        technique, without the target's cosine, which `complete_sample` adds.
        """
        # Sample the BSDF
        bsdf_eval, bsdf_sample = self.inner.sample(vertex, connection, sampler, active)
        if bsdf_eval is not None:
            bsdf_eval.pdf *= self._bsdf_probability(vertex)

        # Sample a point on a target, and evaluate the BSDF for its direction
        xi, u = sampler.next_1d(), sampler.next_2d()
        sending = self.sends(vertex, active)
        chosen = sending & (xi < self.probability)
        si = vertex.si
        to_target = self.targets.sample(u, chosen)[0].p - si.p
        r = dr.norm(to_target)
        d = to_target / r
        sent = self.inner.eval_pdf(vertex, d, chosen)

        # Choose one of both, and divide by its probability
        by_material = 1 - self.probability
        factor = dr.select(sending, dr.rcp(by_material) if by_material > 0 else 0.0, 1)
        reflected = mi.unpolarized_spectrum(sent.f) / self.sent_density(r)
        weight = mi.unpolarized_spectrum(bsdf_sample.weight) * factor
        bsdf_sample.ray = dr.select(chosen, ray_to(si, d, r), bsdf_sample.ray)
        bsdf_sample.weight = dr.select(chosen, reflected, weight)
        bsdf_sample.pdf = dr.select(chosen, sent.pdf, bsdf_sample.pdf)
        bsdf_sample.η = dr.select(chosen, 1, bsdf_sample.η)
        bsdf_sample.specular &= ~chosen
        bsdf_sample.guide = dr.select(chosen, r, dr.select(sending, MATERIAL, 0))
        return bsdf_eval, bsdf_sample

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Drop what was hidden, and divide by the density of both techniques."""
        path = copy(self.inner.complete_sample(path, vertex))
        assert path.guide is not None
        sent = path.guide > 0
        missed = ~vertex.valid | (dr.abs(vertex.length - path.guide) > REACHED * path.guide)

        # One-sample model: the sampled density over the sum of both
        shared = sent | ((path.guide < 0) & ~path.specular)
        by_material = (1 - self.probability) * path.pdf
        by_area = self.probability * self.targets.density(vertex.si, path.prev)
        mixed = by_material + by_area
        chosen = dr.select(sent, self.sent_density(path.guide), by_material)
        counts = (mixed > 0) & ~(sent & (by_area == 0))  # Not where a target is seen edge-on
        path.β = dr.select(shared, path.β * dr.select(counts, chosen / mixed, 0), path.β)
        path.pdf = dr.select(shared, mixed, path.pdf)
        path.active &= ~(sent & missed)
        return path

    def sent_density(self, r: mi.Float) -> mi.Float:
        """Return the density of a direction to a target point at distance r, times |cos|."""
        return self.probability * r * r / self.targets.area

    def _bsdf_probability(self, vertex: Vertex) -> mi.Float:
        """Return the probability of sampling the BSDF."""
        return dr.select(is_on(vertex.si, self.senders), 1 - self.probability, 1)


def ray_to(si: mi.SurfaceInteraction3f, d: mi.Vector3f, r: mi.Float) -> mi.Ray3f:
    """Spawn a ray off a surface that meets the point at distance r along d."""
    ray = si.spawn_ray(d)
    ray.d = dr.normalize(mi.Vector3f(dr.fma(d, r, si.p) - ray.o))
    return ray
