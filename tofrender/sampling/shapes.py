"""Shapes that emit light, sampled by direction from a point `o`.

Every shape offers

    sample(o, sample)   EmitterRecord of a random direction towards the shape
    record(o, v)        EmitterRecord of the first hit in a given direction
    pdf(o, v)           density of `sample` at the direction v [1/sr]; 0 if it misses the shape
    intersect(o, v)     (distance, valid, normal) of the first hit
    is_emissive, area   whether it emits; its area [m^2]

`o` and `v` are Dr.Jit arrays of any number of lanes, v of unit length, all in world space and
metres. Light leaves a shape on the side of its normal only, as with Mitsuba's area lights. The
density does not know of sides: a shape that shows its dark side is hit as often, with radiance 0.

A `SurfaceGroup` of n shapes tests all of them for each sample. It is meant for the handful of
lights of a scene.

Source: P. Shirley, C. Wang and K. Zimmerman, "Monte Carlo Techniques for Direct Lighting
Calculations", ACM Transactions on Graphics 15(1), 1996.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from ..runtime import checks
from .emitter_records import EmitterRecord, Shape
from .warps import unit_square


class SurfaceGroup(Shape):
    """Several shapes, of any kinds and groups too, sampled as one light.

    `sample` picks one of the n shapes with equal chance, by the leading part of the sample's first
    number, whose rest goes on to the shape (it loses log2(n) of its 24 bits). The direction could
    have come from any shape that it meets, so its density is the mean of all shapes' densities.

    The record describes the nearest of the shapes along the direction, whichever was picked, with
    its radiance, which is 0 if it shows its dark side. So lights may overlap and hide each other,
    and the mean of `weight` f is the integral of radiance times f over the group. Of surfaces that
    coincide, any may be hit. Shapes that do not emit hide others and use up their part of the
    samples: leave them out if the scene tests visibility.

    Args:
        shapes: At least one shape; a ValueError says if there is none, or something else.

    Attributes:
        shapes: The shapes.
        area: Sum of their areas [m^2].

    Example:
        >>> from tofrender.sampling import Sphere
        >>> near, far = Sphere((0, 0, 2), 0.5, emission=1), Sphere((0, 0, 8), 2, emission=7)
        >>> group = SurfaceGroup([near, far])
        >>> record = group.sample(mi.Point3f(0, 0, 0), mi.Point2f(0.75, 0.5))
        >>> ahead = near.pdf(record.o, record.d) + far.pdf(record.o, record.d)
        >>> record.radiance.x, dr.abs(record.pdf - ahead / 2) < 1e-6
        ([1], [True])
    """

    def __init__(self, shapes: Sequence[Shape]) -> None:
        self.shapes = list(shapes) if isinstance(shapes, Sequence) else []
        if not self.shapes or not all(isinstance(each, Shape) for each in self.shapes):
            allowed = "must be a list of at least one Quad, Triangle, Sphere or SurfaceGroup"
            raise ValueError(f"shapes = {checks.quote(shapes)}: {allowed}")
        self.area = sum(each.area for each in self.shapes)

    @property
    def is_emissive(self) -> bool:
        """Whether any of the shapes is."""
        return any(each.is_emissive for each in self.shapes)

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """Direction towards one of the shapes, and the nearest hit there; see `Shape.sample`."""
        u, v = unit_square(sample)
        scaled = u * len(self.shapes)
        k = dr.minimum(mi.UInt32(scaled), len(self.shapes) - 1)
        rest = mi.Point2f(scaled - k, v)
        picked = self.shapes[0].sample(o, rest)
        for i, shape in enumerate(self.shapes[1:], 1):
            picked = dr.select(k == i, shape.sample(o, rest), picked)
        # The picked shape keeps its own record: a new ray to its edge might miss it
        hits = [
            dr.select(k == i, picked, shape.record(o, picked.d))
            for i, shape in enumerate(self.shapes)
        ]
        return self._nearest(hits, picked.valid)

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Nearest hit of all shapes from `o` along `v`; see `Shape.record`."""
        return self._nearest([shape.record(o, v) for shape in self.shapes], mi.Bool(True))

    def _nearest(self, hits: list[EmitterRecord], active: mi.Bool) -> EmitterRecord:
        """Nearest of the hits, with the mean of their densities."""
        first = hits[0]
        for hit in hits[1:]:
            nearer = hit.valid & (~first.valid | (hit.distance < first.distance))
            first = dr.select(nearer, hit, first)
        pdf = mi.Float(sum(hit.pdf for hit in hits) / len(hits))
        first.valid = first.valid & active
        first.pdf = dr.select(first.valid, pdf, 0)
        first.radiance = dr.select(first.valid, first.radiance, 0)
        first.weight = dr.select(first.valid, first.radiance / pdf, 0)
        return first

    def __repr__(self) -> str:
        """The shapes."""
        return f"SurfaceGroup({self.shapes})"
