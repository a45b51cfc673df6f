"""Thresholds of echo detection with a given probability of a false alarm.

Counts n are filtered with the log-likelihood ratio between an echo of S counts
and a background of b counts per bin,

    T_i = sum over lags k of n_(i + k) w_k,    w_k = log(1 + S P_k / b),

for the parts P_k of the response in bins. A pixel has an echo if the largest T_i exceeds a
threshold. The probability that background alone does so is found by simulation of pixels with one
echo at a random place, each weighted with its likelihood ratio (Naiman and Priebe, "Computing scan
statistic p values using importance sampling", J. Comput. Graph. Stat. 10, 2001):

    P(max T >= t) = E[1{max T >= t} / mean over i of L_i],    L_i = exp(T_i - S)

All pixels of the simulation have echoes, so that small probabilities need few of them.

Distant parts of a pixel are independent of each other. Therefore simulated pixels are shorter than
real pixels. If they have the fraction 1 / m of the bins, their P(max T < t) is the m-th root of the
probability for all bins.

If nearly all of the response is in one bin, T has few values, and a threshold is correct only for
one background. Then T is the number of counts in a bin. Its distribution is known: Poisson for a
known background, binomial for a given number of counts per pixel.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import signal as signals, stats
from scipy.optimize import brentq

from ..runtime.progress import ProgressBar
from .photon_rates import generator

RATIO = 1.1  # Ratio of neighboring backgrounds that have their own thresholds
EXACT = 10  # Each smaller number of counts per pixel has its own threshold
EFFORT = 4e6  # Products of counts and weights in a simulation
SHORTEST = 64  # Bins of a simulated pixel, at least
RESPONSES = 8  # Length of a simulated pixel in responses, at least
MOST = 2000  # Pixels of a simulation, at most
ROUNDING = 1e-7  # Relative error of values that are equal to a threshold
LEAST = 1e-9  # Background counts per pixel that are replaced by this value
ALONE = 0.95  # Part of the response in one bin above which only this bin counts


@dataclass(frozen=True)
class Threshold:
    """Filter and thresholds of some pixels.

    Attributes:
        pixels: Whether each pixel has this filter.
        weights: Weights w of the counts at each lag.
        value: Threshold of the filtered counts of each of these pixels.
        chance: Probability of an echo in a pixel that is just at its threshold.
    """

    pixels: np.ndarray
    weights: np.ndarray
    value: np.ndarray
    chance: np.ndarray | float


def thresholds(
    masses: np.ndarray, bins: int, background: np.ndarray, false_alarm: float, known: bool
) -> Iterator[Threshold]:
    """Return the thresholds that background alone exceeds with a given probability.

    Pixels with similar backgrounds have the same filter.

    Args:
        masses: Parts P_k of the response at each lag.
        bins: Bins of a pixel.
        background: Background counts per bin (pixel): the expected number if it is known, otherwise
            the number that was counted.
        false_alarm: Probability of one false echo or more in a pixel.
        known: Whether the background is known.
    """
    if masses.max() > ALONE:
        yield _of_one_bin(masses, bins, background, false_alarm, known)
        return
    level = known_levels(background, bins) if known else levels(background, bins)
    each_level = np.unique(level)
    with ProgressBar("Finding thresholds of echoes", each_level.size, unit="threshold") as bar:
        for each in each_level:
            pixels = level == each
            found = _simulated(masses.tobytes(), bins, float(each), false_alarm, known)
            yield Threshold(pixels, found.weights, found.at(background[pixels]), found.chance)
            bar.update()


def levels(background: np.ndarray, bins: int) -> np.ndarray:
    """Round backgrounds per bin to counts per pixel that have a threshold.

    Example:
        >>> levels(np.array([0.0, 0.021, 0.5, 0.51]), 100).round(2).tolist()
        [1.0, 2.0, 50.54, 50.54]
    """
    counts = np.maximum(background * bins, 1)
    steps = np.rint(np.log(counts / EXACT) / np.log(RATIO))
    return np.where(counts < EXACT, np.rint(counts), EXACT * RATIO**steps)


def known_levels(background: np.ndarray, bins: int) -> np.ndarray:
    """Round known backgrounds per bin to counts per pixel that have a threshold, also below 1."""
    counts = np.maximum(background * bins, LEAST)
    return RATIO ** np.rint(np.log(counts) / np.log(RATIO))


def _of_one_bin(
    masses: np.ndarray, bins: int, background: np.ndarray, false_alarm: float, known: bool
) -> Threshold:
    """Return thresholds of the counts in a bin, each for the exact background of its pixel."""
    weights = np.zeros(masses.size)
    weights[masses.argmax()] = 1

    # Distribution of the counts in a bin
    number = np.maximum(np.rint(background * bins), 1)
    in_a_bin: Any = stats.poisson(background) if known else stats.binom(number, 1 / bins)

    def false_alarms(value: np.ndarray) -> np.ndarray:
        """Return the probability of as many counts in any bin."""
        of_all = -np.expm1(bins * np.log1p(-in_a_bin.sf(value - 1)))
        return of_all if known else np.where(value == 1, 1, of_all)

    # Background alone exceeds this value in fewer pixels than asked
    in_each = -np.expm1(np.log1p(-false_alarm) / bins)
    value = np.maximum(in_a_bin.isf(in_each), 1)

    # Chance adds pixels that are at the threshold
    above = false_alarms(value + 1)
    at_value = np.maximum(false_alarms(value) - above, 1e-300)
    chance = np.clip((false_alarm - above) / at_value, 0, 1)
    return Threshold(np.ones(background.shape, bool), weights, value, chance)


@dataclass(frozen=True)
class _Simulated:
    """Filter and threshold for a background.

    Attributes:
        weights: Weights w of the counts at each lag.
        value: Threshold of the filtered counts.
        chance: Probability of an echo in a pixel that is just at the threshold.
        background: Background counts per bin.
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


