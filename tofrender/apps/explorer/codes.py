"""Values as codes of one byte on a logarithmic scale, right to a tolerance that is known.

Code 0 is nothing; q from 1 to 255 stands for least * ratio^(q - 1).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

CODES = 255
"""Codes that stand for something."""

DARK = 1e-4
"""Part of all light that may lie in values too small to have a code."""

DECADES = 7
"""Between the largest value and the least one that has a code, at the most."""

_PER_OCTAVE = 16  # Bins of the histogram of values


@dataclass(frozen=True)
class Scale:
    """What codes stand for.

    Attributes:
        least: Value of code 1.
        ratio: Of a code's value to that of the one before.

    Example:
        >>> scale = Scale.of([np.array([1.0, 10.0, 1000.0])])
        >>> values = scale.values(scale.codes(np.array([0.0, 1.0, 50.0, 1000.0])))
        >>> bool(abs(values[2] / 50 - 1) <= scale.tolerance), round(scale.tolerance, 4)
        (True, 0.0137)
    """

    least: float
    ratio: float

    @classmethod
    def of(cls, pieces: Iterable[np.ndarray]) -> Scale:
        """The scale for values, which come in pieces; NaN, infinities and values <= 0 have none."""
        sums: dict[int, float] = {}
        low, high = math.inf, 0.0
        for values in pieces:
            lit = values[(values > 0) & np.isfinite(values)]
            if not lit.size:
                continue
            low, high = min(low, float(lit.min())), max(high, float(lit.max()))
            octaves = np.floor(np.log2(lit) * _PER_OCTAVE).astype(np.int32)
            first = int(octaves.min())
            for k, light in enumerate(np.bincount(octaves.ravel() - first, lit.ravel())):
                sums[first + k] = sums.get(first + k, 0.0) + float(light)
        if not high:
            return cls(1.0, 2.0)
        left = DARK * sum(sums.values())
        for octave in sorted(sums):
            left -= sums[octave]
            if left < 0:
                low = max(low, 2 ** (octave / _PER_OCTAVE))
                break
        least = min(max(low, high / 10**DECADES), high)
        return cls(least, max((high / least) ** (1 / (CODES - 1)), 1 + 1e-6))

    @property
    def tolerance(self) -> float:
        """Largest relative error from `least` on; smaller values are off by less than `least`."""
        return math.sqrt(self.ratio) - 1

    def codes(self, values: np.ndarray) -> np.ndarray:
        """The nearest codes; 0 of what is not finite."""
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.log2(values * np.float32(1 / self.least), dtype=np.float32)
            steps *= np.float32(1 / math.log2(self.ratio))
            found = np.clip(np.rint(steps) + 1, 0, CODES)
        return np.where(np.isfinite(found) & np.isfinite(values), found, 0).astype(np.uint8)

    def values(self, codes: np.ndarray) -> np.ndarray:
        """What codes stand for."""
        return np.where(codes > 0, self.least * self.ratio ** (codes.astype(np.float64) - 1), 0.0)
