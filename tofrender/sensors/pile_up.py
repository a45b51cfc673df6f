"""First photons of laser cycles, and the correction of pile-up."""

from typing import Annotated, Any

import numpy as np

from ..labels import BINNED
from ..runtime import checks
from .photon_histograms import along_bins
from .photon_rates import at_least_0


def first_photon(rates: np.ndarray) -> np.ndarray:
    """Return the probability that the first photon of a cycle is in each bin.

    P_k = exp(-sum of rates before k) (1 - exp(-rate_k)), for rates (..., bin) per cycle. Source:
    Coates, "The correction for photon 'pile-up'", J. Phys. E 1 (1968).

    Example:
        >>> first_photon(np.array([0.05, 0.3, 1.2, 0.4, 0.1])).round(6).tolist()
        [0.048771, 0.246541, 0.49244, 0.069974, 0.013539]
    """
    return np.exp(rates - np.cumsum(rates, axis=-1)) * -np.expm1(-rates)


def coates(counts: Annotated[Any, BINNED], cycles: int) -> Any:
    """Estimate rates from a histogram of first photons, which is distorted by pile-up.

        rate_k = -ln(1 - N_k / (cycles - sum of N before k))

    Counts N (..., bin) of a number of cycles give photons per cycle (..., bin). The estimate is
    infinite if all remaining cycles detect, and NaN in later bins. It is the maximum likelihood
    estimate (Coates 1968). See also `coates_variance`.

    A DataArray with the axis bin or opl results in a DataArray with the same axes and coordinates,
    so that `estimate_depth` and `echoes` find its path lengths. An array results in an array.

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


def coates_variance(rates: Annotated[Any, BINNED], cycles: int) -> Any:
    """Return the variance of `coates`, which attains the Cramér-Rao bound.

        (exp(rate_k) - 1) / (cycles exp(-sum of rates before k))

    Rates (..., bin) are photons per cycle, at least 0. A DataArray results in a DataArray, as for
    `coates`.

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
