"""Jitter by quadrature of the density, matrices and a choice of lags."""

from __future__ import annotations

import numpy as np


def kernel(delays, width: float, tail: float = 1e-6) -> np.ndarray:
    """Integrals of the density over bins that are split until they are narrow."""
    reach = int(np.ceil(np.abs(delays.ppf([tail / 2, 1 - tail / 2])).max() / width + 0.5))
    nodes, weights = np.polynomial.legendre.leggauss(24)
    parts = max(1, int(np.ceil(width / delays.std())))
    centers = (np.arange((2 * reach + 1) * parts) + 0.5) / parts - reach - 0.5
    at = (centers[:, None] + nodes / (2 * parts)) * width
    masses = (delays.pdf(at) @ weights * width / (2 * parts)).reshape(-1, parts).sum(axis=1)
    return masses / masses.sum()


def add_jitter(detections: np.ndarray, masses: np.ndarray, periodic: bool) -> np.ndarray:
    """A matrix that moves the detections of each bin."""
    detections = np.asarray(detections, float)
    masses = np.asarray(masses, float)
    bins = detections.shape[-1]
    reach = masses.size // 2
    moves = np.zeros((bins, bins))
    for start in range(bins):
        for lag in range(-reach, reach + 1):
            if periodic or 0 <= start + lag < bins:
                moves[start, (start + lag) % bins] += masses[lag + reach]
    return detections @ moves


def sample_jitter(rng: np.random.Generator, masses: np.ndarray, size: int) -> np.ndarray:
    """Lags by their probabilities."""
    reach = masses.size // 2
    return rng.choice(np.arange(-reach, reach + 1), size, p=masses)
