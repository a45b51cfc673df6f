"""First photons of laser cycles, pile-up and its correction."""

from typing import Any

import numpy as np

from ..runtime import checks
from .histograms import along_bins
from .rates import at_least_0


def first_photon(rates: np.ndarray) -> np.ndarray:
    """Probability P_k = exp(-sum of rates before k) (1 - exp(-rate_k)) of a cycle's first photon.

    Coates, "The correction for photon 'pile-up'", J. Phys. E 1 (1968), for rates (..., bin).

    Example:
        >>> first_photon(np.array([0.05, 0.3, 1.2, 0.4, 0.1])).round(6).tolist()
        [0.048771, 0.246541, 0.49244, 0.069974, 0.013539]
    """
    return np.exp(rates - np.cumsum(rates, axis=-1)) * -np.expm1(-rates)


def coates(counts: Any, cycles: int) -> Any:
    """Estimate rates from a histogram of first photons, which pile-up distorts.

        rate_k = -ln(1 - N_k / (cycles - sum of N before k))

    for counts N (..., bin) of so many cycles, in photons per cycle (..., bin): infinite where all
    that are left detect, NaN after that. The likeliest (Coates 1968), see `coates_variance`.

    A DataArray with the axis bin or opl gives a DataArray with the same axes and coordinates, so
    that `estimate_depth` and `echoes` find its path lengths. An array gives an array.

    Example:
        >>> coates([393469, 238651], 1_000_000).round(4).tolist()
        [0.5, 0.5]
    """
    cycles = checks.integer("cycles", cycles, 1, checks.MAX_SEED)

    def corrected(values: Any) -> np.ndarray:
        counts = at_least_0("counts", values)
        checks.shape("counts", counts, counts.ndim and counts.size, "(..., bin)")
        most = counts.sum(axis=-1).max()
        allowed = f"at least the counts of a pixel, {most:g}"
        checks.require("cycles", cycles, most <= cycles, allowed)
        with np.errstate(divide="ignore", invalid="ignore"):
            return -np.log1p(-counts / (cycles - (np.cumsum(counts, axis=-1) - counts)))

    return along_bins("counts", corrected, counts)


def coates_variance(rates: Any, cycles: int) -> Any:
    """Variance of `coates`, which attains the bound, for rates (..., bin) per cycle, at least 0.

        (exp(rate_k) - 1) / (cycles exp(-sum of rates before k))

    A DataArray gives a DataArray, as for `coates`.

    Example:
        >>> coates_variance([0.5, 0.5], 1000).round(6).tolist()
        [0.000649, 0.00107]
    """
    cycles = checks.integer("cycles", cycles, 1, checks.MAX_SEED)

    def variance(values: Any) -> np.ndarray:
        mean = at_least_0("rates", values)
        checks.shape("rates", mean, mean.ndim, "(..., bin)")
        return np.expm1(mean) * np.exp(np.cumsum(mean, axis=-1) - mean) / cycles

    return along_bins("rates", variance, rates)
