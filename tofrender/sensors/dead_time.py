"""Detections of a SPAD with dead time. An armed bin detects with p_k = 1 - exp(-rate_k)."""

import numpy as np


def armed_detections(rates: np.ndarray, dead: int, paralysable: bool, periodic: bool) -> np.ndarray:
    """Return the probability d_k that bin k detects.

    With a non-paralysable dead time, detections within the dead time exclude each other:
    d_k = p_k (1 - sum of d_j over the `dead` bins before k). With a paralysable dead time, each
    photon starts it: d_k = p_k exp(-sum of rates in these bins). Cycles start armed unless they are
    periodic. Periodic cycles are the stationary state of a free-running SPAD (Rapp et al., IEEE
    Trans. Signal Process. 67).

    Args:
        rates: Expected photons (pixel, bin).
        dead: Dead time [bins].
        paralysable: Whether photons within the dead time prolong it.
        periodic: Whether the dead time continues in the next cycle.
    """
    bins = rates.shape[-1]
    p = -np.expm1(-rates)

    # Which bins j are within the dead time before bin k?
    back = np.arange(bins)[:, None] - np.arange(bins)
    back = back % bins if periodic else back
    covered = ((back >= 1) & (back <= dead)).astype(np.float64)

    # Paralysable: no photon in these bins
    if paralysable:
        return p * np.exp(-rates @ covered.T)

    # Periodic: solve for all bins together
    if periodic:
        return np.array([np.linalg.solve(np.eye(bins) + q[:, None] * covered, q) for q in p])

    # Otherwise: the bins one after the other
    found = np.zeros_like(p)
    blocked = np.zeros(len(p))
    for k in range(bins):
        found[:, k] = p[:, k] * (1 - blocked)
        blocked += found[:, k] - (found[:, k - dead] if k >= dead else 0)
    return found


def sample_counts(
    rng: np.random.Generator, rates: np.ndarray, cycles: int, dead: int
) -> np.ndarray:
    """Sample counts (pixel, bin) of cycles that start armed, with a non-paralysable dead time.

    Cycles are independent and identically distributed. At bin k, all cycles are armed unless they
    detected in the `dead` bins before. A binomial number of the armed cycles detects.
    """
    p = np.ascontiguousarray(-np.expm1(-rates.T))
    found = np.zeros(p.shape, np.int64)
    armed = np.full(len(rates), cycles)
    for k in range(len(p)):
        found[k] = rng.binomial(armed, p[k])
        armed += (found[k - dead] if k >= dead else 0) - found[k]
    return found.T
