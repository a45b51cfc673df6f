"""Thresholds of echo detection with a given probability of a false alarm.

Counts n are filtered with the log-likelihood ratio of an echo of S counts in a background b per bin,

    T_i = sum over lags k of n_(i + k) w_k,    w_k = log(1 + S P_k / b),

for the parts P_k of the response in bins. A pixel has an echo if the largest T_i exceeds a
threshold. The probability that background alone does so is found by simulation of pixels with one
echo at a random place, each weighted with its likelihood ratio (Naiman and Priebe, "Computing scan
statistic p values using importance sampling", J. Comput. Graph. Stat. 10, 2001):

    P(max T >= t) = E[1{max T >= t} / mean over i of L_i],    L_i = exp(T_i - S)

All pixels of the simulation have echoes, so that small probabilities need few of them.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.optimize import brentq

from .rates import generator

RATIO = 1.1  # Of neighboring backgrounds for which thresholds are computed
EXACT = 10  # Counts per pixel up to which each number has its own threshold
EFFORT = 2e7  # Products of counts and weights in a simulation
ROUNDING = 1e-7  # Part of a threshold within which values are equal to it
LEAST = 1e-9  # Background counts per pixel that count as none


@dataclass(frozen=True)
class Threshold:
    """Filter and threshold for a background.

    Attributes:
        weights: Weights w of the counts at each lag.
        value: Threshold of the filtered counts.
        chance: Probability with which a pixel that is just at the threshold has an echo.
        background: Counts per bin for which this threshold holds.
    """

    weights: np.ndarray
    value: float
    chance: float
    background: float

    def at(self, background: np.ndarray) -> np.ndarray:
        """Return the thresholds for backgrounds (...) that are near to this one.

        With many counts per window, the threshold is the mean plus a number of standard deviations
        of the filtered background. Mean and standard deviation follow the background.
        """
        sum1 = self.weights.sum()
        sum2 = (self.weights**2).sum()
        if self.background * self.weights.size < 1:
            return np.full(background.shape, self.value)
        deviations = (self.value - self.background * sum1) / np.sqrt(self.background * sum2)
        return background * sum1 + deviations * np.sqrt(background * sum2)


def levels(background: np.ndarray, bins: int) -> np.ndarray:
    """Round backgrounds per bin to counts per pixel that have a threshold.

    Example:
        >>> levels(np.array([0.0, 0.021, 0.5, 0.51]), 100).round(2).tolist()
        [1.0, 2.0, 50.94, 50.94]
    """
    counts = np.maximum(background * bins, 1)
    steps = np.rint(np.log(counts / EXACT) / np.log(RATIO))
    return np.where(counts < EXACT, np.rint(counts), EXACT * RATIO**steps)


def known_levels(background: np.ndarray, bins: int) -> np.ndarray:
    """Round known backgrounds per bin to counts per pixel that have a threshold, also below 1."""
    counts = np.maximum(background * bins, LEAST)
    return RATIO ** np.rint(np.log(counts) / np.log(RATIO))


def threshold(
    masses: np.ndarray, bins: int, counts: float, false_alarm: float, known: bool
) -> Threshold:
    """Return the threshold for background alone, whose false alarms have a given probability.

    Args:
        masses: Parts P_k of the response at each lag.
        bins: Bins of a pixel.
        counts: Background counts per pixel: the expected number if it is known. Otherwise the
            number that was counted, whose places are random.
        false_alarm: Probability of one false echo or more in a pixel.
        known: Whether the background is known.
    """
    return _threshold(masses.tobytes(), bins, float(counts), false_alarm, known)


@lru_cache(maxsize=4096)
def _threshold(
    masses_bytes: bytes, bins: int, total: float, false_alarm: float, known: bool
) -> Threshold:
    """Return a threshold by simulation; see `threshold`."""
    masses = np.frombuffer(masses_bytes)
    background = total / bins
    signal = _just_detectable(masses, background, bins, false_alarm)
    weights = np.log1p(signal / background * masses)

    # Simulate pixels with an echo at a random place of a window whose ends are joined
    count = int(np.clip(EFFORT / (bins * masses.size), 300, 4000))
    rng = generator(0)
    simulate = _with_known_background if known else _with_counted_background
    pixels, log_factor = simulate(rng, count, masses, bins, total, signal)

    # Weight each pixel with 1 / (mean likelihood ratio)
    filtered = ndimage.correlate1d(pixels, weights, axis=1, mode="wrap")
    highest = filtered.max(axis=1)
    ratio = np.exp(filtered - highest[:, None]).mean(axis=1)
    part = np.exp(-highest - log_factor) / ratio / count

    # Go down from the largest value until the false alarms are as probable as asked
    step = ROUNDING * highest.max()
    lit = highest > 0
    _, which = np.unique(-np.rint(highest[lit] / step), return_inverse=True)
    at_level = np.bincount(which, part[lit])
    up_to = np.cumsum(at_level)
    k = min(int(np.searchsorted(up_to, false_alarm)), up_to.size - 1)
    before = up_to[k] - at_level[k]
    chance = float(np.clip((false_alarm - before) / at_level[k], 0, 1))
    value = float(highest[lit][which == k].mean())
    return Threshold(weights, value, chance, background)


def _just_detectable(masses: np.ndarray, background: float, bins: int, false_alarm: float) -> float:
    """Return the counts of an echo whose mean log-likelihood ratio is log(bins / false_alarm)."""

    def excess(log_signal: float) -> float:
        signal = np.exp(log_signal)
        means = signal * masses + background
        gain = (means * np.log1p(signal * masses / background)).sum() - signal
        return float(gain - np.log(bins / false_alarm))

    return float(np.exp(brentq(excess, -20, 60)))


def _with_known_background(
    rng: np.random.Generator,
    count: int,
    masses: np.ndarray,
    bins: int,
    total: float,
    signal: float,
) -> tuple[np.ndarray, Any]:
    """Simulate Poisson counts (count, bins), and return them with the log of L_i / exp(T_i)."""
    if total < bins / 4:
        number = rng.poisson(total, count)
        pixels = _histograms(number, rng.integers(bins, size=number.sum()), bins)
    else:
        pixels = rng.poisson(total / bins, (count, bins))
    pixels = pixels + _echoes(rng, rng.poisson(signal, count), masses, bins)
    return pixels.astype(np.float64), -signal


def _with_counted_background(
    rng: np.random.Generator,
    count: int,
    masses: np.ndarray,
    bins: int,
    total: float,
    signal: float,
) -> tuple[np.ndarray, Any]:
    """Simulate a fixed number of counts, each of which belongs to the echo by chance."""
    number = round(total)
    part = signal / (signal + number)
    of_echo = rng.binomial(number, part, count)
    rest = number - of_echo
    if number < bins / 4:
        pixels = _histograms(rest, rng.integers(bins, size=rest.sum()), bins)
    else:
        pixels = rng.multinomial(rest, np.full(bins, 1 / bins))
    pixels = pixels + _echoes(rng, of_echo, masses, bins)
    return pixels.astype(np.float64), number * np.log1p(-part)


def _echoes(
    rng: np.random.Generator, number: np.ndarray, masses: np.ndarray, bins: int
) -> np.ndarray:
    """Draw histograms of echoes of so many counts, each at a random place."""
    place = np.repeat(rng.integers(bins, size=number.size), number)
    lags = rng.choice(masses.size, place.size, p=masses / masses.sum()) - masses.size // 2
    return _histograms(number, (place + lags) % bins, bins)


def _histograms(number: np.ndarray, at: np.ndarray, bins: int) -> np.ndarray:
    """Histograms of the bins `at`, the first `number[0]` of which are in the first pixel."""
    pixel = np.repeat(np.arange(number.size), number)
    cells = np.bincount(pixel * bins + at, minlength=number.size * bins)
    return cells.reshape(number.size, bins)
