"""Sphere lights, sampled by the cone of directions that they fill."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from .emitter_records import EmitterRecord, Shape, affine, emission_values
from .triangles_and_caps import literal, point, sample_cap_of_height


class Sphere(Shape):
    """Sphere, sampled by the cone of directions that it fills.

    From outside, at the distance D of the centre, the cone has sin(theta_max) = r / D and the
    constant density 1 / (2 pi (1 - cos(theta_max))), without a geometry factor. For far spheres
    1 - cos(theta_max) = s^2 / (1 + sqrt(1 - s^2)) with s = r / D keeps its digits. From inside
    every direction hits, with the density 1 / (4 pi). So it does from the surface (to a few
    roundings), where half of the directions leave at once and are not valid.

    Directions are rounded to 6e-8: for `record` and `pdf`, a fraction of about 1e-7 / theta_max of
    the samples of a cone narrower than 1e-4 misses at its edge.

    Args:
        centre: Centre, three numbers.
        radius: Radius [m], above 0.
        emission: Radiance on the outside: a number, or three for R, G and B.
        transform: Moves it: an `mi.ScalarTransform4f` or 4 x 4 numbers, made of rotations or
            mirrors, one scale for all axes and translations; or None.
        flip_normals: Let the normal point inwards, and the light go there.

    Attributes:
        centre: Centre after the transform, shape (3,).
        radius: Radius after the transform [m].
        area: Its area [m^2].

    Raises:
        ValueError: The radius is not above 0, the transform is of another kind, or the emission is
            negative or not finite.

    Example:
        >>> light = Sphere([0, 0, 0], 3.0, emission=1)
        >>> record = light.sample(mi.Point3f(0, 0, 5), mi.Point2f(0.0))
        >>> print(record.p, 0.2 / dr.two_pi < record.pdf)
        [[0, 0, 3]] [True]
        >>> round(1 / (2 * math.pi * float(record.pdf[0])), 6)  # 1 - 4/5
        0.2
    """

    def __init__(
        self,
        centre: Any = (0, 0, 0),
        radius: float = 1.0,
        emission: Any = 0,
        *,
        transform: Any = None,
        flip_normals: bool = False,
    ) -> None:
        matrix = affine(transform)
        scales = np.linalg.svd(matrix[:3, :3], compute_uv=False)
        if not 0 < scales[0] <= scales[2] * (1 + 1e-5):
            stretch = ", ".join(f"{each:.6g}" for each in scales)
            raise ValueError(f"transform: scales by {stretch}; must scale all directions alike")
        self.radius = checks.metres("radius", radius, positive=True) * float(scales.mean())
        self.centre = matrix[:3, :3] @ point("centre", centre) + matrix[:3, 3]
        self.area = 4 * math.pi * self.radius**2
        self.emission = emission_values(emission)
        self.flip_normals = checks.boolean("flip_normals", flip_normals)

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """Uniform direction of the cone; see `Shape.sample`."""
        # Sample a direction in the cone around the centre's
        to_centre, dc, height = self._cone(o)
        frame = mi.Frame3f(dr.select(dc > 0, to_centre / dc, mi.Vector3f(0, 0, 1)))
        local = sample_cap_of_height(sample, height)
        # Compute the vector from the centre to the ray's nearest point
        sin_theta = dr.norm(mi.Vector2f(local.x, local.y))
        offset = dr.minimum(dc * sin_theta, self.radius)
        out = dr.select(sin_theta > 0, mi.Vector2f(local.x, local.y) / sin_theta, 0)
        side = mi.Vector3f(local.z * out.x, local.z * out.y, -sin_theta)
        d, sideways = frame.to_world(local), frame.to_world(offset * side)
        return self._hit(o, d, sideways, offset, dc * local.z, dc, height)

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Point at which the ray enters, or from inside leaves, the sphere; see `Shape.record`.

        The ray passes the centre c at |(c - o) x v|. Compensated products keep that exact for far
        and small spheres.
        """
        c, dc, height = self._cone(o)
        v = mi.Vector3f(v)
        moment = mi.Vector3f(
            _difference_of_products(c.y, v.z, c.z, v.y),
            _difference_of_products(c.z, v.x, c.x, v.z),
            _difference_of_products(c.x, v.y, c.y, v.x),
        )
        return self._hit(o, v, dr.cross(moment, v), dr.norm(moment), dr.dot(c, v), dc, height)

    def _cone(self, o: mi.Point3f) -> tuple[mi.Vector3f, mi.Float, mi.Float]:
        """Vector to the centre, its length dc, and 1 - cos(theta_max)."""
        to_centre = mi.Vector3f(mi.Point3f(literal(self.centre)) - o)
        dc = dr.norm(to_centre)
        s2 = dr.square(self.radius / dc)
        height = s2 / (1 + dr.safe_sqrt(1 - s2))
        return to_centre, dc, dr.select(self._outside(dc), height, 2)

    def _outside(self, dc: mi.Float) -> mi.Bool:
        return dc > self.radius * (1 + 4 * dr.epsilon(mi.Float))

    def _hit(
        self,
        o: mi.Point3f,
        d: mi.Vector3f,
        sideways: mi.Vector3f,
        offset: mi.Float,
        t_centre: mi.Float,
        dc: mi.Float,
        height: mi.Float,
    ) -> EmitterRecord:
        """Record of a ray that is nearest to the centre after the length `t_centre`.

        The ray passes the centre by the vector `sideways` of length `offset`, and runs inside the
        sphere for `half` before and after. The lengths to both ends, t_centre -+ half, have the
        product `power`, which gives the shorter one without a difference.
        """
        r = self.radius
        outside = self._outside(dc)
        # Intersect the ray with the sphere
        on = dr.abs(dc - r) <= 4 * dr.epsilon(mi.Float) * r
        power = dr.select(on, 0, (dc - r) * (dc + r))
        half = dr.safe_sqrt((r - offset) * (r + offset))
        longer = dr.select(t_centre < 0, t_centre - half, t_centre + half)
        distance = dr.select(outside | (t_centre < 0), power / longer, longer)
        valid = (offset <= r) & (distance > 0) & (~outside | (t_centre > 0))
        n = mi.Vector3f((sideways + dr.select(outside, -half, half) * d) / r)
        p = mi.Point3f(literal(self.centre)) + r * n
        n = -n if self.flip_normals else n
        return self.filled(o, p, n, d, distance, dr.rcp(dr.two_pi * height), valid)

    def __repr__(self) -> str:
        """Centre, radius and emission."""
        centre = ", ".join(f"{each:g}" for each in self.centre)
        return f"Sphere(({centre}), radius={self.radius:g}, emission={self.emission})"


def _difference_of_products(a: mi.Float, b: mi.Float, c: mi.Float, d: mi.Float) -> mi.Float:
    """Return a b - c d to a rounding or two, by Kahan's algorithm."""
    product = c * d
    lost = dr.fma(-c, d, product)
    return dr.fma(a, b, -product) + lost
