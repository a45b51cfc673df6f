"""Blocks of pixels and bins: sums in each, and values interpolated between their centres."""

from __future__ import annotations

import numpy as np
from scipy import sparse

PIXELS, BINS = 4, 2
"""Size of a block: pixels along each side, and bins."""


class Blocks:
    """Blocks of a film (height, width, bins), which is worked on in parts that caches hold.

    Attributes:
        parts: Rows of blocks, as slices of the pixels row by row.
    """

    def __init__(self, height: int, width: int, bins: int) -> None:
        self.size = height, width, bins
        y, x, self._over_bins = (
            _linear(*each) for each in ((height, PIXELS), (width, PIXELS), (bins, BINS))
        )
        self.parts = [slice(n * width, (n + PIXELS) * width) for n in range(0, height, PIXELS)]
        over_pixels = sparse.csr_matrix(sparse.kron(y, x))
        self._over_pixels = [over_pixels[part] for part in self.parts]
        columns = np.arange(height * width) % width // PIXELS
        self._sums = []
        for part in self.parts:
            own = columns[part]
            cells = np.ones(len(own), np.float32), (own, np.arange(len(own)))
            self._sums.append(sparse.csr_matrix(cells))
        self._starts = np.arange(0, bins, BINS)

    def sums(self, values: np.ndarray, part: int) -> np.ndarray:
        """Sums (columns, times) of a part's values (pixels, bins) in its blocks."""
        return np.add.reduceat(self._sums[part] @ values, self._starts, axis=1)

    def interpolated(self, values: np.ndarray) -> list[np.ndarray]:
        """Values (rows, columns, times) at all pixels and bins: (pixels, bins) for each part."""
        in_time = self._over_bins @ values.reshape(-1, values.shape[2]).T
        flat = np.ascontiguousarray(in_time.T)
        return [matrix @ flat for matrix in self._over_pixels]

    def repeated(self, values: np.ndarray) -> np.ndarray:
        """Values (rows, columns, times) of the blocks of all pixels, float32 (pixels, bins)."""
        for axis, (size, count) in enumerate(zip((PIXELS, PIXELS, BINS), self.size, strict=True)):
            values = np.repeat(values, size, axis=axis).take(range(count), axis=axis)
        return values.reshape(-1, self.size[2]).astype(np.float32)


def _linear(count: int, size: int) -> sparse.csr_matrix:
    """Matrix (count, blocks) that interpolates linearly between the centres of blocks."""
    blocks = -(-count // size)
    at = np.clip((np.arange(count) + 0.5) / size - 0.5, 0, blocks - 1)
    low = np.minimum(at.astype(int), max(blocks - 2, 0))
    cells, high = np.arange(count), np.minimum(low + 1, blocks - 1)
    weights = np.concatenate([1 - at + low, at - low]).astype(np.float32)
    pairs = np.concatenate([cells, cells]), np.concatenate([low, high])
    return sparse.csr_matrix((weights, pairs), (count, blocks))
