"""Sphere lights, sampled within the cone of directions that they cover."""

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
    """Sphere, sampled within the cone of directions that it covers.

    Seen from outside, at the distance D of the center, the cone has sin(theta_max) = r / D. The
    density is constant, 1 / (2 pi (1 - cos(theta_max))), without a geometry factor. For distant
    spheres, 1 - cos(theta_max) = s^2 / (1 + sqrt(1 - s^2)) with s = r / D has no cancellation. Seen
    from inside, every direction hits, with the density 1 / (4 pi). This density also applies to
    points on the surface (within a few roundings). There half of the directions leave the sphere
    immediately and are not valid.

    Directions are rounded to 6e-8. In cones narrower than 1e-4, `record` and `pdf` miss the edge
    for a fraction of about 1e-7 / theta_max of the samples.

    Args:
        center: Center, three numbers.
        radius: Radius [m], above 0.
        emission: Radiance on the outside: a number, or three for R, G and B.
        transform: Transform of the sphere: an `mi.ScalarTransform4f`, 4 x 4 numbers, or None.
            Rotations, reflections, translations, and one scale for all axes are supported.
        flip_normals: Whether the normal points inwards, so that light is emitted inwards.

    Attributes:
        center: Center after the transform, shape (3,).
        radius: Radius after the transform [m].
        area: Area of the sphere [m^2].

    Raises:
        ValueError: The radius is not above 0, the transform is not supported, or the emission is
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
        center: Any = (0, 0, 0),
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
        self.radius = checks.meters("radius", radius, positive=True) * float(scales.mean())
        self.center = matrix[:3, :3] @ point("center", center) + matrix[:3, 3]
        self.area = 4 * math.pi * self.radius**2
        self.emission = emission_values(emission)
        self.flip_normals = checks.boolean("flip_normals", flip_normals)

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """Sample a uniform direction in the cone; see `Shape.sample`."""
        # Sample a direction in the cone around the direction to the center
        to_center, dc, height = self._cone(o)
        frame = mi.Frame3f(dr.select(dc > 0, to_center / dc, mi.Vector3f(0, 0, 1)))
        local = sample_cap_of_height(sample, height)

        # Compute the vector from the center to the nearest point of the ray
        sin_theta = dr.norm(mi.Vector2f(local.x, local.y))
        offset = dr.minimum(dc * sin_theta, self.radius)
        out = dr.select(sin_theta > 0, mi.Vector2f(local.x, local.y) / sin_theta, 0)
        side = mi.Vector3f(local.z * out.x, local.z * out.y, -sin_theta)
        d = frame.to_world(local)
        sideways = frame.to_world(offset * side)
        return self._hit(o, d, sideways, offset, dc * local.z, dc, height)

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Find the point where a ray enters the sphere, or leaves it from inside.

        The ray passes the center c at the distance |(c - o) x v|. Compensated products make this
        distance exact for distant and small spheres. See `Shape.record`.
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
        """Return the vector to the center, its length dc [m], and 1 - cos(theta_max)."""
        to_center = mi.Vector3f(mi.Point3f(literal(self.center)) - o)
        dc = dr.norm(to_center)
        s2 = dr.square(self.radius / dc)
        height = s2 / (1 + dr.safe_sqrt(1 - s2))
        return to_center, dc, dr.select(self._outside(dc), height, 2)

    def _outside(self, dc: mi.Float) -> mi.Bool:
        """Return whether a point at the distance `dc` [m] from the center is outside."""
        return dc > self.radius * (1 + 4 * dr.epsilon(mi.Float))

    def _hit(
        self,
        o: mi.Point3f,
        d: mi.Vector3f,
        sideways: mi.Vector3f,
        offset: mi.Float,
        t_center: mi.Float,
        dc: mi.Float,
        height: mi.Float,
    ) -> EmitterRecord:
        """Intersect a ray with the sphere, and return the emitter record of the intersection.

        The ray meets the sphere at the distances t_center - half and t_center + half. The product
        of both distances is power = dc² - r². The shorter distance is computed as `power` divided
        by the longer distance, which avoids the cancellation of the difference.

        Args:
            o: Start of the ray.
            d: Direction of the ray.
            sideways: Vector from the center to the point of the ray that is nearest to the center.
            offset: Length of `sideways` [m].
            t_center: Distance from `o` to the point of the ray nearest to the center [m].
            dc: Distance between `o` and the center [m].
            height: Height 1 - cos(theta_max) of the cone.
        """
        r = self.radius
        outside = self._outside(dc)

        # Intersect the ray with the sphere
        on = dr.abs(dc - r) <= 4 * dr.epsilon(mi.Float) * r
        power = dr.select(on, 0, (dc - r) * (dc + r))
        half = dr.safe_sqrt((r - offset) * (r + offset))
        longer = dr.select(t_center < 0, t_center - half, t_center + half)
        distance = dr.select(outside | (t_center < 0), power / longer, longer)
        valid = (offset <= r) & (distance > 0) & (~outside | (t_center > 0))

        # Find point and normal
        n = mi.Vector3f((sideways + dr.select(outside, -half, half) * d) / r)
        p = mi.Point3f(literal(self.center)) + r * n
        n = -n if self.flip_normals else n
        return self.filled(o, p, n, d, distance, dr.rcp(dr.two_pi * height), valid)

    def __repr__(self) -> str:
        """Return center, radius and emission as text."""
        center = ", ".join(f"{each:g}" for each in self.center)
        return f"Sphere(({center}), radius={self.radius:g}, emission={self.emission})"


def _difference_of_products(a: mi.Float, b: mi.Float, c: mi.Float, d: mi.Float) -> mi.Float:
    """Return a b - c d with an error of one or two roundings, by Kahan's algorithm."""
    product = c * d
    lost = dr.fma(-c, d, product)
    return dr.fma(a, b, -product) + lost
