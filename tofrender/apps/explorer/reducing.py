"""Reduction of cubes: means over blocks of pixels, sums or means over bins, by bands of rows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...rendering.cubes import PIECE_BYTES, Cube

Mode = Literal["sum", "mean", "error", "mean error"]
"""Joined bins are summed (light per bin) or averaged (densities); standard errors of either are
combined as those of independent estimates."""

MAX_SIZE = 64
"""Largest edge of a block in pixels, and largest number of joined bins."""


@dataclass(frozen=True, order=True)
class Reduction:
    """Blocks of `space` x `space` pixels and `time` bins that are joined."""

    space: int = 1
    time: int = 1

    def shape(self, cube: Cube) -> tuple[int, int, int, int]:
        """Rows, columns, bins and channels of a reduced cube."""
        height, width, bins, channels = cube.shape[-4:]
        rows, columns = (math.ceil(side / self.space) for side in (height, width))
        return rows, columns, math.ceil(bins / self.time), channels


def reductions(bins: int) -> list[Reduction]:
    """Possible reductions from the finest on, of which 128 bins or more remain."""
    sizes = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MAX_SIZE)
    times = [t for t in sizes if t == 1 or bins / t >= 128]
    found = [Reduction(space, time) for space in sizes for time in times]
    return sorted(found, key=lambda each: (each.space**2 * each.time, each.time))


def bands(
    cube: Cube, by: Reduction, mode: Mode, every: int = 1
) -> Iterator[tuple[tuple[int, slice], np.ndarray]]:
    """Reduce a cube (..., y, x, bins, channels) by bands of rows, or one of `every` few of them.

    Yields the picture's number along leading axes, rows of the result, and their values.
    """
    *pictures, height, width, bins, channels = cube.shape
    row = 4 * width * bins * channels
    step = by.space * max(1, min(PIECE_BYTES // row, height // 8) // by.space)
    for number, picture in enumerate(np.ndindex(*pictures)):
        for first in range(0, height, every * step):
            values = cube.read((*picture, slice(first, first + step)))
            begin = first // by.space
            band = _reduced(values, by, mode)
            yield (number, slice(begin, begin + len(band))), band


def _reduced(values: np.ndarray, by: Reduction, mode: Mode) -> np.ndarray:
    """Values (rows, columns, bins, channels) reduced along the first three axes."""
    if by == Reduction():
        return values.astype(np.float32, copy=False)
    errors = mode.endswith("error")
    values = np.square(values) if errors else values
    for axis, size in enumerate((by.space, by.space, by.time)):
        if size == 1:
            continue
        starts = np.arange(0, values.shape[axis], size)
        counts = np.diff(starts, append=values.shape[axis]).reshape(
            [-1 if a == axis else 1 for a in range(4)]
        )
        values = np.add.reduceat(values, starts, axis=axis)
        if axis < 2 or mode.startswith("mean"):
            values = values / (counts**2 if errors else counts)
    return (np.sqrt(values) if errors else values).astype(np.float32, copy=False)
