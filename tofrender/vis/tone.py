"""Tone mapping, which also supports sparse, unfinished and extreme data."""

import math
from functools import cache
from typing import Any

import numpy as np

from ..rendering.cubes import Cube
from ..runtime import checks
from .color_maps import to_srgb
from .transient_figures import Transient

_SAMPLES = 1 << 21


def auto_exposure(values: Any, *, percentile: float = 99.5) -> float:
    """Return the gain that shows the `percentile` of all finite values above zero as white.

    For more than two million values, the percentile is estimated from a fixed random choice.

    Args:
        values: Linear values of any shape: one image or a whole sequence, also a `Cube`.
        percentile: Percentile in (0, 100].

    Returns:
        Gain, finite and above 0. Without light, the gain is 1.

    Raises:
        ValueError: The percentile is out of range.

    Example:
        >>> auto_exposure(np.full((2, 2, 3), 0.5))
        2.0
    """
    # Collect values above zero
    percentile = checks.number("percentile", percentile, positive=True, high=100)
    cube = Cube.of("values", values)
    size = math.prod(cube.shape)
    lit = np.zeros(0, cube.dtype)
    if size > _SAMPLES:
        lit = _lit(cube.take(np.random.default_rng(0).integers(0, size, _SAMPLES)))
    if lit.size < 1000:  # Also for a large sequence that is almost dark
        lit = np.concatenate([lit[:0], *(_lit(piece) for _, piece in cube.pieces())])

    # Their percentile is white
    white = float(np.percentile(lit, percentile)) if lit.size else 1.0
    return 1 / white if math.isfinite(1 / white) else 1.0


def _lit(values: np.ndarray) -> np.ndarray:
    return values[(values > 0) & np.isfinite(values)]


def growing_exposure(values: Any, *, share: float = 0.75, most_stops: float = 6.0) -> np.ndarray:
    """Return a gain for each bin, which grows as the light fades, so that late light is visible.

    Let M_k be the largest mean luminance in bin k and all later bins, clipped to white at
    `auto_exposure`. Then

        gain_k = auto_exposure · 2^stops_k,    stops_k = min(most_stops, share · log2(M_0 / M_k))

    The gain never falls, so that a video does not flicker. Up to the brightest bin, the gain is
    `auto_exposure`.

    Args:
        values: Linear values, (height, width, bins) or (height, width, bins, channels) with 1 or 3
            channels, also a `Cube`.
        share: Part of the fading that is compensated, in [0, 1]. With 0, bins are comparable.
        most_stops: Largest compensation, in factors of 2, at most 32.

    Returns:
        Gains, float64 (bins,), finite, above 0, and never falling.

    Raises:
        ValueError: Another shape, or a number out of range.

    Example:
        >>> fading = np.ones((2, 2, 1)) * 0.5 ** np.arange(4)
        >>> growing_exposure(fading, share=1.0, most_stops=2)
        array([1., 2., 4., 4.])
    """
    share = checks.number("share", share, low=0, high=1)
    most = checks.number("most_stops", most_stops, low=0, high=32)
    gain, light = _light_of_bins(values)

    # How much does the light fade until each bin?
    remaining = np.maximum.accumulate(light[::-1])[::-1]
    fading = np.full(light.size, math.inf)
    np.divide(remaining[0], remaining, out=fading, where=remaining > 0)

    # Compensate a part of the fading
    stops = np.minimum(most, share * np.log2(fading) if share and remaining[0] > 0 else 0.0)
    with np.errstate(over="ignore"):
        gains = gain * 2**stops * np.ones(light.size)
    return np.minimum(gains, np.finfo(np.float64).max)


