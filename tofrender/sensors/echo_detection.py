"""Echoes in histograms of photons."""

from typing import Annotated, Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy import ndimage, signal as filters, stats

from ..labels import COUNTS
from ..runtime import checks
from .false_alarms import ROUNDING, thresholds
from .photon_histograms import Returns, around
from .photon_rates import generator

PASSES = 4  # Passes in which a background is estimated
SEPARATE = 5  # Echoes of a pixel above which its light is not in separate echoes
UNLIKELY = 1e-3  # Probability of counts that a known background does not explain
FEW = 5  # Background counts of a pixel below which pixels share their background
POOLED = 20  # Background counts of all pixels that share it, at least
CHOICES = 1 << 31  # Stream of random numbers
BLOCK = 1 << 20  # Bins of the pixels that are treated at once

_Found = dict[int, tuple[np.ndarray, float]]


def echoes(
    counts: Annotated[Any, COUNTS],
    response: Any,
    false_alarm: float = 1e-3,
    *,
    background: Any = None,
    start_opl: float | None = None,
    bin_width_opl: float | None = None,
    seed: int = 0,
) -> xr.Dataset:
    """Find all returns of each pixel, with intensity and width.

    The counts n are filtered with the log-likelihood ratio of a return of S counts,

        T_i = sum over lags k of n_(i + k) log(1 + S P_k / b),

    with the parts P_k of the response and the background b per bin. S is a return that is just
    detectable. Maxima of T above a threshold are returns. If returns are closer together than the
    response is long, only the highest return is found.

    The threshold is such that background alone causes false returns in a pixel with the
    probability `false_alarm`, or with the probability of any count if that is smaller. T has steps
    where counts are few. Where T is just at the threshold, chance decides whether it is a return,
    so that the probability is as asked.

    If b is not known, it is the mean of the pixel's bins without returns. Pixels with fewer than 5
    such counts share the mean of all these pixels, if they have 20 counts or more together.
    Otherwise the probability holds for pixels with as many counts.

    Fog and light of several scatterings are not separate returns. Therefore a known b is replaced
    with an estimate in two cases: it leads to more than 5 returns in a pixel, or the counts outside
    of strong returns are too many for it, with a probability below 0.001.

    `echo_bounds` computes the least errors of returns.

    Args:
        counts: As for `estimate_depth`.
        response: As for `estimate_depth`.
        false_alarm: Probability of a false return in a pixel, above 0 and up to 0.5.
        background: Expected background b per bin, a number or (y, x); None to estimate it.
        start_opl: As for `estimate_depth`.
        bin_width_opl: As for `estimate_depth`.
        seed: Seed of the choice at the threshold.

    Returns:
        A Dataset along "echo": the pixel's row `y` and column `x` from 0, `number` from 1 by path
        length, `opl` and `depth` [m], `intensity` (counts above background), `width` (standard
        deviation [m]).

    Raises:
        ValueError: Wrong counts, background, rate or bins, or a response longer than the window.

    Example:
        >>> counts = np.zeros((1, 1, 200))
        >>> counts[0, 0, [50, 120]] = [30, 10]
        >>> from tofrender import GaussianPulse
        >>> found = echoes(counts, GaussianPulse(0.03), start_opl=0.0, bin_width_opl=0.1)
        >>> found["number"].values.tolist(), found["intensity"].values.tolist()
        ([1, 2], [30.0, 10.0])
    """
    false_alarm = checks.number("false_alarm", false_alarm, positive=True, high=0.5)
    data = Returns(counts, response, start_opl, bin_width_opl)
    pixels = data.n.shape[:2]
    draws = choices(seed, pixels[0] * pixels[1])
    if background is None:
        return find_echoes(data, false_alarm, None, draws).to_xarray()
    known = data.of_pixels("background", background)
    return find_echoes(data, false_alarm, np.broadcast_to(known, pixels), draws).to_xarray()


def choices(seed: int, count: int) -> np.ndarray:
    """Draw numbers from 0 to 1 for the choice of pixels at the threshold.

    These numbers are independent of the random numbers of sensors.
    """
    return generator(seed, CHOICES).random(count)


def find_echoes(
    data: Returns, false_alarm: float, background: np.ndarray | None, draws: np.ndarray
) -> pd.DataFrame:
    """Return the table of `echoes`, for backgrounds (y, x) and draws (pixel) of `choices`."""
    width = data.n.shape[1]
    detector = _Detector(data, draws, false_alarm)
    if background is None:
        found = detector.with_unknown_background()
    else:
        found = detector.with_background(background.ravel())

    # Measure the returns of each pixel
    rows: list[tuple[float, ...]] = []
    for pixel in sorted(found):
        y, x = divmod(pixel, width)
        peaks, level = found[pixel]
        for number, peak in enumerate(peaks, 1):
            rows.append((y, x, number, *_measured(data, data.n[y, x], peak, level)))
    names = ["y", "x", "number", "opl", "depth", "intensity", "width"]
    table = pd.DataFrame(rows, columns=names, dtype=np.float64).rename_axis("echo")
    return table.astype(dict.fromkeys(names[:3], int))


