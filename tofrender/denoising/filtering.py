"""Filter of transient films whose strength follows from the difference of two halves.

With the noise D = (first - second) / 2 of the mean M and fixed linear operators F and Q, the
expected value of <M, Q F M> - <D, Q F D> is <θ, Q F θ>, for noise of any distribution if the halves
are independent. So for the film x = F M so far and its residual r = Q x, the expected squared error
of x - g r is least at

    g = (<x - M, r> + <D, Q F D>) / <r, r>,    clipped to 0 ... 1

This is Stein's unbiased risk estimate (Ann. Statist. 9, 1981) without a Gaussian assumption. The
products are summed over blocks with their neighbours: hundreds of values for one number, or the
choice itself would follow the noise and do harm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import minimum_filter, uniform_filter

from ..runtime import backend, checks
from . import kernels
from .blocks import Blocks, Packets

STAGES = (("bins", 1), ("pixels", 1), ("bins", 2), ("pixels", 2))
"""Filters one after the other, with the distance of their taps."""

POOL = 3  # Blocks along each axis over whose sums the products are added up
MARGIN = 6.0  # Factor of the part of a residual that seems to be light, so that doubtful ones stay
NOISIER = 30.0  # Ratio of variances above which a block keeps its light from its neighbours
QUIET = 1e-12  # Variance of a block, over the greatest, below which it counts as much
LEAST_ALBEDO = np.float32(0.05)  # Light of darker surfaces is divided by this

KINDS = {"scattering": 0, "emitter": 1, "specular": 2}
"""Kinds of a pixel's first hits: one of the latter two if any of its rays has it."""

FEATURES = {"position": 3, "normal": 3, "albedo": 3, "distance": 1, "kind": 1}
"""Features and their channels."""


