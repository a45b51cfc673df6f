"""Background of photon counts: dark counts, and the bins without light of the hidden scene.

A measured histogram starts with the reflection by the wall, which decays over hundreds of bins.
Then the bins contain dark and ambient counts only, until light of the hidden scene arrives.
"""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

PARTS = 64
"""Histograms are smoothed over this fraction of all bins."""

SIGMAS = 5.0
"""Light exceeds the dark counts by this number of standard deviations."""

SHARE = 0.02
"""Light exceeds the dark counts by this share of the largest value."""


class Background(NamedTuple):
    """Counts without light of the hidden scene."""

    # Dark and ambient counts per bin and pixel
    dark: float

    # float32 (bins,): 1 where light of the hidden scene exceeds the dark counts, otherwise 0
    kept: np.ndarray

    # Variance of the kept bins, summed over pixels. It equals their counts
    variance: np.ndarray


def find_background(counts: np.ndarray, pixels: int, zero: int) -> Background:
    """Find the background of histograms.

    The reflection by the wall exists if the smoothed histogram has its maximum near path length 0,
    within a 64th of all bins. The reflection ends at the bin after which the smoothed histogram
    rises by the largest factor.

    Args:
        counts: Histogram, summed over all pixels, (bins,).
        pixels: Number of pixels.
        zero: Bin of path length 0.

    Raises:
        ValueError: All bins after the reflection are empty.

    Warns:
        UserWarning: No bin exceeds the dark counts. All bins after the reflection are kept.
    """
    # Smooth the histogram
    window = max(1, len(counts) // PARTS)
    one = 1 / (pixels * window)
    mean = uniform_filter1d(counts / pixels, window)

    # Find the end of the wall's reflection
    first = 0
    peak = int(mean.argmax())
    if zero >= 0 and abs(peak - zero) <= window:
        later = np.maximum.accumulate(mean[::-1])[::-1]
        first = peak + int(np.argmax((later / np.maximum(mean, one))[peak:]))

    # Find the bins that exceed the dark counts
    dark = float(np.quantile(mean[first:], 0.05))
    least = max(SIGMAS * np.sqrt(max(dark, one) * one), SHARE * (mean[first:].max() - dark))
    kept = (mean - dark > least) & (np.arange(len(mean)) >= first)
    if not counts[first:].any():
        raise ValueError(
            "capture: all bins after the wall's reflection are empty. Measure more cycles"
        )

    # If no bin exceeds them, weak light may still be visible in many pixels together
    if not kept.any():
        kept = np.arange(len(mean)) >= first
        warnings.warn(
            f"capture: no bin exceeds the {dark:.3g} dark counts per bin and pixel. All bins are "
            "used, so that the result is noisy. Measure more cycles",
            stacklevel=4,
        )
    return Background(dark, kept.astype(np.float32), counts * kept)
