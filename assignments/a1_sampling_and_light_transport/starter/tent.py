"""Problem a1.tent: the tent density on the plane.

A warp maps uniform random points of the unit square to points of another density. Here, and in all
following warps, `sample` has two Dr.Jit numbers (u, v), each in [0, 1), for any number of lanes; 0
does occur. `mi.warp` is not allowed, because it contains the results that you derive.
"""

from __future__ import annotations

import mitsuba as mi


def square_to_tent(sample: mi.Point2f) -> mi.Point2f:
    """Warp to the tent p(x, y) = p1(x) p1(y) with p1(t) = 1 - |t| on [-1, 1] and 0 elsewhere.

    Integrate p1 to P1(t), and solve P1(t) = u for t. Sample x and y in the same way.

    Args:
        sample: Uniform points (u, v) of the unit square.

    Returns:
        Points of [-1, 1]^2.
    """
    raise NotImplementedError("a1.tent: square_to_tent")


def square_to_tent_pdf(p: mi.Point2f) -> mi.Float:
    """Density of `square_to_tent` per unit area at the points `p`, 0 outside of [-1, 1]^2."""
    raise NotImplementedError("a1.tent: square_to_tent_pdf")
