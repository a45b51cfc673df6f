"""Problem a1.beckmann: normals of rough surfaces."""

from __future__ import annotations

import mitsuba as mi


def square_to_beckmann(sample: mi.Point2f, alpha: float | mi.Float) -> mi.Vector3f:
    """Warp to the density of `square_to_beckmann_pdf`.

    Args:
        sample: Uniform points (u, v) of the unit square, each number in [0, 1); 0 does occur.
        alpha: Roughness, above 0; a number or a Dr.Jit float.

    Returns:
        Unit vectors m with z > 0 (normals of the surface's facets), finite for every sample.
    """
    raise NotImplementedError("a1.beckmann: square_to_beckmann")


def square_to_beckmann_pdf(m: mi.Vector3f, alpha: float | mi.Float) -> mi.Float:
    """Density exp(-tan(theta)^2 / alpha^2) / (pi alpha^2 cos(theta)^3) [1/sr] at unit vectors `m`.

    It is 0 at the horizon (z = 0) and below, and finite everywhere.

    Args:
        m: Unit vectors.
        alpha: Roughness, above 0; a number or a Dr.Jit float.
    """
    raise NotImplementedError("a1.beckmann: square_to_beckmann_pdf")
