"""Problem a1.disk: uniform points on the unit disk."""

from __future__ import annotations

import mitsuba as mi


def square_to_uniform_disk(sample: mi.Point2f) -> mi.Point2f:
    """Warp to a constant density on the disk of radius 1 around the origin.

    Args:
        sample: Uniform points (u, v) of the unit square, each number in [0, 1).

    Returns:
        Points of the disk.
    """
    raise NotImplementedError("a1.disk: square_to_uniform_disk")


def square_to_uniform_disk_pdf(p: mi.Point2f) -> mi.Float:
    """Density of `square_to_uniform_disk` per unit area at the points `p`, 0 off the disk."""
    raise NotImplementedError("a1.disk: square_to_uniform_disk_pdf")