@lru_cache(maxsize=4096)
def _simulated(
    masses_bytes: bytes, bins: int, total: float, false_alarm: float, known: bool
) -> _Simulated:
    """Return a threshold by simulation.

    Args:
        masses_bytes: Parts P_k of the response at each lag, as bytes.
        bins: Bins of a pixel.
        total: Background counts per pixel.
        false_alarm: As for `thresholds`.
        known: As for `thresholds`.
    """
    masses = np.frombuffer(masses_bytes)
    background = total / bins
    signal = _just_detectable(masses, background, bins, false_alarm)
    weights = np.log1p(signal / background * masses)

    # Simulate shorter pixels with an echo at a random place. The window is a circle without ends.
    short = min(bins, max(SHORTEST, RESPONSES * masses.size))
    count = int(np.clip(EFFORT / (short * masses.size), 300, MOST))
    rng = generator(0)
    simulate = _with_known_background if known else _with_counted_background
    pixels, log_factor = simulate(rng, count, masses, short, total, short / bins, signal)

    # Weight each pixel with 1 / (mean likelihood ratio)
    half = masses.size // 2
    circle = np.pad(pixels, ((0, 0), (half, half)), mode="wrap")
    filtered = signals.fftconvolve(circle, weights[None, ::-1], mode="valid", axes=1)
    highest = filtered.max(axis=1)
    ratio = np.exp(filtered - highest[:, None]).mean(axis=1)
    part = np.exp(-highest - log_factor) / ratio / count

    # Add up from the largest value. A count somewhere is certain if the number of counts is given.
    step = ROUNDING * highest.max()
    lit = pixels.any(axis=1)
    _, which = np.unique(-np.rint(highest[lit] / step), return_inverse=True)
    up_to = np.minimum(np.cumsum(np.bincount(which, part[lit])), 1 - 1e-12)
    of_all = -np.expm1(np.log1p(-up_to) * bins / short)
    if not known:
        of_all[-1] = 1

    # Take the value at which false alarms are as probable as asked
    k = min(int(np.searchsorted(of_all, false_alarm)), of_all.size - 1)
    above = of_all[k - 1] if k > 0 else 0.0
    chance = float(np.clip((false_alarm - above) / max(of_all[k] - above, 1e-300), 0, 1))
    value = float(highest[lit][which == k].mean())
    return _Simulated(weights, value, chance, background)


def _just_detectable(masses: np.ndarray, background: float, bins: int, false_alarm: float) -> float:
    """Return the counts of an echo with a mean log-likelihood ratio of log(bins / false_alarm)."""

    def excess(log_signal: float) -> float:
        signal = np.exp(log_signal)
        means = signal * masses + background
        gain = (means * np.log1p(signal * masses / background)).sum() - signal
        return float(gain - np.log(bins / false_alarm))

    root: Any = brentq(excess, -20, 60)
    return float(np.exp(root))


def _with_known_background(
    rng: np.random.Generator,
    count: int,
    masses: np.ndarray,
    bins: int,
    total: float,
    part: float,
    signal: float,
) -> tuple[np.ndarray, Any]:
    """Simulate Poisson counts (count, bins), and return them with the log of L_i / exp(T_i).

    The pixels have a `part` of the bins, and of the `total` of the background.
    """
    mean = total * part
    if mean < bins / 4:
        number = rng.poisson(mean, count)
        pixels = _histograms(number, rng.integers(bins, size=number.sum()), bins)
    else:
        pixels = rng.poisson(mean / bins, (count, bins))
    pixels = pixels + _echoes(rng, rng.poisson(signal, count), masses, bins)
    return pixels.astype(np.float64), -signal


def _with_counted_background(
    rng: np.random.Generator,
    count: int,
    masses: np.ndarray,
    bins: int,
    total: float,
    part: float,
    signal: float,
) -> tuple[np.ndarray, Any]:
    """Simulate a fixed number of counts, some outside of the part of the bins that is simulated.

    Each count belongs to the echo by chance.
    """
    number = round(total)
    of_signal = signal / (signal + number)
    of_echo = rng.binomial(number, of_signal, count)
    rest = rng.binomial(number - of_echo, part)
    if number * part < bins / 4:
        pixels = _histograms(rest, rng.integers(bins, size=rest.sum()), bins)
    else:
        pixels = rng.multinomial(rest, np.full(bins, 1 / bins))
    pixels = pixels + _echoes(rng, of_echo, masses, bins)
    return pixels.astype(np.float64), number * np.log1p(-of_signal)


def _echoes(
    rng: np.random.Generator, number: np.ndarray, masses: np.ndarray, bins: int
) -> np.ndarray:
    """Draw histograms of echoes of so many counts, each at a random place."""
    place = np.repeat(rng.integers(bins, size=number.size), number)
    lags = rng.choice(masses.size, place.size, p=masses / masses.sum()) - masses.size // 2
    return _histograms(number, (place + lags) % bins, bins)


def _histograms(number: np.ndarray, at: np.ndarray, bins: int) -> np.ndarray:
    """Return histograms of the bins `at`; `number` are the counts of each pixel, in this order."""
    pixel = np.repeat(np.arange(number.size), number)
    cells = np.bincount(pixel * bins + at, minlength=number.size * bins)
    return cells.reshape(number.size, bins)
