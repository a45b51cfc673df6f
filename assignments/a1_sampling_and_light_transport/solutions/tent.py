"""The tent by its symmetry: the distance from the middle, then the side."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def square_to_tent(sample: mi.Point2f) -> mi.Point2f:
    """With s = 2 u - 1, |t| has the density 2 (1 - |t|), and the sign of s is a fair coin."""
    s = 2 * sample - 1
    distance = 1 - dr.sqrt(1 - dr.abs(s))
    return mi.Point2f(dr.copysign(distance, s))


def square_to_tent_pdf(p: mi.Point2f) -> mi.Float:
    """Product of both tents."""
    x, y = dr.abs(p.x), dr.abs(p.y)
    return dr.select((x < 1) & (y < 1), (1 - x) * (1 - y), 0)
