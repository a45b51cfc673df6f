"""Hypothesis tests of Monte Carlo estimates.

Two renders agree, or a render agrees with an exact value, if the means over independent seeds agree
in each bin. Two renders are compared by Welch's t-test, a render and a number by Student's t-test.
`alpha` is the probability that a whole comparison of correct code fails. It determines the bound on
each bin (Šidák). Values that are not finite fail.

    values = np.stack([render(seed) for seed in range(32)])       # (seeds, bins)
    p = p_values(values, reference)                               # (bins,)
    assert smallest_allowed(alpha, p.size) <= p.min()

Sum over pixels first, because a single pixel's bin is too noisy to reveal errors.
"""

import math
from typing import Any

import numpy as np
from scipy.special import stdtr

# Relative difference of two means that single precision explains
ROUNDING = 1e-5


def p_values(
    samples: np.ndarray, reference: np.ndarray | float, *, rounding: float = ROUNDING
) -> np.ndarray:
    """Return two-sided p-values of the difference of two means, or of a mean and an exact value.

    Args:
        samples: Estimates of shape (n, ...), one for each of n >= 2 independent seeds.
        reference: Estimates of shape (m, ...), m >= 2, or exact values of shape (...).
        rounding: Relative difference of the means that is ignored.

    Returns:
        Array of shape (...); 0 where a value is not finite.

    Raises:
        ValueError: There are fewer than two seeds, or the shapes do not match.

    Example:
        >>> noise = np.random.default_rng(1).normal(size=(64, 3))
        >>> bool(p_values(1 + 0.1 * noise, np.ones(3)).min() > 0.01)
        True
        >>> bool(p_values(1 + 0.1 * noise, 1.1 * np.ones(3)).max() < 1e-4)
        True
    """
    # Mean of the samples
    samples, reference = (np.asarray(a, dtype=np.float64) for a in (samples, reference))
    if samples.ndim == 0 or samples.shape[0] < 2:
        raise ValueError(f"samples: shape {samples.shape}; must hold at least two seeds")
    mean, error, finite = _mean(samples)
    n = samples.shape[0]
    bins = samples.shape[1:]

    # Exact values, or the mean of other estimates
    if reference.shape == bins:
        other = reference
        variance = error
        freedom = n - 1.0
    elif reference.ndim == samples.ndim and reference.shape[1:] == bins:
        m = reference.shape[0]
        if m < 2:
            raise ValueError(f"reference: shape {reference.shape}; must hold at least two seeds")
        other, other_error, other_finite = _mean(reference)
        variance = error + other_error
        finite = finite & other_finite
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = variance**2 / (error**2 / (n - 1) + other_error**2 / (m - 1))
    else:
        allowed = f"must be {bins} (exact values) or (m, *{bins})"
        raise ValueError(f"reference: shape {reference.shape}; {allowed}")

    # Compare both means by the t-distribution
    finite = finite & np.isfinite(other)
    other = np.where(finite, other, 0.0)
    difference = np.abs(mean - other)
    difference = np.maximum(difference - rounding * np.maximum(np.abs(mean), np.abs(other)), 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = 2 * stdtr(freedom, -difference / np.sqrt(variance))
    p = np.where(variance > 0, p, np.where(difference > 0, 0.0, 1.0))
    return np.where(finite, p, 0.0)


def _mean(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean, variance of the mean, and a mask of the bins in which all seeds are finite."""
    finite: Any = np.isfinite(samples).all(axis=0)
    samples = np.where(finite, samples, 0.0)
    return samples.mean(axis=0), samples.var(axis=0, ddof=1) / samples.shape[0], finite


def smallest_allowed(alpha: float, tests: int) -> float:
    """Return Šidák's bound on each of `tests` independent p-values, 1 - (1 - alpha)^(1 / tests).

    With this bound, correct code fails in any of the tests with the probability `alpha`.

    Example:
        >>> round(smallest_allowed(0.01, 10), 6)
        0.001005
    """
    return -math.expm1(math.log1p(-alpha) / tests)
