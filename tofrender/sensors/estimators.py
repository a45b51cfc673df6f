"""Estimators of depths from histograms of photons."""

from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import COUNTS
from ..runtime import checks
from .bounds import depth_bound
from .photon_histograms import Returns, around

METHODS = ("matched", "log_matched", "centroid", "ml")


def estimate_depth(
    counts: Annotated[Any, COUNTS],
    response: Any,
    method: str = "ml",
    *,
    start_opl: float | None = None,
    bin_width_opl: float | None = None,
) -> xr.Dataset:
    """Estimate the depth of the strongest return in each pixel, and its standard deviation.

    - "matched": maximum of the correlation of counts and response P_k, refined by a parabola.
    - "log_matched": maximum of the correlation with log(1 + P_k S / b), with the median S / b of
      all pixels.
    - "centroid": mean position of the counts above background around this maximum, minus the mean
      delay of the response.
    - "ml": maximum likelihood of position and signal in each pixel, for Poisson counts of the mean
      S P_k(t) + b. Fisher scoring starts at the maximum. If the return is found at all, the error
      attains `depth_bound`.

    The background b is the mean outside the return.

    Args:
        counts: A Dataset of `Spad.histogram`, or a DataArray of counts with the path length as
            coordinate, such as a result of `coates` or a record of a data set, or an array (y, x,
            bin). Counts are at least 0.
        response: A `Response`, a `GaussianPulse` or a `SampledPulse`: pulse and jitter together.
        method: One of the methods above.
        start_opl: Start of the first bin [m]. Required for arrays, not allowed for labeled counts.
        bin_width_opl: Width of the bins [m]. Required for arrays, not allowed for labeled counts.

    Returns:
        A Dataset (y, x) with `depth` [m], which is half the path length, and its standard deviation
        `depth_std` [m], which is `depth_bound` for the estimated `signal` and `background` (per
        bin). In dark pixels they are NaN and inf.

    Raises:
        ValueError: Counts, method or bins are invalid, or the response is longer than the window;
            one line.

    Example:
        >>> counts = np.zeros((1, 1, 40))
        >>> counts[0, 0, 18:21] = [20, 60, 20]
        >>> from tofrender import GaussianPulse
        >>> found = estimate_depth(counts, GaussianPulse(0.06), start_opl=2.0, bin_width_opl=0.1)
        >>> round(found["depth"].item(), 3), round(found["depth_std"].item(), 4)
        (1.975, 0.0033)
    """
    # Find the maximum of the correlation
    checks.one_of("method", method, METHODS)
    data = Returns(counts, response, start_opl, bin_width_opl)
    score = data.correlate(data.masses)
    peak = score.argmax(axis=-1)
    inside, signal, background = data.split(peak)

    # Weight the response by the signal-to-background ratio
    if method != "matched":
        ratio = np.median(signal / np.maximum(background, 1e-3))
        score = data.correlate(np.log1p(data.masses * max(ratio, 1.0)))
        peak = score.argmax(axis=-1)
        inside, signal, background = data.split(peak)

    # Refine the position by a parabola
    low, middle, high = np.moveaxis(around(score, peak, np.arange(-1, 2)), -1, 0)
    curve = np.minimum(low - 2 * middle + high, -1e-9)
    offset = np.clip((low - high) / (2 * curve), -0.5, 0.5)

    # Apply the other methods
    if method == "centroid":
        above = inside - background[..., None]
        offset = (above @ data.lags) / np.maximum(signal, 1e-9) - data.masses @ data.lags
    elif method == "ml":
        # Which lags are within the window?
        seen = around(np.ones(data.n.shape), peak, data.lags)
        offset, signal = _likeliest(data, inside, offset, signal, background, seen)

    # Describe the result
    signal = np.where(signal > 1e-2, signal, 0)
    depth = (data.start + (peak + offset + 0.5) * data.width) / 2
    std = depth_bound(signal, background, response, data.width)
    values = {"depth": np.where(signal > 0, depth, np.nan), "depth_std": std}
    images = {name: (("y", "x"), each, {"units": "m"}) for name, each in values.items()}
    images |= {"signal": (("y", "x"), signal), "background": (("y", "x"), background)}
    return xr.Dataset(images, data.pixels, {"method": method, "response": str(response)})


def _likeliest(
    data: Returns, inside: Any, offset: Any, signal: Any, background: Any, seen: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Maximize the likelihood of offset and signal by Fisher scoring.

    Args:
        data: Counts and response.
        inside: Counts at the lags around the peak (y, x, lag).
        offset: First estimate of the offset from the peak [bins].
        signal: First estimate of the signal.
        background: Background per bin.
        seen: Mask of the lags in the window (y, x, lag).

    Returns:
        Offset [bins] and signal, both (y, x).
    """
    signal = np.maximum(signal, 1e-3)
    base = np.maximum(background, 1e-6 * signal)[..., None]
    shape = data.response
    for _ in range(12):
        # Expected counts and their derivatives by offset and signal
        near = (data.lags - 0.5 - offset[..., None]) * data.width
        masses = shape.cdf(near + data.width) - shape.cdf(near)
        slopes = shape.pdf(near) - shape.pdf(near + data.width)
        moved = slopes * signal[..., None] * data.width
        means = signal[..., None] * masses + base

        # Score and Fisher information
        excess = inside - means
        one = moved / means
        two = masses / means
        parts = excess * one, excess * two, moved * one, moved * two, masses * two
        u, v, a, b, d = ((part * seen).sum(axis=-1) for part in parts)

        # Newton's step, limited to half a bin
        determinant = np.maximum(a * d - b * b, 1e-300)
        step = np.clip((d * u - b * v) / determinant, -0.5, 0.5)
        offset = np.clip(offset + step, -1.5, 1.5)
        signal = np.maximum(signal + (a * v - b * u) / determinant, 1e-3)
    return offset, signal
