"""Filter of transient films with a strength that is estimated from two halves of the samples.

Two independent renders with half of the samples each have the mean M and the noise
D = (first - second) / 2. θ is the unknown film without noise. For fixed linear operators F and Q,
the expected value of <M, Q F M> - <D, Q F D> is <θ, Q F θ>, for any distribution of the noise. Let
x = F M be the film after the previous stages, and r = Q x the residual of the next stage. Then the
expected squared error of x - g r is smallest for the gain

    g = (<x - M, r> + <D, Q F D>) / <r, r>,    clipped to 0 ... 1

This is Stein's unbiased risk estimate (Ann. Statist. 9, 1981) without the assumption of Gaussian
noise. The products are summed over blocks and their neighbors, so that hundreds of values determine
one gain. With fewer values, the gain would follow the noise and increase the error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import minimum_filter, uniform_filter

from ..runtime import checks, variants
from . import kernels
from .blocks import Blocks, Packets

STAGES = (("bins", 1), ("pixels", 1), ("bins", 2), ("pixels", 2))
"""Filters in their order of application, with the distance between their taps."""

POOL = 3  # Number of blocks along each axis over which the products are summed
MARGIN = (
    6.0  # Factor of the estimated fraction of light in a residual, so that the filter is careful
)
NOISIER = 30.0  # Blocks with a larger ratio of variance do not exchange light with neighbors
QUIET = 1e-12  # Smallest variance of a block, relative to the largest variance
LEAST_ALBEDO = np.float32(0.05)  # Light of darker surfaces is divided by this albedo

KINDS = {"scattering": 0, "emitter": 1, "specular": 2}
"""Kinds of a pixel's first hits. One ray with an emitter or a specular hit determines the kind."""

FEATURES = {"position": 3, "normal": 3, "albedo": 3, "distance": 1, "kind": 1}
"""Features of first hits, with their numbers of channels."""


