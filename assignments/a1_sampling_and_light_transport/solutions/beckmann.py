"""Beckmann normals by their slopes: two independent normal numbers, one for each axis."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def square_to_beckmann(sample: mi.Point2f, alpha: float | mi.Float) -> mi.Vector3f:
    """The slopes of the surface in x and y have the standard deviation alpha / sqrt(2)."""
    inside = dr.clip(2 * sample - 1, -1 + 1e-7, 1 - 1e-7)
    slope = alpha * mi.Vector2f(dr.erfinv(inside.x), dr.erfinv(inside.y))
    return dr.normalize(mi.Vector3f(slope.x, slope.y, 1))


def square_to_beckmann_pdf(m: mi.Vector3f, alpha: float | mi.Float) -> mi.Float:
    """The normal density of both slopes, times dslope / domega = 1 / cos(theta)^3."""
    above = m.z > 1e-6
    z = dr.select(above, m.z, 1)
    slope2 = (dr.square(m.x) + dr.square(m.y)) / dr.square(z)
    exponent = -slope2 / dr.square(alpha) - 3 * dr.log(z)
    return dr.select(above, dr.exp(exponent) / (dr.pi * dr.square(alpha)), 0)
