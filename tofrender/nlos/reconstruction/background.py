"""Bins of photon counts with light of the hidden scene, and the dark counts in all bins.

A measured histogram starts with the reflection by the wall itself, which decays over hundreds of
bins; then come dark and ambient counts alone, until light of the hidden scene arrives.
"""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

PARTS, SIGMAS, SHARE = 64, 5.0, 0.02
"""Histograms are smoothed over a 64th; light is above 5 sigma and this share of the largest."""


class Background(NamedTuple):
    """Counts that are not of the hidden scene."""

    dark: float  # dark and ambient counts per bin and pixel
    kept: np.ndarray  # float32 (bins,), 1 where the hidden scene's light stands out, else 0
    variance: np.ndarray  # of the kept bins, summed over pixels: their counts


def find_background(counts: np.ndarray, pixels: int, zero: int) -> Background:
    """Find the background of histograms by their sum over pixels, (bins,).

    `zero` is the bin of path length 0, where the wall's own reflection is the largest: if there is
    one, the smoothed histogram peaks within a 64th of all bins around. It ends in the bin after
    which that rises by the largest factor.

    Warns:
        UserWarning: No bin stands out of the dark counts; all bins after the reflection are kept.
    """
    window = max(1, len(counts) // PARTS)
    one = 1 / (pixels * window)
    mean = uniform_filter1d(counts / pixels, window)
    first = 0
    peak = int(mean.argmax())
    if zero >= 0 and abs(peak - zero) <= window:
        later = np.maximum.accumulate(mean[::-1])[::-1]
        first = peak + int(np.argmax((later / np.maximum(mean, one))[peak:]))
    dark = float(np.quantile(mean[first:], 0.05))
    least = max(SIGMAS * np.sqrt(max(dark, one) * one), SHARE * (mean[first:].max() - dark))
    kept = (mean - dark > least) & (np.arange(len(mean)) >= first)
    if not counts[first:].any():
        raise ValueError("capture: no bin after the wall's reflection holds counts; measure longer")

    # Without bins that stand out, weak light may still be found from many pixels together
    if not kept.any():
        kept = np.arange(len(mean)) >= first
        warnings.warn(
            f"capture: no bin stands out of the {dark:.3g} dark counts per bin and pixel, so that "
            "all bins are used and the result is noisy; measure longer",
            stacklevel=4,
        )
    return Background(dark, kept.astype(np.float32), counts * kept)