def _measured(
    data: Returns, counts: np.ndarray, peak: int, background: float
) -> tuple[float, float, float, float]:
    """Return path length, depth, intensity and width of a return of a pixel."""
    above = around(counts, peak, data.lags) - background
    total = max(float(above.sum()), 0.0)
    reach = data.lags.size // 2
    mean = float(np.clip(above @ data.lags / max(total, 1e-9), -reach, reach))
    variance = float(above @ (data.lags - mean) ** 2 / max(total, 1e-9))
    opl = data.start + (peak + 0.5 + mean - data.masses @ data.lags) * data.width
    width = data.width * float(np.sqrt(np.clip(variance, 0, reach**2)))
    return float(opl), float(opl) / 2, total, width


class _Detector:
    """Detection of returns. Results have, by pixel, the peaks and the background per bin.

    Args:
        data: Counts and response.
        draws: Random numbers (pixel), from 0 to 1, for pixels at a threshold.
        false_alarm: Probability of a false return in a pixel.
    """

    def __init__(self, data: Returns, draws: np.ndarray, false_alarm: float) -> None:
        self.data = data
        self.bins = data.n.shape[2]
        self.counts = data.n.reshape(-1, self.bins)
        self.draws = draws
        self.false_alarm = false_alarm

    def with_background(self, background: np.ndarray) -> _Found:
        """Find the returns of all pixels from their known background (pixel)."""
        pixels = np.arange(len(self.counts))
        found = self._by_background(pixels, background)
        by_counts, number, quiet_bins = self._by_counts(pixels)

        # Fog is not a separate return, and light of several scatterings follows strong returns
        excess = stats.poisson.sf(number - 0.5, background * quiet_bins) < UNLIKELY
        for pixel in list(found):
            many = len(found[pixel][0]) > SEPARATE
            if many or (excess[pixel] and pixel in by_counts):
                del found[pixel]
                if pixel in by_counts:
                    found[pixel] = by_counts[pixel]
        return found

    def with_unknown_background(self) -> _Found:
        """Find the returns of all pixels; bins without returns determine the background."""
        pixels = np.arange(len(self.counts))
        found, number, quiet_bins = self._by_counts(pixels)

        # Pixels with few counts share their background
        few = number < FEW
        total = number[few].sum()
        if total < POOLED:
            return found
        shared = np.full(few.sum(), total / quiet_bins[few].sum())
        kept = {pixel: each for pixel, each in found.items() if not few[pixel]}
        return kept | self._by_background(pixels[few], shared)

    def _by_background(self, pixels: np.ndarray, background: np.ndarray) -> _Found:
        """Find the returns of some pixels with a background (pixel) that is known."""
        found: _Found = {}
        for block in self._blocks(pixels):
            level = background[block]
            filtered, above = self._filter(pixels[block], level, known=True)
            found |= self._peaks(pixels[block], filtered, above, level)
        return found

    def _by_counts(self, pixels: np.ndarray) -> tuple[_Found, np.ndarray, np.ndarray]:
        """Find the returns of some pixels with the background of their bins without returns.

        Returns:
            The returns, and the number of counts without returns and of their bins (pixel).
        """
        found: _Found = {}
        number = np.zeros(len(pixels))
        quiet_bins = np.zeros(len(pixels))
        for block in self._blocks(pixels):
            chosen = pixels[block]
            counts = self.counts[chosen]
            above = np.zeros(counts.shape, bool)

            # Estimate the background from bins without returns, and find the returns above it
            for _ in range(PASSES):
                quiet = ndimage.maximum_filter1d(above, self.data.lags.size) == 0
                number[block] = (counts * quiet).sum(axis=-1)
                quiet_bins[block] = np.maximum(quiet.sum(axis=-1), 1)
                background = number[block] / quiet_bins[block]
                before = above
                filtered, above = self._filter(chosen, background, known=False)
                if np.array_equal(above, before):
                    break
            found |= self._peaks(chosen, filtered, above, background)
        return found, number, quiet_bins

    def _blocks(self, pixels: np.ndarray) -> list[slice]:
        """Cut pixels into blocks, so that memory does not grow with their number."""
        step = max(1, BLOCK // self.bins)
        return [slice(start, start + step) for start in range(0, len(pixels), step)]

    def _filter(
        self, pixels: np.ndarray, background: np.ndarray, known: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return filtered counts (pixel, bin), and where they are above the threshold."""
        filtered = np.empty((len(pixels), self.bins))
        limit = np.empty(len(pixels))
        masses = self.data.masses
        for each in thresholds(masses, self.bins, background, self.false_alarm, known):
            chosen = pixels[each.pixels]
            counts = self.counts[chosen]
            filtered[each.pixels] = ndimage.correlate1d(
                counts, each.weights, axis=1, mode="constant"
            )

            # Chance decides about pixels that are just at the threshold
            passes = self.draws[chosen] < each.chance
            side = np.where(passes, 1 - 4 * ROUNDING, 1 + 4 * ROUNDING)
            limit[each.pixels] = each.value * side
        return filtered, filtered > limit[:, None]

    def _peaks(
        self, pixels: np.ndarray, filtered: np.ndarray, above: np.ndarray, background: np.ndarray
    ) -> _Found:
        """Return the maxima above the threshold of each pixel that has some."""
        found: _Found = {}
        for k in np.flatnonzero(above.any(axis=1)):
            padded = np.pad(filtered[k], 1)
            peaks = filters.find_peaks(padded, distance=self.data.lags.size)[0] - 1
            peaks = peaks[above[k][peaks]]
            if peaks.size:
                found[int(pixels[k])] = peaks, float(background[k])
        return found
