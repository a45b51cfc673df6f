"""Compression of cubes: reduction of pixels and bins, and quantisation to codes of one byte.

Code 0 is darkness; code q from 1 to 255 stands for least * ratio^(q - 1). Of values with a sign,
q is from 1 to 127, and 128 + q stands for the negative value.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...rendering.cubes import PIECE_BYTES, Cube

# Joined bins are summed (light per bin) or averaged (densities); standard errors of either are
# combined as those of independent estimates
Mode = Literal["sum", "mean", "error", "mean error"]

MAX_SIZE = 64  # Largest edge of a block in pixels, and largest number of joined bins
CODES = 255  # Number of codes, without that of darkness
SIGN = 128  # Is added to the code of a negative value
DARK = 1e-4  # Fraction of all light that may lie in values too small to have a code
DARK_SMALL = 1e-2  # Likewise if codes have to take less than SMALL bytes
SMALL = 1_000_000
DECADES = 7  # Largest range of values that have a code
_OCTAVES, _PER_OCTAVE = 1100, 16  # Of the histogram of values, on either side of 1


@dataclass(frozen=True)
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
    """Possible reductions that leave 128 bins or more, the finest first."""
    sizes = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MAX_SIZE)
    times = [t for t in sizes if t == 1 or bins / t >= 128]
    found = [Reduction(space, time) for space in sizes for time in times]
    return sorted(found, key=lambda each: each.space**2.5 * each.time)  # Pixels are missed more


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


@dataclass(frozen=True)
class Scale:
    """Logarithmic scale of codes: the value of code 1, and the ratio of successive values."""

    least: float
    ratio: float
    signed: bool = False

    @classmethod
    def of(
        cls, pieces: Iterable[np.ndarray], signed: bool = False, most_bytes: float | None = None
    ) -> "Scale":
        """Scale for the finite values of all pieces, those above 0 unless `signed`."""
        dark = DARK if most_bytes is None or most_bytes >= SMALL else DARK_SMALL
        sums = np.zeros(2 * _OCTAVES * _PER_OCTAVE)  # Histogram of light over log2 of values
        low, high = math.inf, 0.0
        for piece in pieces:
            values = abs(piece) if signed else piece
            lit = values[(values > 0) & np.isfinite(values)].astype(np.float64)
            if lit.size:
                low, high = min(low, float(lit.min())), max(high, float(lit.max()))
                bins = np.floor((np.log2(lit) + _OCTAVES) * _PER_OCTAVE).astype(np.int64)
                sums += np.bincount(bins, lit, sums.size)
        if not high:
            return cls(1.0, 2.0, signed)
        light = np.cumsum(sums)
        first = int(np.searchsorted(light, dark * light[-1], side="right"))
        low = max(low, 2 ** (first / _PER_OCTAVE - _OCTAVES))
        least = min(max(low, high / 10**DECADES), high)
        codes = SIGN - 1 if signed else CODES
        return cls(least, max((high / least) ** (1 / (codes - 1)), 1 + 1e-6), signed)

    @property
    def tolerance(self) -> float:
        """Largest relative error from `least` on; smaller values are off by less than `least`."""
        return math.sqrt(self.ratio) - 1

    def codes(self, values: np.ndarray) -> np.ndarray:
        """The nearest codes; 0 for values that are not finite."""
        sizes = abs(values) if self.signed else values
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.log2(sizes * np.float32(1 / self.least), dtype=np.float32)
            steps *= np.float32(1 / math.log2(self.ratio))
            found = np.clip(np.rint(steps) + 1, 0, SIGN - 1 if self.signed else CODES)
        codes = np.where(np.isfinite(found) & np.isfinite(values), found, 0).astype(np.uint8)
        return codes + SIGN * (values < 0).astype(np.uint8) if self.signed else codes

    def values(self, codes: np.ndarray) -> np.ndarray:
        """Values of codes."""
        sizes = codes % SIGN if self.signed else codes
        found = np.where(sizes > 0, self.least * self.ratio ** (sizes.astype(np.float64) - 1), 0.0)
        return np.where(codes >= SIGN, -found, found) if self.signed else found
