"""Problem a4.dead_time: detections of a SPAD with a dead time."""

from __future__ import annotations

import numpy as np


def armed_detections(rates: np.ndarray, dead: int, paralysable: bool, periodic: bool) -> np.ndarray:
    """Probability that each bin of a cycle detects.

    Args:
        rates: Expected photons per bin and cycle, shape (pixel, bin).
        dead: Dead time in bins, from 0 to the number of bins - 1: after bin k, the next bin that
            can detect is k + dead + 1.
        paralysable: Whether photons within the dead time start the dead time again.
        periodic: False: the detector is armed when a cycle starts. True: the dead time extends into
            the next cycle, and the result applies after many cycles.

    Returns:
        Probabilities of the same shape.
    """
    raise NotImplementedError("a4.dead_time: armed_detections")


def sample_counts(
    rng: np.random.Generator, rates: np.ndarray, cycles: int, dead: int
) -> np.ndarray:
    """Simulate histograms of a SPAD that is armed when a cycle starts, non-paralyzable.

    Args:
        rng: Source of all random numbers: the same state gives the same counts.
        rates: As for `armed_detections`.
        cycles: Number of laser cycles, at least 0.
        dead: Dead time in bins, at least 0; from the number of bins on, only the first photon of a
            cycle is detected.

    Returns:
        Detections per bin, integers of shape (pixel, bin), independent between pixels and cycles.
    """
    raise NotImplementedError("a4.dead_time: sample_counts")
