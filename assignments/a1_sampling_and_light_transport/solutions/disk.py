"""The disk by concentric squares (Shirley and Chiu 1997): each square ring becomes a circle."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def square_to_uniform_disk(sample: mi.Point2f) -> mi.Point2f:
    """The longer coordinate is the radius, their quotient the angle within an eighth."""
    x = 2 * sample.x - 1
    y = 2 * sample.y - 1
    steep = dr.abs(y) > dr.abs(x)
    radius = dr.select(steep, y, x)
    other = dr.select(steep, x, y)
    quotient = dr.select(radius != 0, other / radius, 0)
    sine, cosine = dr.sincos(0.25 * dr.pi * quotient)
    return mi.Point2f(dr.select(steep, sine, cosine), dr.select(steep, cosine, sine)) * radius


def square_to_uniform_disk_pdf(p: mi.Point2f) -> mi.Float:
    """One over the disk's area."""
    return dr.select(dr.norm(p) < 1 + 1e-6, mi.Float(1 / dr.pi), 0)
