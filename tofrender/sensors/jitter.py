"""Jitter of time stamps in bins. After detection, each time stamp is shifted by some bins."""

from typing import Any

import numpy as np
from scipy.ndimage import convolve1d


def kernel(delays: Any, width: float, tail: float = 1e-6) -> np.ndarray:
    """Return the probabilities that stamps are shifted by k = -n to n bins from a bin's center.

    They are cdf((k + 1/2) width) - cdf((k - 1/2) width), normalized to the sum 1.

    Args:
        delays: Distribution of the delay, as from `distribution`.
        width: Width of the bins [m].
        tail: Probability that is omitted at each end.

    Example:
        >>> from scipy import stats
        >>> kernel(stats.norm(0, 0.015), 0.03).round(4).tolist()
        [0.0013, 0.1573, 0.6827, 0.1573, 0.0013]
    """
    ends = delays.ppf([tail, 1 - tail])
    reach = max(1, int(np.rint(np.abs(ends).max() / width)))
    masses = np.diff(delays.cdf((np.arange(-reach, reach + 2) - 0.5) * width))
    return masses / masses.sum()


def add_jitter(detections: np.ndarray, masses: np.ndarray, periodic: bool) -> np.ndarray:
    """Convolve detections (..., bin) with the `masses` of a `kernel`.

    Stamps before or after the window are lost. If periodic, the window is a cycle instead.
    """
    return convolve1d(detections, masses, mode="wrap" if periodic else "constant")


def sample_jitter(rng: np.random.Generator, masses: np.ndarray, size: int) -> np.ndarray:
    """Sample the shifts [bins] of `size` stamps, from the `masses` of a `kernel`."""
    moved = np.searchsorted(np.cumsum(masses), rng.random(size), side="right")
    return np.minimum(moved, masses.size - 1) - masses.size // 2