def lit_bins(values: Any, *, stops: float = 6.0) -> slice:
    """Return the range of bins with light. Bins before and after the range are dark.

    Args:
        values: As for `growing_exposure`.
        stops: Number of stops in (0, 32]. A bin is dark if its mean luminance, clipped to white, is
            less than 2^-stops of the mean luminance of the brightest bin.

    Returns:
        Slice from the first bin with light to the last. Without light, all bins.

    Raises:
        ValueError: Another shape, or a number out of range.

    Example:
        >>> lit_bins(np.array([0, 0, 8, 0, 1, 0.01, 0]) * np.ones((2, 2, 1)))
        slice(2, 5, None)
    """
    stops = checks.number("stops", stops, positive=True, high=32)
    _, light = _light_of_bins(values)
    lit = np.flatnonzero(light > light.max() * 2.0**-stops)
    return slice(int(lit[0]), int(lit[-1]) + 1) if lit.size else slice(0, light.size)


def _light_of_bins(values: Any) -> tuple[float, np.ndarray]:
    """Return the gain `auto_exposure`, and the sum of each bin's luminance, clipped to white."""
    sequence = Transient(Cube.of("values", values), 0.0, 1.0)
    gain = auto_exposure(sequence.values)
    light = np.zeros(sequence.bins)
    for (*_, bins), pixels in sequence.lights():
        light[bins] += np.minimum(pixels, 1 / gain).sum(axis=(0, 1), dtype=np.float64)
    return gain, light


def tonemap(
    values: Any, *, exposure: float | None = None, percentile: float = 99.5, shadows: float = 0.0
) -> np.ndarray:
    """Convert linear radiance to an sRGB picture.

    Args:
        values: Linear values, (height, width), (height, width, 1) or (height, width, 3). Negative
            values become black and infinite values white. Unfinished pixels, with a NaN, have a
            dark hatch.
        exposure: Gain. The product 1 is white. By default `auto_exposure` of `values`. To compare
            the frames of a sequence, pass one number for all frames.
        percentile: Percentile for `auto_exposure`, in (0, 100].
        shadows: Brightening of dark values [stops, factors of 2], 0 to 16. White and hues do not
            change. The strongest channel V of a pixel, in [0, 1], becomes log(1 + kV) / log(1 + k).
            The slope at 0, k / log(1 + k), is 2^shadows.

    Returns:
        Picture, uint8 (height, width, 3).

    Raises:
        ValueError: Another shape, an exposure that is not a finite number above 0, or `shadows`
            out of range.

    Example:
        >>> tonemap(np.array([[0.0, 0.5, 1.0]]), exposure=1)[..., 0]
        array([[  0, 188, 255]], dtype=uint8)
    """
    # Check the arguments
    given = checks.real_array("values", values)
    linear = given[..., None] if given.ndim == 2 else given
    valid = linear.ndim == 3 and linear.shape[2] in (1, 3)
    allowed = "(height, width) or (height, width, channels) with 1 or 3 channels"
    checks.shape("values", given, valid, allowed)
    if exposure is None:
        exposure = auto_exposure(linear, percentile=percentile)
    exposure = checks.number("exposure", exposure, positive=True)
    shadows = checks.number("shadows", shadows, low=0, high=16)

    # Apply the gain
    unfinished = np.isnan(linear).any(axis=2)
    with np.errstate(over="ignore"):
        shown = np.clip(np.nan_to_num(linear * np.float32(exposure), nan=0), 0, 1)

    # Brighten the shadows
    if shadows:
        k = _curve_of_slope(2**shadows)
        value = shown.max(axis=2, keepdims=True)
        lifted = np.log1p(k * value) / math.log1p(k)
        shown = shown * np.divide(lifted, value, out=np.zeros_like(value), where=value > 0)

    # Encode as sRGB, and hatch unfinished pixels
    picture = np.rint(255 * to_srgb(shown)).astype(np.uint8)
    picture = np.repeat(picture, 3, axis=2) if picture.shape[2] == 1 else picture
    if unfinished.any():
        rows, columns = np.nonzero(unfinished)
        picture[rows, columns] = np.where((rows + columns) % 8 < 4, 38, 58)[:, None]
    return picture


@cache
def _curve_of_slope(slope: float) -> float:
    """Solve k / log(1 + k) = `slope` for k by Newton's method, from above."""
    k = 2 * slope * math.log(2 * slope)
    least = 1e-9
    while k > least and (less := k - (k - slope * math.log1p(k)) / (1 - slope / (1 + k))) < k:
        k = less
    return max(least, k)
