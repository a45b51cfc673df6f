"""Storage of a film's channels for fast gathers, and blocks of pixels and bins.

A cell is one bin of one pixel. A block contains 4 x 4 pixels and 2 bins, and the denoiser computes
one gain for each block. Lanes visit the cells block by block, so sums over blocks do not need
atomic additions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

PIXELS = 4  # Size of a block in pixels, along each side
BINS = 2  # Size of a block in bins
CELLS = PIXELS * PIXELS * BINS  # Number of cells in a block


@dataclass
class Packets:
    """Channels of each cell, padded to a power of two so that one gather reads all channels."""

    data: mi.Float  # The padded channels of all cells
    cells: int  # Number of cells: pixels times bins
    channels: int  # Number of channels

    @classmethod
    def of(
        cls, cells: int, cell: mi.UInt32, values: Sequence[mi.Float], active: mi.Bool | bool = True
    ) -> Packets:
        """Store channels of cells.

        Args:
            cells: Number of all cells.
            cell: Index of the cell of each lane. No cell may occur twice.
            values: The channels, one array for each.
            active: Lanes that store their values.
        """
        stride = 1 << (len(values) - 1).bit_length()
        padded = mi.ArrayXf([*values, *[mi.Float(0)] * (stride - len(values))])
        data = dr.empty(mi.Float, cells * stride)
        dr.scatter(data, padded, cell, active, mode=dr.ReduceMode.Permute)
        return cls(data, cells, len(values))

    def at(self, cell: mi.UInt32, active: mi.Bool | bool = True) -> list[mi.Float]:
        """Return the channels of the cells with these indices."""
        shape = dr.width(self.data) // self.cells, dr.width(cell)
        values = dr.gather(mi.ArrayXf, self.data, cell, active, shape=shape)
        return [values[channel] for channel in range(self.channels)]

    def totals(self, bins: int) -> np.ndarray:
        """Return the sums over the bins of each pixel, shape (pixels, channels)."""
        values = self.at(dr.arange(mi.UInt32, self.cells))
        dr.eval(values)
        return np.stack([np.array(dr.block_sum(value, bins)) for value in values], axis=-1)


class Blocks:
    """Division of a film into blocks.

    Attributes:
        size: Height [pixels], width [pixels] and number of bins of the film.
        shape: Number of blocks along each of these axes.
    """

    def __init__(self, height: int, width: int, bins: int) -> None:
        self.size = height, width, bins
        self.shape = tuple(
            -(-n // of) for n, of in zip(self.size, (PIXELS, PIXELS, BINS), strict=True)
        )

    def lanes(self) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.Bool]:
        """Assign a lane to each cell, block by block.

        Returns:
            Row, column and bin of each lane, and whether the cell is inside of the film. Blocks at
            the edges may extend beyond the film.
        """
        _, across, times = self.shape
        lane = dr.arange(mi.UInt32, int(np.prod(self.shape)) * CELLS)
        block = lane // CELLS
        within = lane % CELLS
        t = block % times * BINS + within % BINS
        x = block // times % across * PIXELS + within // BINS % PIXELS
        y = block // (times * across) * PIXELS + within // (BINS * PIXELS)
        height, width, bins = self.size
        return y, x, t, (y < height) & (x < width) & (t < bins)

    def of(self, y: mi.UInt32, x: mi.UInt32, t: mi.UInt32) -> mi.UInt32:
        """Return the index of the block that contains the cell in row y, column x and bin t."""
        return (y // PIXELS * self.shape[1] + x // PIXELS) * self.shape[2] + t // BINS

    def sums(self, *values: mi.Float) -> list[np.ndarray]:
        """Return the sums in each block of values of all `lanes`, as arrays of shape `shape`."""
        dr.eval(values)
        sums = [np.array(dr.block_sum(each, CELLS), np.float64) for each in values]
        return [each.reshape(self.shape) for each in sums]
