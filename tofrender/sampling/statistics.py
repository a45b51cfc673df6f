"""Tests of estimates with noise that can fail.

A Monte Carlo render agrees with another, or with an exact value, when the means over independent
seeds do, bin by bin: Welch's t-test for two renders, Student's for a render and a number. The
bound on each bin follows from the chance `alpha` that a whole comparison of right code fails
(Šidák). Values that are not finite fail.

    values = np.stack([render(seed) for seed in range(32)])       # (seeds, bins)
    p = p_values(values, reference)                               # (bins,)
    assert smallest_allowed(alpha, p.size) <= p.min()

Sum over pixels first: a pixel's bin is too noisy to find anything in.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

ROUNDING = 1e-5
"""Relative difference of two means that single precision explains."""


def p_values(
    samples: np.ndarray, reference: np.ndarray | float, *, rounding: float = ROUNDING
) -> np.ndarray:
    """Chance of a difference at least as large as the one seen, were both means equal.

    Args:
        samples: Estimates of shape (n, ...), one for each of n >= 2 independent seeds.
        reference: Estimates of shape (m, ...), m >= 2, or exact values of shape (...).
        rounding: Relative difference of the means that counts as none.

    Returns:
        Two-sided p-values of shape (...); 0 where a value is not finite.

    Raises:
        ValueError: There are fewer than two seeds, or the shapes do not fit.

    Example:
        >>> noise = np.random.default_rng(1).normal(size=(64, 3))
        >>> bool(p_values(1 + 0.1 * noise, np.ones(3)).min() > 0.01)
        True
        >>> bool(p_values(1 + 0.1 * noise, 1.1 * np.ones(3)).max() < 1e-4)
        True
    """
    samples, reference = (np.asarray(a, dtype=np.float64) for a in (samples, reference))
    if samples.ndim == 0 or samples.shape[0] < 2:
        raise ValueError(f"samples: shape {samples.shape}; must hold at least two seeds")
    mean, error, spread = _mean(samples)
    n = samples.shape[0]
    if reference.shape == samples.shape[1:]:
        other, variance, freedom = reference, error, np.full(mean.shape, n - 1.0)
    elif reference.ndim == samples.ndim and reference.shape[1:] == samples.shape[1:]:
        m = reference.shape[0]
        if m < 2:
            raise ValueError(f"reference: shape {reference.shape}; must hold at least two seeds")
        other, other_error, other_spread = _mean(reference)
        variance, spread = error + other_error, spread & other_spread
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = variance**2 / (error**2 / (n - 1) + other_error**2 / (m - 1))
    else:
        raise ValueError(
            f"reference: shape {reference.shape}; must be {samples.shape[1:]} (exact values) or "
            f"(m, *{samples.shape[1:]})"
        )
    finite = spread & np.isfinite(other)
    other = np.where(finite, other, 0.0)
    difference = np.abs(mean - other)
    difference = np.maximum(difference - rounding * np.maximum(np.abs(mean), np.abs(other)), 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = student_tail(difference / np.sqrt(variance), freedom)
    p = np.where(variance > 0, p, np.where(difference > 0, 0.0, 1.0))
    return np.where(finite, p, 0.0)


def _mean(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean over the seeds, its variance, and where all seeds are finite."""
    finite: Any = np.isfinite(samples).all(axis=0)
    samples = np.where(finite, samples, 0.0)
    return samples.mean(axis=0), samples.var(axis=0, ddof=1) / samples.shape[0], finite


def smallest_allowed(alpha: float, tests: int) -> float:
    """Bound on each of `tests` independent p-values, so that right code fails with chance `alpha`.

    Šidák: 1 - (1 - alpha)^(1 / tests).

    Example:
        >>> round(smallest_allowed(0.01, 10), 6)
        0.001005
    """
    return -math.expm1(math.log1p(-alpha) / tests)


def student_tail(t: np.ndarray | float, freedom: np.ndarray | float) -> np.ndarray:
    """Chance that |T| >= |t| for Student's distribution: I_x(ν/2, 1/2) with x = ν / (ν + t²).

    The degrees of freedom ν are above 0, of a shape that broadcasts with `t`.

    Example:
        >>> float(student_tail(12.7062, 1).round(4))
        0.05
    """
    t, freedom = np.broadcast_arrays(np.asarray(t, np.float64), np.asarray(freedom, np.float64))
    square = t * t
    return _incomplete_beta(
        0.5 * freedom, 0.5, freedom / (freedom + square), square / (freedom + square)
    )


def _incomplete_beta(a: np.ndarray, b: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Regularised incomplete beta function I_x(a, b), where y = 1 - x.

    The continued fraction converges fast for x < (a + 1) / (a + b + 2); elsewhere
    I_x(a, b) = 1 - I_y(b, a).
    """
    swap = x > (a + 1) / (a + b + 2)
    p, q = np.where(swap, b, a), np.where(swap, a, b)
    u, v = np.where(swap, y, x), np.where(swap, x, y)
    log_gamma = np.vectorize(math.lgamma, otypes=[np.float64])
    with np.errstate(divide="ignore", invalid="ignore"):
        front = np.exp(
            log_gamma(p + q) - log_gamma(p) - log_gamma(q) + p * np.log(u) + q * np.log(v)
        )
    # Lentz's method for the fraction 1/(1 + d1/(1 + d2/(1 + ...)))
    tiny = 1e-300
    c, d = np.ones_like(u), 1 / np.where((first := 1 - (p + q) * u / (p + 1)) == 0, tiny, first)
    value = d.copy()
    for m in range(1, 200):
        for step in (
            m * (q - m) * u / ((p + 2 * m - 1) * (p + 2 * m)),
            -(p + m) * (p + q + m) * u / ((p + 2 * m) * (p + 2 * m + 1)),
        ):
            d = 1 / np.where((denominator := 1 + step * d) == 0, tiny, denominator)
            c = np.where((numerator := 1 + step / c) == 0, tiny, numerator)
            value *= d * c
    value = front * value / p
    return np.where(swap, 1 - value, value)
