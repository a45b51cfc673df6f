"""Jitter of time stamps in bins: after detection, each moves by some bins."""

from typing import Any

import numpy as np
from scipy.ndimage import convolve1d


def kernel(delays: Any, width: float, tail: float = 1e-6) -> np.ndarray:
    """Probabilities that stamps move by k = -n to n bins of a width [m] from a bin's centre.

    For `delays`, a `distribution`, they are cdf((k + 1/2) width) - cdf((k - 1/2) width), without a
    `tail` at each end; sum 1.

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

    Stamps before or after the window are lost, unless periodic: then the window is a cycle.
    """
    return convolve1d(detections, masses, mode="wrap" if periodic else "constant")


def sample_jitter(rng: np.random.Generator, masses: np.ndarray, size: int) -> np.ndarray:
    """Draw by how many bins `size` stamps move, from the `masses` of a `kernel`."""
    moved = np.searchsorted(np.cumsum(masses), rng.random(size), side="right")
    return np.minimum(moved, masses.size - 1) - masses.size // 2
