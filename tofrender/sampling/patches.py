"""Flat lights: parallelograms and triangles."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from .emitter_records import EmitterRecord, Shape, affine, emission_values
from .triangles_and_caps import (
    literal,
    parallelogram_area,
    point,
    sample_triangle,
    triangle_corners,
)
from .warps import unit_square


class Patch(Shape):
    """Flat shape: the points corner + a e0 + b e1 for a set of coordinates (a, b).

    An area element dA at the distance r has the solid angle cos(theta) / r^2 dA, with the angle
    theta to its normal. Therefore the density 1 / area becomes r^2 / (area |cos(theta)|).

    Args:
        corner: Point at (a, b) = (0, 0).
        e0: Edge along a.
        e1: Edge along b.
        area: Area [m^2].
        emission: Radiance on the side of the normal e0 x e1.
    """

    def __init__(
        self, corner: np.ndarray, e0: np.ndarray, e1: np.ndarray, area: float, emission: Any
    ) -> None:
        self.corner = corner
        self.e0 = e0
        self.e1 = e1
        self.area = area
        self.emission = emission_values(emission)
        cross = np.cross(e0, e1)
        self.normal = cross / np.linalg.norm(cross)

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """Sample a direction from `o` to a uniform point of the surface; see `Shape.sample`."""
        a, b = self._coordinates(unit_square(sample))
        p = mi.Point3f(literal(self.corner)) + a * literal(self.e0) + b * literal(self.e1)
        to_p = p - o
        distance = dr.norm(to_p)
        return self._hit(o, p, mi.Vector3f(to_p / distance), distance, mi.Bool(True))

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Intersect a ray with the plane by Cramer's rule; see `Shape.record`."""
        e0 = literal(self.e0)
        e1 = literal(self.e1)
        across = dr.cross(v, e1)
        determinant = dr.dot(e0, across)
        from_corner = mi.Vector3f(o - mi.Point3f(literal(self.corner)))
        up = dr.cross(from_corner, e0)
        a = dr.dot(from_corner, across) / determinant
        b = dr.dot(v, up) / determinant
        distance = dr.dot(e1, up) / determinant
        valid = (determinant != 0) & self._contains(a, b)
        p = mi.Point3f(literal(self.corner)) + a * e0 + b * e1
        return self._hit(o, p, mi.Vector3f(v), distance, valid)

    def _hit(
        self, o: mi.Point3f, p: mi.Point3f, d: mi.Vector3f, distance: mi.Float, valid: mi.Bool
    ) -> EmitterRecord:
        """Return the record of a hit. Points in the plane see no light: their solid angle is 0."""
        n = literal(self.normal)
        from_corner = mi.Vector3f(o - mi.Point3f(literal(self.corner)))

        # Height of `o` above the plane, which is distance times cos(theta)
        height = dr.abs(dr.dot(n, from_corner))
        valid &= (distance > 0) & (height > 4 * dr.epsilon(mi.Float) * dr.norm(from_corner))
        pdf = distance * dr.square(distance) / (self.area * height)
        return self.filled(o, p, n, d, distance, pdf, valid)

    @abstractmethod
    def _coordinates(self, sample: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Return coordinates (a, b) that are uniform on the shape."""

    @abstractmethod
    def _contains(self, a: mi.Float, b: mi.Float) -> mi.Bool:
        """Return whether (a, b) is on the shape."""

    def __repr__(self) -> str:
        """Return area and emission as text."""
        return f"{type(self).__name__}(area={self.area:g}, emission={self.emission})"


class Quad(Patch):
    """Rectangle, or a parallelogram if the transform contains a shear.

    Args:
        size: Width and height [m] of a rectangle in z = 0 around the origin, with the normal +z.
        emission: Radiance on the side of the normal: a number, or three for R, G and B.
        transform: Affine transform of the rectangle: an `mi.ScalarTransform4f`, 4 x 4 numbers, or
            None.

    Attributes:
        area: Area of the parallelogram [m^2].
        normal: Unit normal on the side that emits, shape (3,).

    Raises:
        ValueError: A size is not above 0, the transform is not affine or results in no area, or the
            emission is negative or not finite.

    Example:
        >>> light = Quad((1, 1), emission=2, transform=mi.ScalarTransform4f().translate([0, 0, 3]))
        >>> record = light.sample(mi.Point3f(0, 0, 5), mi.Point2f(0.5))
        >>> print(record.d, record.pdf, record.radiance.x)
        [[0, 0, -1]] [4] [2]
    """

    def __init__(
        self, size: Sequence[float] = (2, 2), *, emission: Any = 0, transform: Any = None
    ) -> None:
        matrix = affine(transform)
        try:
            width, height = (checks.meters("size", each, positive=True) for each in size)
        except (TypeError, ValueError):
            allowed = "must be two finite numbers above 0"
            raise ValueError(f"size = {checks.quote(size)}: {allowed}") from None
        e0, e1 = (matrix[:3, :2] * [width, height]).T
        # A mirror image keeps the side of its normal, as in Mitsuba's rectangle
        if np.linalg.det(matrix[:3, :3]) < 0:
            e0, e1 = e1, e0
        corner = matrix[:3, 3] - 0.5 * (e0 + e1)
        area = parallelogram_area(e0, e1, f"transform = {matrix.tolist()}")
        super().__init__(corner, e0, e1, area, emission)

    @classmethod
    def from_edges(cls, corner: Any, e0: Any, e1: Any, *, emission: Any = 0) -> Quad:
        """Create a parallelogram from a corner and two edges. Its normal is e0 x e1.

        Example:
            >>> Quad.from_edges([0, 0, 0], [2, 0, 0], [0, 3, 0]).area
            6.0
        """
        corner = point("corner", corner)
        e0 = point("e0", e0)
        e1 = point("e1", e1)
        area = parallelogram_area(e0, e1, f"e0 = {e0.tolist()}, e1 = {e1.tolist()}")
        quad = cls.__new__(cls)
        Patch.__init__(quad, corner, e0, e1, area, emission)
        return quad

    def _coordinates(self, sample: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        return sample.x, sample.y

    def _contains(self, a: mi.Float, b: mi.Float) -> mi.Bool:
        return (a >= 0) & (b >= 0) & (a <= 1) & (b <= 1)


class Triangle(Patch):
    """Triangle with three corners of three numbers each. Its normal is (v1 - v0) x (v2 - v0).

    Emission and attributes are as in `Quad`.

    Raises:
        ValueError: A corner is not a point, the corners are on one line, or the emission is
            negative or not finite.

    Example:
        >>> light = Triangle([0, 0, 0], [1, 0, 0], [0, 1, 0], emission=(1, 2, 3))
        >>> light.area, light.is_emissive, light.pdf(mi.Point3f(0.2, 0.2, 3), mi.Vector3f(0, 0, -1))
        (0.5, True, [18])
    """

    def __init__(self, v0: Any, v1: Any, v2: Any, emission: Any = 0) -> None:
        a, b, c = triangle_corners(v0, v1, v2)
        area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a)))
        super().__init__(a, b - a, c - a, area, emission)

    def _coordinates(self, sample: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        b = sample_triangle([0, 0, 0], [1, 0, 0], [0, 1, 0], sample)
        return b.x, b.y

    def _contains(self, a: mi.Float, b: mi.Float) -> mi.Bool:
        return (a >= 0) & (b >= 0) & (a + b <= 1)
