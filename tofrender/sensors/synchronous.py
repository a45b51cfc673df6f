"""Detection probabilities and counts of a SPAD bin by bin, p_k = 1 - exp(-rate_k) if armed."""

import numpy as np


def first_photon(rates: np.ndarray) -> np.ndarray:
    """Probability P_k = exp(-sum of rates before k) (1 - exp(-rate_k)) of a cycle's first photon.

    Coates, "The correction for photon 'pile-up'", J. Phys. E 1 (1968), for rates (..., bin).

    Example:
        >>> first_photon(np.array([0.05, 0.3, 1.2, 0.4, 0.1])).round(6).tolist()
        [0.048771, 0.246541, 0.49244, 0.069974, 0.013539]
    """
    return np.exp(rates - np.cumsum(rates, axis=-1)) * -np.expm1(-rates)


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
