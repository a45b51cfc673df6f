"""First photons of laser cycles, pile-up and its correction."""

from typing import Any

import numpy as np

from ..runtime import checks
from .rates import at_least_0


def first_photon(rates: np.ndarray) -> np.ndarray:
    """Probability P_k = exp(-sum of rates before k) (1 - exp(-rate_k)) of a cycle's first photon.

    Coates, "The correction for photon 'pile-up'", J. Phys. E 1 (1968), for rates (..., bin).

    Example:
        >>> first_photon(np.array([0.05, 0.3, 1.2, 0.4, 0.1])).round(6).tolist()
        [0.048771, 0.246541, 0.49244, 0.069974, 0.013539]
    """
    return np.exp(rates - np.cumsum(rates, axis=-1)) * -np.expm1(-rates)


def coates(counts: Any, cycles: int) -> np.ndarray:
    """Estimate rates from a histogram of first photons, which pile-up distorts.

        rate_k = -ln(1 - N_k / (cycles - sum of N before k))

    for counts N (..., bin) of so many cycles, in photons per cycle (..., bin): infinite where all
    that are left detect, NaN after that. The likeliest (Coates 1968), see `coates_variance`.

    Example:
        >>> coates([393469, 238651], 1_000_000).round(4).tolist()
        [0.5, 0.5]
    """
    counts = at_least_0("counts", counts)
    checks.shape("counts", counts, counts.ndim and counts.size, "(..., bin)")
    cycles, most = checks.integer("cycles", cycles, 1, checks.MAX_SEED), counts.sum(axis=-1).max()
    checks.require("cycles", cycles, most <= cycles, f"at least the counts of a pixel, {most:g}")
    with np.errstate(divide="ignore", invalid="ignore"):
        return -np.log1p(-counts / (cycles - (np.cumsum(counts, axis=-1) - counts)))


def coates_variance(rates: Any, cycles: int) -> np.ndarray:
    """Variance of `coates`, which attains the bound, for rates (..., bin) per cycle, at least 0.

        (exp(rate_k) - 1) / (cycles exp(-sum of rates before k))

    Example:
        >>> coates_variance([0.5, 0.5], 1000).round(6).tolist()
        [0.000649, 0.00107]
    """
    rates = at_least_0("rates", rates)
    checks.shape("rates", rates, rates.ndim, "(..., bin)")
    cycles = checks.integer("cycles", cycles, 1, checks.MAX_SEED)
    return np.expm1(rates) * np.exp(np.cumsum(rates, axis=-1) - rates) / cycles
