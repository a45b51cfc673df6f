"""Problem a4.pile_up: the first photon of each laser cycle, and Coates' correction."""

from __future__ import annotations

import numpy as np


def first_photon(rates: np.ndarray) -> np.ndarray:
    """Probability that the detection of a laser cycle is in each bin.

    The detector is armed when the cycle starts, and detects the first photon only.

    Args:
        rates: Expected photons per bin and cycle, at least 0, shape (..., bin).

    Returns:
        Probabilities of the same shape; rates down to 1e-12 keep six digits.
    """
    raise NotImplementedError("a4.pile_up: first_photon")


def coates(counts: np.ndarray, cycles: int) -> np.ndarray:
    """Estimate rates from a histogram of first photons by Coates' formula.

    Args:
        counts: Detections per bin, shape (..., bin), of any integer type, uint16 included.
        cycles: Number of laser cycles, at least the detections of each histogram, below 2^32.

    Returns:
        Photons per bin and cycle, of the same shape; infinite in the bin where the last of all
        cycles detects. After this bin any value is allowed.
    """
    raise NotImplementedError("a4.pile_up: coates")


def coates_variance(rates: np.ndarray, cycles: int) -> np.ndarray:
    """Variance of `coates` for many cycles.

    Args:
        rates: True rates, shape (..., bin).
        cycles: Number of laser cycles.

    Returns:
        Variances of the same shape.
    """
    raise NotImplementedError("a4.pile_up: coates_variance")
