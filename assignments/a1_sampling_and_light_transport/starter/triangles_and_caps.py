"""Problem a1.triangles_and_caps: sampling triangles and spherical caps."""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi


def sample_triangle(
    v0: Sequence[float], v1: Sequence[float], v2: Sequence[float], sample: mi.Point2f
) -> mi.Point3f:
    """Uniform points on a triangle.

    Args:
        v0: First corner, three numbers.
        v1: Second corner.
        v2: Third corner.
        sample: Uniform points (u, v) of the unit square, each number in [0, 1).

    Returns:
        Points with the density 1 / area.
    """
    raise NotImplementedError("a1.triangles_and_caps: sample_triangle")


def sample_triangle_pdf(
    p: mi.Point3f, v0: Sequence[float], v1: Sequence[float], v2: Sequence[float]
) -> mi.Float:
    """Density of `sample_triangle` per unit area at the points `p`.

    The density is 0 for points that are not on the triangle, including points above its plane.
    Allow for a distance of about 1e-5 of the longest edge, because of rounding in single precision.
    """
    raise NotImplementedError("a1.triangles_and_caps: sample_triangle_pdf")


def sample_sphere_cap(sample: mi.Point2f, cos_theta_max: float | mi.Float) -> mi.Vector3f:
    """Uniform directions in the spherical cap theta <= theta_max around +z.

    Args:
        sample: Uniform points (u, v) of the unit square, each number in [0, 1).
        cos_theta_max: Cosine of the largest angle to +z, from -1 (the sphere) to below 1; a number
            or a Dr.Jit float.

    Returns:
        Unit vectors.
    """
    raise NotImplementedError("a1.triangles_and_caps: sample_sphere_cap")


def sample_sphere_cap_pdf(v: mi.Vector3f, cos_theta_max: float | mi.Float) -> mi.Float:
    """Density of `sample_sphere_cap` [1/sr] at the unit vectors `v`, 0 outside of the cap."""
    raise NotImplementedError("a1.triangles_and_caps: sample_sphere_cap_pdf")
