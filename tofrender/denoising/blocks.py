"""Storage of a film's channels side by side, and its blocks of pixels and bins.

A block has a gain of its own. Lanes go through the cells of one block after the other, so that
sums in blocks need no atomic additions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

PIXELS, BINS = 4, 2  # Size of a block: pixels along each side, and bins

CELLS = PIXELS * PIXELS * BINS


@dataclass
class Packets:
    """Channels of each cell, padded to a power of two, so that one gather reads them."""

    data: mi.Float
    cells: int  # Pixels times bins
    channels: int

    @classmethod
    def of(
        cls, cells: int, cell: mi.UInt32, values: Sequence[mi.Float], active: mi.Bool | bool = True
    ) -> Packets:
        """Packets with these values at some cells, of which each is there once."""
        stride = 1 << (len(values) - 1).bit_length()
        padded = mi.ArrayXf([*values, *[mi.Float(0)] * (stride - len(values))])
        data = dr.empty(mi.Float, cells * stride)
        dr.scatter(data, padded, cell, active, mode=dr.ReduceMode.Permute)
        return cls(data, cells, len(values))

    def at(self, cell: mi.UInt32, active: mi.Bool | bool = True) -> list[mi.Float]:
        """Channels of some cells."""
        shape = dr.width(self.data) // self.cells, dr.width(cell)
        found = dr.gather(mi.ArrayXf, self.data, cell, active, shape=shape)
        return [found[channel] for channel in range(self.channels)]

    def totals(self, bins: int) -> np.ndarray:
        """Sums over the bins of each pixel, (pixels, channels)."""
        values = self.at(dr.arange(mi.UInt32, self.cells))
        dr.eval(values)
        return np.stack([np.array(dr.block_sum(value, bins)) for value in values], axis=-1)


class Blocks:
    """Blocks of a film of some height, width and number of bins.

    Attributes:
        size: Height, width and bins of the film.
        shape: Blocks along each of these.
    """

    def __init__(self, height: int, width: int, bins: int) -> None:
        self.size = height, width, bins
        self.shape = tuple(
            -(-n // of) for n, of in zip(self.size, (PIXELS, PIXELS, BINS), strict=True)
        )

    def lanes(self) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.Bool]:
        """Row, column and bin of a lane for each cell, block by block; False for those outside."""
        _, across, times = self.shape
        lane = dr.arange(mi.UInt32, int(np.prod(self.shape)) * CELLS)
        block, within = lane // CELLS, lane % CELLS
        t = block % times * BINS + within % BINS
        x = block // times % across * PIXELS + within // BINS % PIXELS
        y = block // (times * across) * PIXELS + within // (BINS * PIXELS)
        height, width, bins = self.size
        return y, x, t, (y < height) & (x < width) & (t < bins)

    def of(self, y: mi.UInt32, x: mi.UInt32, t: mi.UInt32) -> mi.UInt32:
        """Number of the block that a cell is in."""
        return (y // PIXELS * self.shape[1] + x // PIXELS) * self.shape[2] + t // BINS

    def sums(self, *values: mi.Float) -> list[np.ndarray]:
        """Sums of values of all `lanes` in each block, arrays of `shape`."""
        dr.eval(values)
        sums = [np.array(dr.block_sum(each, CELLS), np.float64) for each in values]
        return [each.reshape(self.shape) for each in sums]
