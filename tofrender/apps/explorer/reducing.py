"""Cubes in fewer voxels: means over blocks of pixels, sums over bins, band by band."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...rendering.cubes import PIECE_BYTES, Cube

How = Literal["sum", "mean", "error", "mean error"]
"""What bins that become one do: add up (light per bin), or be averaged (densities); errors of
either add as those of independent estimates."""

MOST = 64
"""Pixels along an edge of a block, and bins, that become one at the most."""


@dataclass(frozen=True, order=True)
class Reduction:
    """Blocks of `space` x `space` pixels and `time` bins become a voxel."""

    space: int = 1
    time: int = 1

    @property
    def voxels(self) -> int:
        """Voxels that become one."""
        return self.space**2 * self.time

    def shape(self, cube: Cube) -> tuple[int, int, int, int]:
        """Rows, columns, bins and channels that a cube gets."""
        height, width, bins, channels = cube.shape[-4:]
        rows, columns = (math.ceil(side / self.space) for side in (height, width))
        return rows, columns, math.ceil(bins / self.time), channels


def reductions(bins: int) -> list[Reduction]:
    """Those that are tried, from the finest on; few bins stay as they are for longer."""
    times = [t for t in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MOST) if t == 1 or bins / t >= 128]
    spaces = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MOST)
    return sorted(
        (Reduction(space, time) for space in spaces for time in times),
        key=lambda each: (each.voxels, each.time),
    )


def bands(
    cube: Cube, by: Reduction, how: How, share: float = 1.0
) -> Iterator[tuple[tuple[int, slice], np.ndarray]]:
    """A cube (..., y, x, bins, channels) in bands of rows, each reduced.

    Args:
        cube: Light or its standard errors.
        by: How it is reduced.
        how: What becomes of bins.
        share: Of the bands; the first of every few of them if it is less than 1.

    Yields:
        Number of the picture along the leading axes, which rows of the result, and these, of shape
        (rows, columns, bins, channels) float32.
    """
    *pictures, height, width, bins, channels = cube.shape
    row = 4 * width * bins * channels
    step = by.space * max(1, min(PIECE_BYTES // row, height // 8) // by.space)
    every = max(1, round(1 / share))
    for number, place in enumerate(np.ndindex(*pictures)):
        for k, first in enumerate(range(0, height, step)):
            if k % every:
                continue
            values = cube.read((*place, slice(first, first + step)))
            begin = first // by.space
            low = _reduced(values, by, how)
            yield (number, slice(begin, begin + len(low))), low


def _reduced(values: np.ndarray, by: Reduction, how: How) -> np.ndarray:
    """Values (rows, columns, bins, channels) reduced along the first three axes."""
    if by.voxels == 1:
        return values.astype(np.float32, copy=False)
    errors = how.endswith("error")
    values = np.square(values) if errors else values
    for axis, size in enumerate((by.space, by.space, by.time)):
        if size == 1:
            continue
        starts = np.arange(0, values.shape[axis], size)
        counts = np.diff(starts, append=values.shape[axis]).reshape(
            [-1 if a == axis else 1 for a in range(4)]
        )
        values = np.add.reduceat(values, starts, axis=axis)
        if axis < 2 or how.startswith("mean"):
            values = values / (counts**2 if errors else counts)
    return (np.sqrt(values) if errors else values).astype(np.float32, copy=False)
