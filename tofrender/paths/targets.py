"""Surfaces that paths are sent to on purpose: hidden geometry, which materials rarely find.

At the vertices where it applies, a path takes its next direction from the material with the
probability 1 - s, or from a point that is chosen by area on the target surfaces with s. A point
that something else hides counts nothing; so one next vertex y, seen from x under r and cos, has the
density (per solid angle at x)

    p(y) = (1 - s) p_material + s r^2 / (A |cos|)

where the second term is there only if y is on a target, and A is the area of all targets. The
path's throughput is divided by that sum, whichever of the two has found y: the one-sample model
with the balance heuristic (Veach 1997, section 9.2.4). Both sides of a surface count; what faces
away and is black there reflects nothing by its own BSDF.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

MATERIAL = -1.0
"""Stands for a distance where the material chose the direction."""

REACHED = 1e-3
"""Relative distance by which a ray may miss the point that it was sent to, by rounding."""


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


PLAIN_SHAPES = ("Rectangle", "Cube", "Disk", "Cylinder")
"""Where a sampled point has the very normal that a ray finds there; not so on a `Sphere`."""

PLAIN_MATERIALS = re.compile(r"(\w+\.)*(reflectance\.value|lobe_exponent)")


def is_plain(shape: Any) -> bool:
    """Whether position and normal of a surface point are all that its material looks at.

    So it is of surfaces without shading normals that are diffuse or retroreflecting in one colour.
    """
    flat = shape.is_mesh() and not shape.has_vertex_normals()
    if not flat and shape.class_name() not in PLAIN_SHAPES:
        return False
    names = [name for name, _ in mi.traverse(shape.bsdf())]
    return bool(names) and all(PLAIN_MATERIALS.fullmatch(name) for name in names)


class Targets:
    """Target surfaces, and the vertices from which paths are sent to them.

    The path carries `aimed` from vertex to vertex: the distance to the target point that its ray
    was sent to, MATERIAL where the material chose instead, 0 where nothing is sent to targets.

    Args:
        scene: The scene.
        shapes: The targets, whose `sample_position` must be even in area.
        senders: Shapes at whose points paths are sent to targets.
        share: Probability s of that, above 0 and at most 1. With 1 only targets are found.

    Attributes:
        plain: Whether all targets are as `is_plain` says.
    """

    def __init__(
        self,
        scene: mi.Scene,
        shapes: Sequence[mi.Shape],
        senders: Sequence[mi.Shape],
        share: float,
    ) -> None:
        self.shapes, self.senders, self.share = list(shapes), list(senders), share
        areas = np.array([shape.surface_area()[0] for shape in self.shapes])
        cumulative = np.cumsum(areas) / areas.sum()
        everything = scene.shapes()
        numbers = [everything.index(shape) for shape in self.shapes]
        self.area = dr.opaque(mi.Float, float(areas.sum()))
        self.upper = mi.Float(cumulative)
        self.lower = mi.Float(np.concatenate([[0.0], cumulative[:-1]]))
        self.pointers = dr.gather(mi.ShapePtr, scene.shapes_dr(), mi.UInt32(numbers))
        self.plain = all(map(is_plain, self.shapes))
        dr.eval(self.upper, self.lower, self.pointers)

    def material_share(self, si: mi.SurfaceInteraction3f) -> mi.Float:
        """Probability with which the material chooses the direction at `si`."""
        return dr.select(is_on(si, self.senders), 1 - self.share, 1)

    def sample(self, u: mi.Point2f, active: mi.Bool) -> tuple[mi.PositionSample3f, mi.ShapePtr]:
        """A point on the targets, even in area, and the shape that it is on."""
        index = mi.UInt32(0)
        for k in range(len(self.shapes) - 1):
            index[u.x >= dr.gather(mi.Float, self.upper, k)] = k + 1
        low, high = dr.gather(mi.Float, self.lower, index), dr.gather(mi.Float, self.upper, index)
        inside = dr.clip((u.x - low) / (high - low), 0, dr.one_minus_epsilon(mi.Float))
        shape = dr.gather(mi.ShapePtr, self.pointers, index, active)
        return shape.sample_position(0.0, mi.Point2f(inside, u.y), active), shape

    def density(self, si: mi.SurfaceInteraction3f, previous: mi.Interaction3f) -> mi.Float:
        """Density r^2 / (A |cos|) of the direction from `previous` to a target point [1/sr]."""
        to_target = si.p - previous.p
        r2 = dr.squared_norm(to_target)
        cos = dr.abs(dr.dot(si.n, to_target)) * dr.rsqrt(r2)
        return dr.select(is_on(si, self.shapes) & (cos > 0), r2 / (self.area * cos), 0)

    def aim(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        bsdf: Any,
        bs: mi.BSDFSample3f,
        weight: Any,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> tuple[mi.BSDFSample3f, Any, mi.Float]:
        """Replace the material's sample by a direction to a target, with probability `share`.

        Returns:
            The sample with the material's density, the BSDF over the density of what chose it
            (without the target's cosine, which `arrive` knows), and `aimed`.
        """
        xi, u = sampler.next_1d(), sampler.next_2d()
        smooth = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        sending = active & smooth & is_on(si, self.senders)
        chosen = sending & (xi < self.share)

        to_target = self.sample(u, chosen)[0].p - si.p
        r = dr.norm(to_target)
        sent: Any = dr.zeros(mi.BSDFSample3f)
        sent.wo = si.to_local(to_target / r)
        f, sent.pdf = bsdf.eval_pdf(ctx, si, sent.wo, chosen)
        sent.eta, sent.sampled_type = 1.0, mi.UInt32(int(mi.BSDFFlags.DiffuseReflection))

        by_material = 1 - self.share
        kept = dr.select(sending, dr.rcp(by_material) if by_material > 0 else 0.0, 1)
        reflected = mi.unpolarized_spectrum(f) / self._sent_density(r)
        return (
            dr.select(chosen, sent, bs),
            dr.select(chosen, reflected, mi.unpolarized_spectrum(weight) * kept),
            dr.select(chosen, r, dr.select(sending, MATERIAL, 0)),
        )

    def send(self, ray: mi.Ray3f, si: mi.SurfaceInteraction3f, aimed: mi.Float) -> mi.Ray3f:
        """Turn rays that start a little off the surface to the very point that they are sent to."""
        to_point = mi.Vector3f(dr.fma(ray.d, aimed, si.p) - ray.o)
        ray.d = dr.select(aimed > 0, dr.normalize(to_point), ray.d)
        return ray

    def arrive(
        self,
        si: mi.SurfaceInteraction3f,
        previous: mi.Interaction3f,
        pdf: mi.Float,
        delta: mi.Bool,
        aimed: mi.Float,
        β: Any,
        active: mi.Bool,
    ) -> tuple[Any, mi.Float, mi.Bool]:
        """At the next vertex: drop what was hidden, and divide by the density of both techniques.

        Returns:
            Throughput, density of the direction that led here, and the lanes that go on.
        """
        sent = aimed > 0
        r = dr.norm(si.p - previous.p)
        hidden = sent & (~si.is_valid() | (dr.abs(r - aimed) > REACHED * aimed))
        shared = sent | ((aimed < 0) & ~delta)
        by_material = (1 - self.share) * pdf
        by_area = self.share * self.density(si, previous)
        mixed = by_material + by_area
        chosen = dr.select(sent, self._sent_density(aimed), by_material)
        counts = (mixed > 0) & ~(sent & (by_area == 0))  # Not where a target is seen edge-on
        β = dr.select(shared, β * dr.select(counts, chosen / mixed, 0), β)
        return β, dr.select(shared, mixed, pdf), active & ~hidden

    def _sent_density(self, r: mi.Float) -> mi.Float:
        """Density of being sent to a target point at distance r, but for 1 / |cos|."""
        return self.share * r * r / self.area
