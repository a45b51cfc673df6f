"""Problem a1.lights: shapes that emit light, sampled by direction.

A light has two methods for a point `o` that it illuminates. `sample` returns a random direction
toward the light, and `record` evaluates a given direction. Both return an `EmitterRecord`:

    o, p        the illuminated point, and the first point of the light in this direction
    n           unit normal at p, on the side that emits
    d, distance unit vector from o to p, and distance of p [m]
    pdf         density of the direction d [1/sr], the same whether it was sampled or given
    radiance    radiance from p: the emission, or 0 if p is seen from the side that does not emit
    weight      radiance / pdf
    valid       lanes in which the light is hit; in other lanes pdf, radiance and weight are 0

`Shape` derives further methods from these two: `pdf(o, v)`, `intersect(o, v)`, `is_emissive`, and
`filled`, which makes the record of a hit and computes radiance and weight. `Quad` is given as the
worked example. `o`, `v` and `sample` are Dr.Jit arrays of any number of lanes.

`scene.sample_emitter_direction` and `mi.warp` are not allowed here, because they contain the
results that you derive. You can import your `sample_triangle` and `sample_sphere_cap`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from tofrender.sampling.emitter_records import EmitterRecord, Shape, emission_values


class Quad(Shape):
    """A parallelogram of a corner and two edges from this corner; emits on the side of e0 x e1.

    Args:
        corner: Three numbers [m].
        e0: First edge.
        e1: Second edge.
        emission: Radiance on the side of the normal: a number, or three for R, G and B.
    """

    def __init__(
        self, corner: Sequence[float], e0: Sequence[float], e1: Sequence[float], emission: Any = 0
    ) -> None:
        cross = np.cross(e0, e1)
        self.area = float(np.linalg.norm(cross))
        self.corner = mi.Point3f(*corner)
        self.e0 = mi.Vector3f(*e0)
        self.e1 = mi.Vector3f(*e1)
        self.normal = mi.Vector3f((cross / self.area).tolist())
        self.emission = emission_values(emission)

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """A uniform point of the surface, as a direction from `o`."""
        p = self.corner + sample.x * self.e0 + sample.y * self.e1
        distance = dr.norm(p - o)
        return self._hit(o, p, (p - o) / distance, distance, mi.Bool(True))

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Intersection of the ray o + t v with the plane, if it is on the parallelogram."""
        distance = dr.dot(self.normal, self.corner - o) / dr.dot(self.normal, v)
        p = o + distance * v

        # Is p inside? Solve p - corner = a e0 + b e1 by cross products with the edges
        a = dr.dot(self.normal, dr.cross(p - self.corner, self.e1)) / self.area
        b = dr.dot(self.normal, dr.cross(self.e0, p - self.corner)) / self.area
        inside = (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
        return self._hit(o, p, v, distance, inside & (distance > 0))

    def _hit(
        self, o: mi.Point3f, p: mi.Point3f, d: mi.Vector3f, distance: mi.Float, valid: mi.Bool
    ) -> EmitterRecord:
        """Make the record of a point; its density 1 / area is converted to solid angle."""
        cos = dr.abs(dr.dot(self.normal, d))
        pdf = dr.square(distance) / (self.area * cos)
        return self.filled(o, p, self.normal, d, distance, pdf, valid & (cos > 0))


class Triangle(Shape):
    """A triangle; it emits on the side of (v1 - v0) x (v2 - v0).

    Directions lead to uniform points of the surface, as with `Quad`.

    Args:
        v0: First corner, three numbers [m].
        v1: Second corner.
        v2: Third corner.
        emission: Radiance on the side of the normal: a number, or three for R, G and B.
    """

    def __init__(
        self, v0: Sequence[float], v1: Sequence[float], v2: Sequence[float], emission: Any = 0
    ) -> None:
        raise NotImplementedError("a1.lights: Triangle")

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """A uniform point of the surface, as a direction from `o`."""
        raise NotImplementedError("a1.lights: Triangle.sample")

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Record of the triangle from `o` along `v`; rays hit both sides."""
        raise NotImplementedError("a1.lights: Triangle.record")


class Sphere(Shape):
    """A sphere that emits outwards, sampled by the cone of directions that it fills.

    From outside, the density is 1 / (solid angle of the cone), without a geometry factor. From
    inside, every direction hits the sphere: the density is 1 / (4 pi), and the radiance is 0. A
    sphere may be far away: with radius / distance = 1e-3 the density must be right to 1e-3,
    although the cosine of the cone's angle is 1 in single precision.

    Args:
        center: Three numbers [m].
        radius: Radius [m], above 0.
        emission: Radiance on the outside: a number, or three for R, G and B.
        transform: None, or 4 x 4 numbers that move the sphere: rotation, one scale for all
            directions, and translation.
    """

    def __init__(
        self,
        center: Sequence[float] = (0, 0, 0),
        radius: float = 1.0,
        emission: Any = 0,
        *,
        transform: Any = None,
    ) -> None:
        raise NotImplementedError("a1.lights: Sphere")

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """A uniform direction of the cone, and the first point of the sphere in this direction."""
        raise NotImplementedError("a1.lights: Sphere.sample")

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Record of the sphere from `o` along `v`."""
        raise NotImplementedError("a1.lights: Sphere.record")


class SurfaceGroup(Shape):
    """Several shapes, sampled as one light.

    `sample` picks one of the n shapes with equal probability and samples a direction toward it. The
    direction could have come from any shape that it hits, so its density is the mean of all n
    densities, with 0 for shapes that it misses. The record (point, distance, normal, radiance)
    belongs to the nearest shape in this direction, not to the picked shape: lights may hide each
    other.

    Args:
        shapes: At least one shape.
    """

    def __init__(self, shapes: Sequence[Shape]) -> None:
        raise NotImplementedError("a1.lights: SurfaceGroup")

    @property
    def is_emissive(self) -> bool:
        """Whether any of the shapes emits light."""
        raise NotImplementedError("a1.lights: SurfaceGroup.is_emissive")

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """A direction toward one of the shapes, and the visible point there."""
        raise NotImplementedError("a1.lights: SurfaceGroup.sample")

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Record of the group from `o` along `v`, with the mean density."""
        raise NotImplementedError("a1.lights: SurfaceGroup.record")