def denoise_film(
    mean: np.ndarray,
    half_difference: np.ndarray,
    features: Mapping[str, np.ndarray],
    colours: int = 0,
) -> np.ndarray:
    """Remove noise from a transient film whose samples are known in two halves.

    Pixels are mixed where their first hits are alike, never those that see an emitter, a mirror or
    clear glass; bins are mixed everywhere but in pixels that see an emitter, which stay as they
    are. Sums over all bins and the pixels of a kind stay. A pixel gets no light in bins before the
    first light of its 3 x 3 neighborhood. In bins that are much darker than those around them, the
    error can grow; docs/denoising.md has numbers.

    Args:
        mean: Mean of the films of both halves, float (height, width, bins, channels), finite.
        half_difference: Half their difference, of either sign, which changes nothing.
        features: Arrays (height, width, 3) of `position` [m], `normal` and `albedo` (0 to 1) of the
            first hits, (height, width) of `distance` [m] and of `kind`, one of `KINDS`.
        colours: Channels, the first ones, whose intensity decides; the others are mixed as they
            are. By default all, or those of S0 if there are 4 or 12.

    Returns:
        The filtered mean, float32 (height, width, bins, channels).

    Raises:
        ValueError: The arrays do not fit together or are not finite; one line.

    Example:
        >>> rng, ones = np.random.default_rng(0), np.ones((16, 16, 3))
        >>> position = np.dstack([*np.mgrid[:16, :16] / 160, ones[..., 0]])
        >>> flat = {"position": position, "normal": ones * (0, 0, -1), "albedo": ones}
        >>> flat |= {"distance": ones[..., 0], "kind": 0 * ones[..., 0]}
        >>> first, second = 1 + rng.normal(0, 0.1, (2, 16, 16, 32, 1))
        >>> mean = (first + second) / 2
        >>> bool(denoise_film(mean, (first - second) / 2, flat).std() < 0.4 * mean.std())
        True
    """
    backend.require_vectorised()
    mean = checks.finite("mean", checks.real_array("mean", mean, np.float32))
    checks.shape("mean", mean, mean.ndim == 4 and mean.size, "(height, width, bins, channels)")
    noise = checks.real_array("half_difference", half_difference, np.float32)
    checks.shape("half_difference", noise, noise.shape == mean.shape, f"{mean.shape}, as mean's")
    checks.finite("half_difference", noise)
    height, width, bins, channels = mean.shape
    features = _checked(features, (height, width))
    checks.integer("colours", colours, 0, channels)
    colours = colours or (channels // 4 if channels in (4, 12) else channels)
    checks.require("colours", colours, channels % colours == 0, f"a divisor of {channels}")
    kind, scale = features["kind"].ravel(), np.ones((height * width, channels), np.float32)
    if channels % 3 == 0:
        albedo = np.maximum(features["albedo"].reshape(-1, 3), LEAST_ALBEDO)
        scale[:] = np.tile(albedo, channels // 3)
        scale[kind == KINDS["emitter"]] = 1

    # Divide by albedo; the last channel is the noise of the sum
    cell = dr.arange(mi.UInt32, height * width * bins)
    light, difference, inverse = (mi.Float(np.ravel(each)) for each in (mean, noise, 1 / scale))
    values, total = [], mi.Float(0)
    for channel in range(channels):
        factor = dr.gather(mi.Float, inverse, cell // bins * channels + channel)
        values.append(dr.gather(mi.Float, light, cell * channels + channel) * factor)
        if channel < colours:
            total += dr.gather(mi.Float, difference, cell * channels + channel) * factor
    film = Packets.of(dr.width(cell), cell, [*values, total])
    before = film.totals(bins)[:, :channels]
    reached = _reached_bins(np.any(mean != 0, axis=-1))
    film = _remove_noise(film, Blocks(height, width, bins), features, colours, reached)
    after = film.totals(bins)[:, :channels]

    # Keep the sums of each kind
    for own in (kind == each for each in np.unique(kind)):
        was, now = (
            np.sum((scale * each)[own, :colours], axis=0, dtype=np.float64)
            for each in (before, after)
        )
        factor = np.divide(was, now, out=np.ones(colours), where=now > 0)
        scale[own] *= np.tile(factor, channels // colours)
    scales, found = mi.Float(np.ravel(scale)), dr.empty(mi.Float, mean.size)
    for channel, value in enumerate(film.at(cell)[:channels]):
        factor = dr.gather(mi.Float, scales, cell // bins * channels + channel)
        target = cell * channels + channel
        dr.scatter(found, value * factor, target, mode=dr.ReduceMode.Permute)
    return np.array(found).reshape(mean.shape)


def _reached_bins(lit: np.ndarray) -> np.ndarray:
    """Find the bins of each pixel from the first light of its 3 x 3 neighborhood on.

    Args:
        lit: Whether a bin holds light, bool (height, width, bins).

    Returns:
        A bool array of the same shape. The filter moves no light into the other bins.
    """
    bins = lit.shape[-1]
    first = np.where(lit.any(axis=-1), lit.argmax(axis=-1), bins)
    earliest = minimum_filter(first, 3, mode="nearest")
    return np.arange(bins) >= earliest[..., None]


def _remove_noise(
    film: Packets,
    blocks: Blocks,
    features: Mapping[str, np.ndarray],
    colours: int,
    reached: np.ndarray,
) -> Packets:
    """Remove the stages' residuals as far as they are noise.

    The last channel of the film is its noise. `reached` (height, width, bins) marks the bins that
    exchange light; the others keep theirs.
    """
    height, width, bins = blocks.size
    cells = dr.arange(mi.UInt32, height * width * bins)
    pixel = cells // bins
    start = film.at(cells)
    original, noise = _sum(start, colours), start[-1]
    dr.eval(original, noise)
    exchanging = mi.Bool(reached.ravel())
    emitter = mi.Bool(features["kind"].ravel() == KINDS["emitter"])

    # A firefly must not decide for its neighbours, nor reach them
    y, x, t, inside = blocks.lanes()
    cell = (y * width + x) * bins + t
    (variance,) = blocks.sums(dr.square(dr.gather(mi.Float, noise, cell, inside)))
    if not variance.any():
        return film
    weight = 1 / np.maximum(uniform_filter(variance, POOL, mode="nearest"), QUIET * variance.max())
    ways = mi.UInt32(np.ravel(kernels.open_ways(_is_like_neighbours(variance))))

    for over, step in STAGES:
        if over == "bins":
            taps = kernels.over_bins(blocks, step)
        else:
            taps = kernels.over_pixels(blocks, step, kernels.pixel_weights(features, step), ways)

        # Residuals, and what they and the noise tell in each block
        own = film.at(cell, inside)
        open_here = dr.gather(mi.Bool, exchanging, cell, inside)
        residuals = [mi.Float(0) for _ in own]
        for other, tap, there in taps:
            there &= open_here & dr.gather(mi.Bool, exchanging, other, there)
            tap &= there
            for channel, value in enumerate(film.at(other, there)):
                residuals[channel] += tap * (own[channel] - value)
        found = Packets.of(film.cells, cell, residuals, inside)
        light = _sum(residuals, colours)
        excess = (_sum(own, colours) - dr.gather(mi.Float, original, cell, inside)) * light
        excess += dr.gather(mi.Float, noise, cell, inside) * residuals[-1]
        excess, power = (
            uniform_filter(weight * each, POOL, mode="constant")
            for each in blocks.sums(excess, dr.square(light))
        )
        signal = 1 - np.divide(excess, power, out=np.zeros_like(power), where=power > 0)

        # Remove them, where most of them is noise
        gains = np.clip(1 - MARGIN * np.maximum(signal, 0), 0, 1)
        if not gains.any():
            continue
        block = blocks.of(pixel // width, pixel % width, cells % bins)
        gain = dr.gather(mi.Float, mi.Float(np.ravel(gains).astype(np.float32)), block)
        gain &= ~dr.gather(mi.Bool, emitter, pixel)
        pairs = zip(film.at(cells), found.at(cells), strict=True)
        film = Packets.of(film.cells, cells, [value - gain * each for value, each in pairs])
    return film


def _sum(values: Sequence[mi.Float], colours: int) -> mi.Float:
    return sum(values[1:colours], values[0])


def _is_like_neighbours(variance: np.ndarray) -> np.ndarray:
    """Whether blocks are not much noisier than any neighbour, whom their noise would reach."""
    steady = uniform_filter(variance, (1, 1, POOL), mode="nearest")
    return steady <= NOISIER * minimum_filter(steady, (POOL, POOL, 1), mode="nearest")


def _checked(features: Mapping[str, np.ndarray], size: tuple[int, int]) -> dict[str, np.ndarray]:
    """Refuse features that are incomplete, do not fit the film or are not finite."""
    complete = isinstance(features, Mapping) and not set(FEATURES) - set(features)
    checks.require("features", features, complete, f"a dict of {', '.join(FEATURES)}")
    found = {}
    for name, channels in FEATURES.items():
        array = found[name] = checks.real_array(f"features: {name}", features[name], np.float32)
        shape = size if channels == 1 else (*size, channels)
        checks.shape(f"features: {name}", array, array.shape == shape, f"{shape}, as the film")
        checks.finite(f"features: {name}", array)
    return found
