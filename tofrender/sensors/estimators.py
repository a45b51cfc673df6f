"""Estimators of depths and echoes from histograms of photons."""

from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy import ndimage, signal as filters, stats

from ..runtime import checks
from .bounds import depth_bound
from .jitter import kernel
from .rates import DIMS, at_least_0, axis_of
from .response import distribution

METHODS = ("matched", "log_matched", "centroid", "ml")
TAIL = 1e-3  # Of the response, at each end, that no return includes


class _Centred:
    """A distribution about the middle of a bin that is near its mean, `by` [m] from 0."""

    def __init__(self, whole: Any, width: float) -> None:
        self.whole, self.by = whole, round(float(whole.mean()) / width) * width

    def cdf(self, opl: Any) -> Any:
        return self.whole.cdf(opl + self.by)

    def pdf(self, opl: Any) -> Any:
        return self.whole.pdf(opl + self.by)

    def ppf(self, part: Any) -> Any:
        return self.whole.ppf(part) - self.by


class _Histogram:
    """Counts `n` (y, x, bin), and the masses of a response with their lags in bins."""

    def __init__(self, counts: Any, response: Any, width: Any) -> None:
        self.pixels, self.start = {}, 0.0
        if isinstance(counts, xr.Dataset):
            whole = "counts" in counts and {"start_opl", "bin_width_opl"} <= set(counts.attrs)
            checks.require("counts", counts, whole, "a Dataset of Spad.histogram")
            checks.require("bin_width_opl", width, width is None, "None for a Dataset")
            whole = {*counts["counts"].dims} == {*DIMS}
            checks.require("counts", counts["counts"].dims, whole, "a Dataset of (y, x, bin)")
            self.start, width = axis_of(counts)
            self.pixels = {name: counts[name] for name in "yx"}
            counts = counts["counts"].transpose(*DIMS).values
        self.n = at_least_0("counts", counts)
        self.width = checks.width("bin_width_opl", width)
        checks.shape("counts", self.n, self.n.ndim == 3 and self.n.size, "(y, x, bin)")
        self.response = _Centred(distribution("response", response), self.width)
        self.start, bins = self.start - self.response.by, self.n.shape[2]
        low, high = self.response.ppf([TAIL, 1 - TAIL])
        fits, allowed = high - low < bins * self.width, f"shorter than {bins} bins"
        checks.require("response", response, fits, allowed)
        self.masses = kernel(self.response, self.width, TAIL)
        self.lags = np.arange(self.masses.size) - self.masses.size // 2
        checks.require("response", response, self.lags.size < bins, allowed)

    def correlate(self, weights: np.ndarray) -> np.ndarray:
        """Correlation of the counts with weights at the lags."""
        return ndimage.correlate1d(self.n, weights, mode="constant")

    def split(self, peak: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Counts around peaks, of these the signal, and the background per bin."""
        inside = around(self.n, peak, self.lags)
        total = inside.sum(axis=-1)
        background = (self.n.sum(axis=-1) - total) / (self.n.shape[2] - self.lags.size)
        return inside, np.maximum(total - background * self.lags.size, 0), background


def around(values: np.ndarray, peak: Any, lags: np.ndarray) -> np.ndarray:
    """Values (..., lag) of (..., bin) at these lags from each peak, 0 beyond the window."""
    at = np.asarray(peak)[..., None] + lags
    inside = (at >= 0) & (at < values.shape[-1])
    return np.take_along_axis(values, np.where(inside, at, 0), axis=-1) * inside


def estimate_depth(
    counts: Any, response: Any, method: str = "ml", *, bin_width_opl: float | None = None
) -> xr.Dataset:
    """Estimate the depth of the strongest return in each pixel, and how sure it is.

    - "matched": maximum of the counts' correlation with the response P_k, by a parabola.
    - "log_matched": the same with log(1 + P_k S / b), for the median S / b of all pixels.
    - "centroid": mean position of the counts above background there, less the mean delay.
    - "ml": from there, Fisher scoring for position and signal of each pixel, whose counts are
      Poisson of mean S P_k(t) + b. Attains `depth_bound` where the return is found at all.

    The background b is the mean outside of the return.

    Args:
        counts: A Dataset of `Spad.histogram`, or counts (y, x, bin), at least 0.
        response: A `Response`, a `GaussianPulse` or a `SampledPulse`: pulse and jitter together.
        method: One of the above.
        bin_width_opl: Width of the bins [m], for an array.

    Returns:
        A Dataset (y, x): `depth` [m], half the path length, and `depth_std` [m], the confidence:
        `depth_bound` of the estimated `signal` and `background` (per bin). NaN and inf if dark.

    Raises:
        ValueError: Wrong counts, method or bins, or a response longer than the window.

    Example:
        >>> counts = np.zeros((1, 1, 40))
        >>> counts[0, 0, 18:21] = [20, 60, 20]
        >>> from tofrender import GaussianPulse
        >>> found = estimate_depth(counts, GaussianPulse(0.06), bin_width_opl=0.1)
        >>> round(found["depth"].item(), 3), round(found["depth_std"].item(), 4)
        (0.975, 0.0033)
    """
    checks.one_of("method", method, METHODS)
    data = _Histogram(counts, response, bin_width_opl)
    score = data.correlate(data.masses)
    peak = score.argmax(axis=-1)
    inside, signal, background = data.split(peak)
    if method != "matched":
        ratio = np.median(signal / np.maximum(background, 1e-3))
        score = data.correlate(np.log1p(data.masses * max(ratio, 1.0)))
        peak = score.argmax(axis=-1)
        inside, signal, background = data.split(peak)
    low, middle, high = np.moveaxis(around(score, peak, np.arange(-1, 2)), -1, 0)
    curve = np.minimum(low - 2 * middle + high, -1e-9)
    offset = np.clip((low - high) / (2 * curve), -0.5, 0.5)
    if method == "centroid":
        above = inside - background[..., None]
        offset = (above @ data.lags) / np.maximum(signal, 1e-9) - data.masses @ data.lags
    elif method == "ml":
        seen = around(np.ones(data.n.shape), peak, data.lags)  # Lags within the window
        offset, signal = _likeliest(data, inside, offset, signal, background, seen)
    signal = np.where(signal > 1e-2, signal, 0)
    depth = (data.start + (peak + offset + 0.5) * data.width) / 2
    std = depth_bound(signal, background, response, data.width)
    values = {"depth": np.where(signal > 0, depth, np.nan), "depth_std": std}
    images = {name: (("y", "x"), each, {"units": "m"}) for name, each in values.items()}
    images |= {"signal": (("y", "x"), signal), "background": (("y", "x"), background)}
    return xr.Dataset(images, data.pixels, {"method": method, "response": str(response)})


def _likeliest(
    data: _Histogram, inside: Any, offset: Any, signal: Any, background: Any, seen: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Offset [bins] and signal of the greatest likelihood, by Fisher scoring."""
    signal = np.maximum(signal, 1e-3)
    base, shape = np.maximum(background, 1e-6 * signal)[..., None], data.response
    for _ in range(12):
        near = (data.lags - 0.5 - offset[..., None]) * data.width
        masses = shape.cdf(near + data.width) - shape.cdf(near)
        slopes = shape.pdf(near) - shape.pdf(near + data.width)
        moved = slopes * signal[..., None] * data.width
        means = signal[..., None] * masses + base
        excess, one, two = inside - means, moved / means, masses / means
        parts = excess * one, excess * two, moved * one, moved * two, masses * two
        u, v, a, b, d = ((part * seen).sum(axis=-1) for part in parts)
        determinant = np.maximum(a * d - b * b, 1e-300)
        step = np.clip((d * u - b * v) / determinant, -0.5, 0.5)
        offset = np.clip(offset + step, -1.5, 1.5)
        signal = np.maximum(signal + (a * v - b * u) / determinant, 1e-3)
    return offset, signal


def echoes(
    counts: Any, response: Any, false_alarm: float = 1e-3, *, bin_width_opl: float | None = None
) -> xr.Dataset:
    """Find all returns of each pixel, with intensity and width.

    A return is a maximum of the counts' correlation with the response, under which lie more counts
    than the background explains: with N counts in the m bins without returns, those in L bins of
    background alone are negative binomial, of N + 1 successes with probability m / (m + L). Its
    tail is `false_alarm` for all bins (Šidák): the probability of a false return in a pixel stays
    below, from above 0 to 0.5. Other arguments and errors are as for `estimate_depth`; errors of
    what is found have the bounds `echo_bounds`.

    Returns:
        A Dataset along "echo": the pixel's row `y` and column `x` from 0, `number` from 1 by path
        length, `opl` and `depth` [m], `intensity` (counts above background), `width` (standard
        deviation [m]). Of returns that are closer than the response is long, the highest is found.

    Example:
        >>> counts = np.zeros((1, 1, 200))
        >>> counts[0, 0, [50, 120]] = [30, 10]
        >>> from tofrender import GaussianPulse
        >>> found = echoes(counts, GaussianPulse(0.03), bin_width_opl=0.1)
        >>> found["number"].values.tolist(), found["intensity"].values.tolist()
        ([1, 2], [30.0, 10.0])
    """
    false_alarm = checks.number("false_alarm", false_alarm, positive=True, high=0.5)
    data = _Histogram(counts, response, bin_width_opl)
    lags = data.lags
    score, sums = data.correlate(data.masses), data.correlate(np.ones(lags.size))
    alpha = -np.expm1(np.log1p(-false_alarm) / data.n.shape[2])
    above, background = np.zeros(data.n.shape, bool), np.zeros(data.n.shape[:2])
    for _ in range(4):  # The background is that of bins without returns
        quiet = ndimage.maximum_filter1d(above, lags.size) == 0
        number, bins = (data.n * quiet).sum(axis=-1), np.maximum(quiet.sum(axis=-1), 1)
        most = stats.nbinom.isf(alpha, number + 1, bins / (bins + lags.size))
        above, background = sums > most[..., None] + 0.5, number / bins
    rows = []
    for y, x in np.argwhere(above.any(axis=-1)):
        peaks = filters.find_peaks(np.pad(score[y, x], 1), distance=lags.size)[0] - 1
        for number, k in enumerate(peaks[above[y, x][peaks]], 1):
            inside = around(data.n[y, x], k, lags) - background[y, x]
            total = inside.sum()
            mean = inside @ lags / total
            width = data.width * np.sqrt(max(inside @ (lags - mean) ** 2 / total, 0))
            opl = data.start + (k + 0.5 + mean - data.masses @ lags) * data.width
            rows.append((y, x, number, opl, opl / 2, total, width))
    names = ["y", "x", "number", "opl", "depth", "intensity", "width"]
    table = pd.DataFrame(rows, columns=names, dtype=np.float64).rename_axis("echo")
    return table.astype(dict.fromkeys(names[:3], int)).to_xarray()
