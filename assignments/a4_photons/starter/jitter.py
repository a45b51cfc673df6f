"""Problem a4.jitter: time stamps that are a little late or early."""

from __future__ import annotations

from typing import Any

import numpy as np


def kernel(delays: Any, width: float, tail: float = 1e-6) -> np.ndarray:
    """Probabilities that a stamp moves by -n to n bins, for light in the center of its bin.

    Args:
        delays: Distribution of the delay [m of path], with SciPy's methods `cdf`, `pdf` and `ppf`.
        width: Width of a bin [m].
        tail: Probability that may be left out at each end.

    Returns:
        2 n + 1 probabilities with the sum 1; element n + k is for a stamp that is k bins late.
        Choose n, at least 1 and so large that no more than `tail` is left out at each end.
    """
    raise NotImplementedError("a4.jitter: kernel")


def add_jitter(detections: np.ndarray, masses: np.ndarray, periodic: bool) -> np.ndarray:
    """Expected stamps per bin, from expected detections.

    Args:
        detections: Detections per bin, shape (..., bin).
        masses: Probabilities as `kernel` returns them, no longer than the histogram.
        periodic: False: stamps outside the window are lost. True: the window is a whole cycle, and
            these stamps appear at the other end of the window, in the previous or next cycle.

    Returns:
        Stamps per bin, of the same shape.
    """
    raise NotImplementedError("a4.jitter: add_jitter")


def sample_jitter(rng: np.random.Generator, masses: np.ndarray, size: int) -> np.ndarray:
    """Draw the delays of stamps, in bins.

    Args:
        rng: Source of all random numbers: the same state gives the same result.
        masses: Probabilities as `kernel` returns them.
        size: Number of stamps, at least 0.

    Returns:
        Integers from -n to n, shape (size,), independent of each other.
    """
    raise NotImplementedError("a4.jitter: sample_jitter")
