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
    """Flat shape: the points corner + a e0 + b e1 for some set of (a, b).

    An area element dA at distance r, seen under the angle theta to its normal, takes the solid
    angle cos(theta) / r^2 dA. The density 1 / area becomes r^2 / (area |cos(theta)|).
    """

    def __init__(
        self, corner: np.ndarray, e0: np.ndarray, e1: np.ndarray, area: float, emission: Any
    ) -> None:
        self.corner, self.e0, self.e1, self.area = corner, e0, e1, area
        self.emission = emission_values(emission)
        cross = np.cross(e0, e1)
        self.normal = cross / np.linalg.norm(cross)

    def sample(self, o: mi.Point3f, sample: mi.Point2f) -> EmitterRecord:
        """Direction from `o` to a uniform point of the surface; see `Shape.sample`."""
        a, b = self._coordinates(unit_square(sample))
        p = mi.Point3f(literal(self.corner)) + a * literal(self.e0) + b * literal(self.e1)
        to_p = p - o
        distance = dr.norm(to_p)
        return self._hit(o, p, mi.Vector3f(to_p / distance), distance, mi.Bool(True))

    def record(self, o: mi.Point3f, v: mi.Vector3f) -> EmitterRecord:
        """Intersection of the ray with the plane, by Cramer's rule; see `Shape.record`."""
        e0, e1 = literal(self.e0), literal(self.e1)
        across = dr.cross(v, e1)
        determinant = dr.dot(e0, across)
        from_corner = mi.Vector3f(o - mi.Point3f(literal(self.corner)))
        up = dr.cross(from_corner, e0)
        a, b = dr.dot(from_corner, across) / determinant, dr.dot(v, up) / determinant
        distance = dr.dot(e1, up) / determinant
        valid = (determinant != 0) & self._contains(a, b)
        p = mi.Point3f(literal(self.corner)) + a * e0 + b * e1
        return self._hit(o, p, mi.Vector3f(v), distance, valid)

    def _hit(
        self, o: mi.Point3f, p: mi.Point3f, d: mi.Vector3f, distance: mi.Float, valid: mi.Bool
    ) -> EmitterRecord:
        """Record of a hit; from within the plane there is none, as the solid angle is 0."""
        n = literal(self.normal)
        from_corner = mi.Vector3f(o - mi.Point3f(literal(self.corner)))
        height = dr.abs(dr.dot(n, from_corner))  # Of `o` above the plane: distance cos(theta)
        valid &= (distance > 0) & (height > 4 * dr.epsilon(mi.Float) * dr.norm(from_corner))
        pdf = distance * dr.square(distance) / (self.area * height)
        return self.filled(o, p, n, d, distance, pdf, valid)

    @abstractmethod
    def _coordinates(self, sample: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Uniform (a, b) on the shape."""

    @abstractmethod
    def _contains(self, a: mi.Float, b: mi.Float) -> mi.Bool:
        """Whether (a, b) is on the shape."""

    def __repr__(self) -> str:
        """Area and emission."""
        return f"{type(self).__name__}(area={self.area:g}, emission={self.emission})"


class Quad(Patch):
    """Rectangle, or the parallelogram that a transform makes of it.

    Args:
        size: Width and height [m] of a rectangle in z = 0 around the origin, with the normal +z.
        emission: Radiance on the side of the normal: a number, or three for R, G and B.
        transform: Moves it: an `mi.ScalarTransform4f` or 4 x 4 numbers, affine, or None.

    Attributes:
        area: Its area [m^2].
        normal: Unit normal on the side that emits, shape (3,).

    Raises:
        ValueError: A size is not above 0, the transform leaves no area or is not affine, or the
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
            width, height = (checks.metres("size", each, positive=True) for each in size)
        except (TypeError, ValueError):
            allowed = "must be two finite numbers above 0"
            raise ValueError(f"size = {checks.quote(size)}: {allowed}") from None
        e0, e1 = (matrix[:3, :2] * [width, height]).T
        if np.linalg.det(matrix[:3, :3]) < 0:  # Mitsuba's rectangle keeps its normal's side too
            e0, e1 = e1, e0
        corner = matrix[:3, 3] - 0.5 * (e0 + e1)
        area = parallelogram_area(e0, e1, f"transform = {matrix.tolist()}")
        super().__init__(corner, e0, e1, area, emission)

    @classmethod
    def from_edges(cls, corner: Any, e0: Any, e1: Any, *, emission: Any = 0) -> Quad:
        """Parallelogram of a corner and the two edges that leave it; its normal is e0 x e1.

        Example:
            >>> Quad.from_edges([0, 0, 0], [2, 0, 0], [0, 3, 0]).area
            6.0
        """
        corner, e0, e1 = point("corner", corner), point("e0", e0), point("e1", e1)
        area = parallelogram_area(e0, e1, f"e0 = {e0.tolist()}, e1 = {e1.tolist()}")
        quad = cls.__new__(cls)
        Patch.__init__(quad, corner, e0, e1, area, emission)
        return quad

    def _coordinates(self, sample: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        return sample.x, sample.y

    def _contains(self, a: mi.Float, b: mi.Float) -> mi.Bool:
        return (a >= 0) & (b >= 0) & (a <= 1) & (b <= 1)


class Triangle(Patch):
    """Triangle of three corners, three numbers each; its normal is (v1 - v0) x (v2 - v0).

    Emission and attributes are those of `Quad`. Corners that are not points or lie in one line, and
    an emission that is negative or not finite, raise a ValueError.

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
