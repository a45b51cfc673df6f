"""Unwrapping: depth beyond the range of one modulation frequency, from several frequencies."""

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ..runtime import checks
from ..signals.labeled import frequencies_first, of_same_axes
from ..signals.units import SPEED_OF_LIGHT, check_frequencies

# Largest number of wraps of the highest frequency that `unwrap` searches
MAX_WRAPS = 4096


def unambiguous_range(frequency_hz: float | Sequence[float]) -> float:
    """Return the depth [m] after which phases repeat.

    It is c / 2f for one frequency, and c / 2g for several with the greatest common divisor g.

    Args:
        frequency_hz: Modulation frequency [Hz], above 0, or a sequence of frequencies that are used
            together. Their ratios are approximated by fractions with denominators up to a million.

    Raises:
        ValueError: A frequency is missing, not finite, or not above 0.

    Example:
        >>> round(unambiguous_range(50e6), 3), round(unambiguous_range([20e6, 50e6]), 3)
        (2.998, 14.99)
    """
    frequencies = sorted(check_frequencies(frequency_hz)[0])
    ratios = [Fraction(f / frequencies[0]).limit_denominator(10**6) for f in frequencies]
    denominator = math.lcm(*(r.denominator for r in ratios))
    divisor = math.gcd(*(int(r * denominator) for r in ratios))
    return SPEED_OF_LIGHT / 2 / frequencies[0] * denominator / max(divisor, 1)


def unwrap(
    phases: Any,
    frequencies_hz: Sequence[float],
    max_depth: float | None = None,
    *,
    amplitudes: Any = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the depth that fits the phases at two or more frequencies best.

    Phase j gives the depth d_j = (phase_j / 2 pi + n_j) c / (2 f_j) with an unknown integer n_j.
    The integers n_j and the depth d in [0, max_depth] minimize the weighted difference

        sum of w_j (d_j - d)^2,    w_j = (f_j A_j)^2 / sum of (f_i A_i)^2.

    If all I and Q have equal normal noise, this is the maximum likelihood estimate, because the
    variance of d_j is proportional to 1 / (f_j A_j)^2. The amplitudes A_j are 1 by default. For
    given n_j, the best d is the mean of the d_j, limited to the range. For example, noise may move
    the phases of a wall at depth 0 below 0. Then the depth is 0, and not the next depth with
    similar phases. All combinations of n_j that are nearest to any depth in the range are tried.
    See also `unambiguous_range`, `multipath_error`.

    Args:
        phases: Phases [rad], modulo 2 pi, of shape (frequencies, ...).
        frequencies_hz: Two or more modulation frequencies [Hz].
        max_depth: Largest possible depth [m]. It is at most `unambiguous_range(frequencies_hz)`,
            after which phases repeat, and at most 4096 ranges of the highest frequency. The first
            limit is the default. A smaller value tolerates more noise.
        amplitudes: Amplitudes as weights, at least 0, of the same shape as the phases.

    Returns:
        (depth, residual), float64 of shape (...). The depth is in [0, max_depth] [m], and is the
        smallest of several depths that fit equally. The residual is the weighted RMS difference of
        the d_j from the depth [m]. It is large if no depth in the range fits. Both are NaN if a
        phase is NaN, or if fewer than two frequencies have an amplitude.

    Raises:
        ValueError: There are fewer than two frequencies, the shapes do not match, an amplitude is
            negative, or `max_depth` is out of range.

    Example:
        >>> frequencies = (20e6, 50e6)  # ranges of 7.5 m and 3.0 m
        >>> phases = [4 * np.pi * f / 299792458 * 11.0 for f in frequencies]
        >>> depth, residual = unwrap(phases, frequencies)
        >>> round(depth.item(), 6), round(residual.item(), 6)
        (11.0, 0.0)
    """
    # Check phases and weights
    frequencies, many = check_frequencies(frequencies_hz, "frequencies_hz")
    if not many or len(frequencies) < 2:
        raise ValueError(
            f"frequencies_hz = {checks.quote(frequencies_hz)}: must hold two or more frequencies"
        )
    phases = frequencies_first("phases", phases, frequencies)
    phases, amplitudes = of_same_axes({"phases": phases, "amplitudes": amplitudes})
    phases = checks.real_array("phases", phases, np.float64)
    if phases.shape[:1] != (len(frequencies),):
        raise ValueError(
            f"phases with shape {phases.shape}: must have {len(frequencies)} frequencies first"
        )
    weights = np.ones(phases.shape)
    if amplitudes is not None:
        weights = checks.real_array("amplitudes", amplitudes, np.float64)
        valid = weights.shape == phases.shape and not (weights < 0).any()
        allowed = f"at least 0 and of shape {phases.shape}, as the phases"
        checks.shape("amplitudes", weights, valid, allowed)

    # Check the range
    column = (-1, *[1] * (phases.ndim - 1))
    ranges = (SPEED_OF_LIGHT / 2 / np.array(frequencies)).reshape(column)
    finest = float(ranges.min())
    longest = unambiguous_range(frequencies)
    max_depth = longest if max_depth is None else max_depth
    max_depth = checks.meters("max_depth", max_depth, positive=True)
    limit = min(longest, MAX_WRAPS * finest)
    if max_depth > limit * (1 + 1e-9):
        raise ValueError(
            f"max_depth = {max_depth:g}: must be at most {limit:g} m; phases repeat after "
            f"{longest:g} m, and {MAX_WRAPS} ranges of the highest frequency are searched"
        )

    # Depths without wraps, and weights that sum to 1
    phases = np.where(np.isfinite(phases), phases, np.nan)
    wrapped = np.mod(phases, 2 * math.pi) / (2 * math.pi) * ranges
    light = (weights > 0).sum(axis=0) >= 2
    weights = weights / np.where(light, weights.max(axis=0), 1) / ranges
    weights = np.where(light, weights**2, 1 / len(frequencies))
    weights /= weights.sum(axis=0)

    # Try all combinations of wraps, and keep the depth of the least cost. Costs are equal up to
    # rounding
    depth = np.full(phases.shape[1:], np.nan)
    least = np.full(phases.shape[1:], np.inf)
    margin = 1e-12 * finest**2
    for start in _candidates(wrapped, ranges, max_depth):
        unwrapped = wrapped + np.rint((start - wrapped) / ranges) * ranges
        guess = np.clip((weights * unwrapped).sum(axis=0), 0, max_depth)
        cost = (weights * (unwrapped - guess) ** 2).sum(axis=0)
        better = (cost < least - margin) | ((cost < least + margin) & (guess < depth))
        depth[better] = guess[better]
        least[better] = cost[better]
    found = light & np.isfinite(depth)
    return np.where(found, depth, np.nan), np.where(found, np.sqrt(least), np.nan)


def _candidates(wrapped: np.ndarray, ranges: np.ndarray, max_depth: float) -> Iterator[Any]:
    """Yield a depth [m] in each interval of [0, max_depth] with constant n_j.

    The nearest d_j to a depth d changes half a range beyond a d_j.
    """
    yield 0.0
    for one, reach in zip(wrapped, ranges.flat, strict=True):
        for n in range(-1, math.ceil(max_depth / reach) + 1):
            yield np.clip(one + (n + 0.5 + 1e-9) * reach, 0, max_depth)
