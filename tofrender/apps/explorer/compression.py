"""Compression of cubes: reduction of pixels and bins, and quantization to codes of one byte.

Code 0 means darkness. Code q from 1 to 255 means the value least * ratio^(q - 1). For values with a
sign, q is from 1 to 127, and 128 + q means the negative value.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...rendering.cubes import PIECE_BYTES, Cube

# Joined bins are summed (light per bin) or averaged (densities). Standard errors are combined as
# errors of independent estimates
Mode = Literal["sum", "mean", "error", "mean error"]

MAX_SIZE = 64  # Largest edge of a block in pixels, and largest number of joined bins
CODES = 255  # Number of codes, without the code of darkness
SIGN = 128  # Added to the code of a negative value
DARK = 1e-4  # Largest fraction of the light in values that are too small to have a code
DARK_SMALL = 1e-2  # Largest such fraction if codes must be smaller than SMALL bytes
SMALL = 1_000_000
DECADES = 7  # Largest range of values that have a code, in powers of ten
_OCTAVES = 1100  # Range of the histogram of values, on each side of 1
_PER_OCTAVE = 16  # Bins of this histogram in an octave


@dataclass(frozen=True)
class Reduction:
    """Blocks of `space` x `space` pixels and `time` bins that are joined."""

    space: int = 1
    time: int = 1

    def shape(self, cube: Cube) -> tuple[int, int, int, int]:
        """Return rows, columns, bins and channels of a reduced cube."""
        height, width, bins, channels = cube.shape[-4:]
        rows, columns = (math.ceil(side / self.space) for side in (height, width))
        return rows, columns, math.ceil(bins / self.time), channels


def reductions(bins: int) -> list[Reduction]:
    """Return the possible reductions to 128 bins or more, the finest reduction first."""
    sizes = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, MAX_SIZE)
    times = [t for t in sizes if t == 1 or bins / t >= 128]
    found = [Reduction(space, time) for space in sizes for time in times]
    # Missing pixels disturb more than missing bins
    return sorted(found, key=lambda each: each.space**2.5 * each.time)


def bands(
    cube: Cube, by: Reduction, mode: Mode, every: int = 1
) -> Iterator[tuple[tuple[int, slice], np.ndarray]]:
    """Reduce a cube (..., y, x, bins, channels) in bands of rows, all or one of `every` few bands.

    Yields the index of the picture along the leading axes, the rows of the result, and their
    values.
    """
    # Choose bands of whole blocks
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
    """Reduce values (rows, columns, bins, channels) along the first three axes."""
    if by == Reduction():
        return values.astype(np.float32, copy=False)

    # Squares of independent errors add up
    errors = mode.endswith("error")
    values = np.square(values) if errors else values
    for axis, size in enumerate((by.space, by.space, by.time)):
        if size == 1:
            continue
        # The last block may be smaller
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
        """Choose the scale for the finite values of all pieces. Unsigned values must be above 0."""
        # Sum the light in a histogram over the logarithm of values
        dark = DARK if most_bytes is None or most_bytes >= SMALL else DARK_SMALL
        sums = np.zeros(2 * _OCTAVES * _PER_OCTAVE)
        low = math.inf
        high = 0.0
        for piece in pieces:
            values = abs(piece) if signed else piece
            lit = values[(values > 0) & np.isfinite(values)].astype(np.float64)
            if lit.size:
                low = min(low, float(lit.min()))
                high = max(high, float(lit.max()))
                bins = np.floor((np.log2(lit) + _OCTAVES) * _PER_OCTAVE).astype(np.int64)
                sums += np.bincount(bins, lit, sums.size)
        if not high:
            return cls(1.0, 2.0, signed)

        # Start above the values that contain almost no light
        light = np.cumsum(sums)
        first = int(np.searchsorted(light, dark * light[-1], side="right"))
        low = max(low, 2 ** (first / _PER_OCTAVE - _OCTAVES))
        least = min(max(low, high / 10**DECADES), high)
        codes = SIGN - 1 if signed else CODES
        return cls(least, max((high / least) ** (1 / (codes - 1)), 1 + 1e-6), signed)

    @property
    def tolerance(self) -> float:
        """Return the largest relative error of values above `least`."""
        return math.sqrt(self.ratio) - 1

    def codes(self, values: np.ndarray) -> np.ndarray:
        """Return the nearest codes. Values that are not finite have the code 0."""
        sizes = abs(values) if self.signed else values
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.log2(sizes * np.float32(1 / self.least), dtype=np.float32)
            steps *= np.float32(1 / math.log2(self.ratio))
            found = np.clip(np.rint(steps) + 1, 0, SIGN - 1 if self.signed else CODES)
        codes = np.where(np.isfinite(found) & np.isfinite(values), found, 0).astype(np.uint8)
        return codes + SIGN * (values < 0).astype(np.uint8) if self.signed else codes

    def values(self, codes: np.ndarray) -> np.ndarray:
        """Return the values of codes."""
        sizes = codes % SIGN if self.signed else codes
        found = np.where(sizes > 0, self.least * self.ratio ** (sizes.astype(np.float64) - 1), 0.0)
        return np.where(codes >= SIGN, -found, found) if self.signed else found
