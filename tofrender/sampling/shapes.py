"""Shapes that emit light, and are sampled by direction from a point `o`.

Each shape has these methods and attributes:

    sample(o, sample)   EmitterRecord of a random direction towards the shape
    record(o, v)        EmitterRecord of the first hit in a given direction
    pdf(o, v)           density of `sample` in the direction v [1/sr]; 0 if v misses the shape
    intersect(o, v)     (distance, valid, normal) of the first hit
    is_emissive, area   whether the shape emits; its area [m^2]

`o` and `v` are Dr.Jit arrays of any number of lanes, in world space and meters. v has unit length.
Light leaves a shape only on the side of its normal, like Mitsuba's area lights. The density does
not depend on the side: a shape that shows its dark side is sampled equally often, with radiance 0.

A `SurfaceGroup` tests all its shapes for each sample. It is meant for a few lights.

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
    """Several shapes or groups, sampled as one light.

    `sample` selects one of the n shapes with equal probability, by the leading bits of the first
    random number. The shape uses the remaining bits (log2(n) of 24 bits are lost). Each shape in
    the sampled direction could have produced this direction. Therefore its density is the mean of
    the densities of all shapes.

    The record describes the nearest shape along the direction, which may differ from the selected
    shape. Its radiance is 0 if it shows its dark side. Therefore lights may overlap and occlude
    each other, and the mean of `weight` f is the integral of radiance times f over the group. If
    surfaces coincide, any of them may be hit. Shapes that do not emit occlude others and use their
    share of the samples. Omit them if the scene tests visibility.

    Args:
        shapes: At least one shape.

    Raises:
        ValueError: The list is empty, or contains something else than shapes.

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
        """Return whether any of the shapes emits."""
        return any(each.is_emissive for each in self.shapes)

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """Sample a direction to one shape, and find the nearest hit; see `Shape.sample`."""
        # Select a shape by the leading bits of u
        u, v = unit_square(sample)
        scaled = u * len(self.shapes)
        k = dr.minimum(mi.UInt32(scaled), len(self.shapes) - 1)
        remainder = mi.Point2f(scaled - k, v)
        picked = self.shapes[0].sample(o, remainder)
        for i, shape in enumerate(self.shapes[1:], 1):
            picked = dr.select(k == i, shape.sample(o, remainder), picked)
        # Find the nearest hit. The selected shape keeps its record: a new ray might miss its edge
        hits = [
            dr.select(k == i, picked, shape.record(o, picked.d))
            for i, shape in enumerate(self.shapes)
        ]
        return self._nearest(hits, picked.valid)

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Return the nearest hit of all shapes from `o` along `v`; see `Shape.record`."""
        return self._nearest([shape.record(o, v) for shape in self.shapes], mi.Bool(True))

    def _nearest(self, hits: list[EmitterRecord], active: mi.Bool) -> EmitterRecord:
        """Return the nearest hit, with the mean density of all hits."""
        # Find the nearest hit
        first = hits[0]
        for hit in hits[1:]:
            nearer = hit.valid & (~first.valid | (hit.distance < first.distance))
            first = dr.select(nearer, hit, first)

        # Combine the densities
        pdf = mi.Float(sum(hit.pdf for hit in hits) / len(hits))
        first.valid = first.valid & active
        first.pdf = dr.select(first.valid, pdf, 0)
        first.radiance = dr.select(first.valid, first.radiance, 0)
        first.weight = dr.select(first.valid, first.radiance / pdf, 0)
        return first

    def __repr__(self) -> str:
        """Return the shapes as text."""
        return f"SurfaceGroup({self.shapes})"
