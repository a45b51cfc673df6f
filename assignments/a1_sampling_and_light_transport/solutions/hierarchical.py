"""Image sampling by rows and columns: the marginal distribution of y, then x within the row."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np


class HierarchicalWarp:
    """Points on the unit square, distributed like the brightness of an image."""

    def __init__(self, image):
        weights = np.asarray(image, dtype=np.float64)
        self.n = len(weights)
        rows = weights.sum(axis=1)
        self._rows = mi.Float(np.cumsum(rows) / rows.sum())
        sums = np.where(rows > 0, rows, 1)[:, None]
        self._columns = mi.Float((np.cumsum(weights, axis=1) / sums).ravel())
        self._density = mi.Float((weights * self.n**2 / weights.sum()).ravel())

    def sample(self, sample):
        """Two searches in cumulative sums."""
        row, y = self._search(self._rows, mi.UInt32(0), sample.y)
        column, x = self._search(self._columns, row * self.n, sample.x)
        return mi.Point2f((column + x) / self.n, (row + y) / self.n)

    def pdf(self, p):
        """The brightness over its mean."""
        inside = (p.x >= 0) & (p.x < 1) & (p.y >= 0) & (p.y < 1)
        column, row = (mi.UInt32(dr.clip(each * self.n, 0, self.n - 1)) for each in (p.x, p.y))
        return dr.gather(mi.Float, self._density, row * self.n + column, inside)

    def _search(self, sums, first, u):
        """Find the first entry above u, and the relative position of u between its neighbors."""

        def below(index):
            return dr.gather(mi.Float, sums, first + index) <= u

        index = dr.minimum(dr.binary_search(0, self.n, below), self.n - 1)
        low = dr.select(index > 0, dr.gather(mi.Float, sums, first + index - 1, index > 0), 0)
        high = dr.gather(mi.Float, sums, first + index)
        rest = dr.select(high > low, (u - low) / (high - low), 0)
        return index, dr.clip(rest, 0, 0.9999)
