"""Detections of a SPAD with a dead time, bin by bin: p_k = 1 - exp(-rate_k) if it is armed."""

import numpy as np


def armed_detections(rates: np.ndarray, dead: int, paralysable: bool, periodic: bool) -> np.ndarray:
    """Probability d_k that bin k detects, for rates (pixel, bin) and a dead time of `dead` bins.

    Non-paralysable, these detections exclude each other: d_k = p_k (1 - sum of d_j over the `dead`
    bins before k). Paralysable, photons start it: d_k = p_k exp(-sum of rates there). Cycles start
    armed unless periodic: stationary free running (Rapp et al., IEEE Trans. Signal Process. 67).
    """
    bins = rates.shape[-1]
    p = -np.expm1(-rates)
    back = np.arange(bins)[:, None] - np.arange(bins)  # From bin k to bin j
    back = back % bins if periodic else back
    covered = ((back >= 1) & (back <= dead)).astype(np.float64)
    if paralysable:
        return p * np.exp(-rates @ covered.T)
    if periodic:
        return np.array([np.linalg.solve(np.eye(bins) + q[:, None] * covered, q) for q in p])
    found, blocked = np.zeros_like(p), np.zeros(len(p))
    for k in range(bins):
        found[:, k] = p[:, k] * (1 - blocked)
        blocked += found[:, k] - (found[:, k - dead] if k >= dead else 0)
    return found


def sample_counts(
    rng: np.random.Generator, rates: np.ndarray, cycles: int, dead: int
) -> np.ndarray:
    """Draw the counts (pixel, bin) of cycles that start armed, with a non-paralysable dead time.

    Cycles are independent and alike: of those armed at bin k, all but the detections in the `dead`
    bins before, a binomial number detects.
    """
    p = np.ascontiguousarray(-np.expm1(-rates.T))
    found, armed = np.zeros(p.shape, np.int64), np.full(len(rates), cycles)
    for k in range(len(p)):
        found[k] = rng.binomial(armed, p[k])
        armed += (found[k - dead] if k >= dead else 0) - found[k]
    return found.T
