"""Quantisation of values to codes of one byte on a logarithmic scale.

Code 0 is darkness; code q from 1 to 255 stands for least * ratio^(q - 1).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

CODES = 255
"""Number of codes, without that of darkness."""

DARK = 1e-4
"""Fraction of all light that may lie in values too small to have a code."""

DECADES = 7
"""Largest range of values that have a code."""

_PER_OCTAVE = 16  # Bins of the histogram of values


@dataclass(frozen=True)
class Scale:
    """Logarithmic scale of codes: the value of code 1, and the ratio of successive values.

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
        """Scale for the finite values above 0 of all pieces."""
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
        dark = DARK * sum(sums.values())
        for octave in sorted(sums):
            dark -= sums[octave]
            if dark < 0:
                low = max(low, 2 ** (octave / _PER_OCTAVE))
                break
        least = min(max(low, high / 10**DECADES), high)
        return cls(least, max((high / least) ** (1 / (CODES - 1)), 1 + 1e-6))

    @property
    def tolerance(self) -> float:
        """Largest relative error from `least` on; smaller values are off by less than `least`."""
        return math.sqrt(self.ratio) - 1

    def codes(self, values: np.ndarray) -> np.ndarray:
        """The nearest codes; 0 for values that are not finite."""
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.log2(values * np.float32(1 / self.least), dtype=np.float32)
            steps *= np.float32(1 / math.log2(self.ratio))
            found = np.clip(np.rint(steps) + 1, 0, CODES)
        return np.where(np.isfinite(found) & np.isfinite(values), found, 0).astype(np.uint8)

    def values(self, codes: np.ndarray) -> np.ndarray:
        """Values of codes."""
        return np.where(codes > 0, self.least * self.ratio ** (codes.astype(np.float64) - 1), 0.0)