def denoise_film(
    mean: np.ndarray,
    half_difference: np.ndarray,
    features: Mapping[str, np.ndarray],
    colors: int = 0,
) -> np.ndarray:
    """Denoise a transient film, using two renders with half of the samples each.

    Pixels are mixed if their first hits are similar. Pixels that see an emitter, a mirror or clear
    glass are not mixed with other pixels. Neighboring bins are mixed in all pixels except pixels
    that see an emitter, which are returned unchanged. The sum over all bins and all pixels of one
    kind does not change. A pixel does not receive light in bins before the first light of its 3 x 3
    neighborhood. In bins that are much darker than their neighbors, the error can grow; see
    docs/denoising.md for numbers.

    Args:
        mean: Mean of the two films, finite, shape (height, width, bins, channels).
        half_difference: Half the difference of the two films; its sign does not matter.
        features: Features of the first hits by name: `position` [m], `normal` and `albedo` (0 to 1)
            of shape (height, width, 3), `distance` [m] and `kind`, one of `KINDS`, of shape
            (height, width).
        colors: Number of leading channels that determine the strength of the filter. The other
            channels are filtered with the same strength. The default 0 selects all channels, or the
            channels of S0 if the number of channels is 4 or 12.

    Returns:
        The filtered mean, float32 (height, width, bins, channels).

    Raises:
        ValueError: If the shapes of the arrays do not fit, or a number is not finite.

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
    # Check the arguments
    variants.require_vectorized()
    mean = checks.finite("mean", checks.real_array("mean", mean, np.float32))
    checks.shape("mean", mean, mean.ndim == 4 and mean.size, "(height, width, bins, channels)")
    noise = checks.real_array("half_difference", half_difference, np.float32)
    checks.shape("half_difference", noise, noise.shape == mean.shape, f"{mean.shape}, as mean's")
    checks.finite("half_difference", noise)
    height, width, bins, channels = mean.shape
    features = _checked(features, (height, width))
    checks.integer("colors", colors, 0, channels)
    colors = colors or (channels // 4 if channels in (4, 12) else channels)
    checks.require("colors", colors, channels % colors == 0, f"a divisor of {channels}")

    # Factor of each pixel and channel: the albedo, except for emitters
    kind = features["kind"].ravel()
    scale = np.ones((height * width, channels), np.float32)
    if channels % 3 == 0:
        albedo = np.maximum(features["albedo"].reshape(-1, 3), LEAST_ALBEDO)
        scale[:] = np.tile(albedo, channels // 3)
        scale[kind == KINDS["emitter"]] = 1

    # Divide by the albedo, and append the noise of the sum of channels as last channel
    cell = dr.arange(mi.UInt32, height * width * bins)
    light, difference, inverse = (mi.Float(np.ravel(each)) for each in (mean, noise, 1 / scale))
    values = []
    total = mi.Float(0)
    for channel in range(channels):
        factor = dr.gather(mi.Float, inverse, cell // bins * channels + channel)
        values.append(dr.gather(mi.Float, light, cell * channels + channel) * factor)
        if channel < colors:
            total += dr.gather(mi.Float, difference, cell * channels + channel) * factor
    film = Packets.of(dr.width(cell), cell, [*values, total])

    # Filter the film
    before = film.totals(bins)[:, :channels]
    reached = _reached_bins(np.any(mean != 0, axis=-1))
    film = _remove_noise(film, Blocks(height, width, bins), features, colors, reached)
    after = film.totals(bins)[:, :channels]

    # Preserve the sum of the pixels of each kind
    for selected in (kind == each for each in np.unique(kind)):
        sum_before, sum_after = (
            np.sum((scale * each)[selected, :colors], axis=0, dtype=np.float64)
            for each in (before, after)
        )
        factor = np.divide(sum_before, sum_after, out=np.ones(colors), where=sum_after > 0)
        scale[selected] *= np.tile(factor, channels // colors)

    # Multiply by the albedo
    scales = mi.Float(np.ravel(scale))
    result = dr.empty(mi.Float, mean.size)
    for channel, value in enumerate(film.at(cell)[:channels]):
        factor = dr.gather(mi.Float, scales, cell // bins * channels + channel)
        target = cell * channels + channel
        dr.scatter(result, value * factor, target, mode=dr.ReduceMode.Permute)
    return np.array(result).reshape(mean.shape)


def _reached_bins(lit: np.ndarray) -> np.ndarray:
    """Find the bins of each pixel that are not before the first light of its 3 x 3 neighborhood.

    Args:
        lit: Whether a bin contains light, bool (height, width, bins).

    Returns:
        A bool array of the same shape. The filter does not move light into the other bins.
    """
    bins = lit.shape[-1]
    first = np.where(lit.any(axis=-1), lit.argmax(axis=-1), bins)
    earliest = minimum_filter(first, 3, mode="nearest")
    return np.arange(bins) >= earliest[..., None]


def _remove_noise(
    film: Packets,
    blocks: Blocks,
    features: Mapping[str, np.ndarray],
    colors: int,
    reached: np.ndarray,
) -> Packets:
    """Subtract the residual of each stage, with a gain per block that is small if it is light.

    Args:
        film: The film; its last channel is the noise.
        blocks: Blocks of the film.
        features: Features of the first hits.
        colors: Number of channels that determine the gains.
        reached: Bins that exchange light, bool (height, width, bins). Other bins do not change.

    Returns:
        The filtered film.
    """
    height, width, bins = blocks.size
    cells = dr.arange(mi.UInt32, height * width * bins)
    pixel = cells // bins
    channels = film.at(cells)
    original = _sum(channels, colors)
    noise = channels[-1]
    dr.eval(original, noise)
    exchanging = mi.Bool(reached.ravel())
    emitter = mi.Bool(features["kind"].ravel() == KINDS["emitter"])

    # Weight blocks by their inverse variance, so that a firefly does not determine the gains of
    # its neighbors. Much noisier blocks do not exchange light with their neighbors.
    y, x, t, inside = blocks.lanes()
    cell = (y * width + x) * bins + t
    (variance,) = blocks.sums(dr.square(dr.gather(mi.Float, noise, cell, inside)))
    if not variance.any():
        return film
    weight = 1 / np.maximum(uniform_filter(variance, POOL, mode="nearest"), QUIET * variance.max())
    ways = mi.UInt32(np.ravel(kernels.open_ways(_is_like_neighbors(variance))))

    for axis, step in STAGES:
        if axis == "bins":
            taps = kernels.over_bins(blocks, step)
        else:
            taps = kernels.over_pixels(blocks, step, kernels.pixel_weights(features, step), ways)

        # Compute the residuals r of all channels
        here = film.at(cell, inside)
        open_here = dr.gather(mi.Bool, exchanging, cell, inside)
        residuals = [mi.Float(0) for _ in here]
        for other, tap, there in taps:
            there &= open_here & dr.gather(mi.Bool, exchanging, other, there)
            tap &= there
            for channel, value in enumerate(film.at(other, there)):
                residuals[channel] += tap * (here[channel] - value)
        stored = Packets.of(film.cells, cell, residuals, inside)

        # Sum <x - M, r> + <D, Q F D> and <r, r> over blocks and their neighbors
        light = _sum(residuals, colors)
        excess = (_sum(here, colors) - dr.gather(mi.Float, original, cell, inside)) * light
        excess += dr.gather(mi.Float, noise, cell, inside) * residuals[-1]
        excess, power = (
            uniform_filter(weight * each, POOL, mode="constant")
            for each in blocks.sums(excess, dr.square(light))
        )
        signal = 1 - np.divide(excess, power, out=np.zeros_like(power), where=power > 0)

        # Subtract the residuals of blocks where most of the residual is noise
        gains = np.clip(1 - MARGIN * np.maximum(signal, 0), 0, 1)
        if not gains.any():
            continue
        block = blocks.of(pixel // width, pixel % width, cells % bins)
        gain = dr.gather(mi.Float, mi.Float(np.ravel(gains).astype(np.float32)), block)
        gain &= ~dr.gather(mi.Bool, emitter, pixel)
        pairs = zip(film.at(cells), stored.at(cells), strict=True)
        film = Packets.of(film.cells, cells, [value - gain * each for value, each in pairs])
    return film


def _sum(values: Sequence[mi.Float], colors: int) -> mi.Float:
    """Return the sum of the leading channels."""
    return sum(values[1:colors], values[0])


def _is_like_neighbors(variance: np.ndarray) -> np.ndarray:
    """Return whether each block's variance is at most `NOISIER` times each neighbor's."""
    steady = uniform_filter(variance, (1, 1, POOL), mode="nearest")
    return steady <= NOISIER * minimum_filter(steady, (POOL, POOL, 1), mode="nearest")


def _checked(features: Mapping[str, np.ndarray], size: tuple[int, int]) -> dict[str, np.ndarray]:
    """Return the features as float32 arrays. Raise an error for missing or wrong features."""
    complete = isinstance(features, Mapping) and not set(FEATURES) - set(features)
    checks.require("features", features, complete, f"a dict of {', '.join(FEATURES)}")
    arrays = {}
    for name, channels in FEATURES.items():
        array = arrays[name] = checks.real_array(f"features: {name}", features[name], np.float32)
        shape = size if channels == 1 else (*size, channels)
        checks.shape(f"features: {name}", array, array.shape == shape, f"{shape}, as the film")
        checks.finite(f"features: {name}", array)
    return arrays
