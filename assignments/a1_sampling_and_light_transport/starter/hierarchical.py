"""Problem a1.hierarchical (bonus): points that are distributed like an image."""

from __future__ import annotations

import mitsuba as mi
import numpy as np


class HierarchicalWarp:
    """Points on the unit square, distributed like the brightness of an image.

    x runs to the right over columns, y runs down over rows: texel (i, j), column i of row j, covers
    [i/n, (i+1)/n) x [j/n, (j+1)/n). The density is constant within a texel.

    Build the mip map once (sums over 2 x 2 blocks up to one number). A sample passes its levels in
    reverse order. In each level, y selects the upper or lower half of the block in proportion to
    their sums, and then x selects one of the two quadrants of this half. The remainders of y and x
    are rescaled to [0, 1) for the next level.

    Args:
        image: Brightness, shape (n, n), n a power of two, 0 or more, not all 0.
    """

    def __init__(self, image: np.ndarray) -> None:
        raise NotImplementedError("a1.hierarchical: HierarchicalWarp")

    def sample(self, sample: mi.Point2f) -> mi.Point2f:
        """Warp points.

        Args:
            sample: Uniform points of the unit square, each number in [0, 1).

        Returns:
            Points of [0, 1)^2, never in a texel that is 0.
        """
        raise NotImplementedError("a1.hierarchical: HierarchicalWarp.sample")

    def pdf(self, p: mi.Point2f) -> mi.Float:
        """Density of `sample` at points `p` per unit area, 0 outside of the unit square."""
        raise NotImplementedError("a1.hierarchical: HierarchicalWarp.pdf")
