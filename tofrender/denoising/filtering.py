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

from collections.abc import Mapping

import numpy as np
from scipy.ndimage import minimum_filter, uniform_filter

from ..runtime import checks
from . import kernels
from .blocks import Blocks

STAGES = (("bins", 1), ("pixels", 1), ("bins", 2), ("pixels", 2))
"""Filters one after the other, with the distance of their taps."""

POOL = 3
"""Blocks along each axis over whose sums the products are added up."""

MARGIN = 5.0
"""Factor of the part of a residual that seems to be light, so that doubtful ones stay."""

NOISIER = 30.0
"""Ratio of variances above which a block keeps its light from its neighbours."""

LEAST_ALBEDO = np.float32(0.05)
"""Light of darker surfaces is divided by this."""

KINDS = {"scattering": 0, "emitter": 1, "specular": 2}
"""What a pixel sees first: the latter two if any of its rays does."""

FEATURES = {"position": 3, "normal": 3, "albedo": 3, "distance": 1, "kind": 1}
"""Features and their channels."""


def denoise_halves(
    first: np.ndarray, second: np.ndarray, features: Mapping[str, np.ndarray], colours: int = 0
) -> np.ndarray:
    """Remove noise from the mean of two halves of a transient film's samples.

    Pixels are mixed where their first hits are alike, never those that see an emitter, a mirror or
    clear glass; bins are mixed everywhere but in pixels that see an emitter, which stay as they
    are. Sums over the pixels of a kind and all bins stay.

    Args:
        first: Film of half of the samples, float (height, width, bins, channels), finite.
        second: Film of the other half, as many samples of the same camera.
        features: Arrays (height, width, 3) of `position` [m], `normal` and `albedo` (0 to 1) of the
            first hits, (height, width) of `distance` [m] and of `kind`, one of `KINDS`.
        colours: Channels of the intensity, which decide; the others are mixed as they are. By
            default all, or those of S0 if there are 4 or 12.

    Returns:
        The filtered mean, float32 (height, width, bins, channels). Exchanged halves give the same.

    Raises:
        ValueError: The arrays do not fit together, are not finite or equal; one line.

    Example:
        >>> rng, shape = np.random.default_rng(0), (16, 16, 32, 1)
        >>> flat = {name: np.ones((16, 16, 3)) for name in ("normal", "albedo")}
        >>> flat["position"] = np.dstack([*np.mgrid[:16, :16] / 160, np.ones((16, 16))])
        >>> flat |= {"distance": np.ones((16, 16)), "kind": np.zeros((16, 16))}
        >>> flat["normal"] = flat["normal"] * (0, 0, -1)
        >>> first, second = 1 + rng.normal(0, 0.1, (2, *shape))
        >>> filtered = denoise_halves(first, second, flat)
        >>> bool(filtered.std() < 0.4 * np.std((first + second) / 2))
        True
    """
    first, second = (np.asarray(half) for half in (first, second))
    checks.shape("first", first, first.ndim == 4 and first.size, "(height, width, bins, channels)")
    checks.shape("second", second, second.shape == first.shape, f"{first.shape}, as first has it")
    for name, half in (("first", first), ("second", second)):
        checks.finite(name, half)
    if first.any() and np.array_equal(first, second):
        raise ValueError("second: is equal to first; must be of other samples")
    mean = (0.5 * (first + second)).astype(np.float32)
    return filtered(mean, (0.5 * (first - second)).astype(np.float32), features, colours)


def filtered(
    mean: np.ndarray, noise: np.ndarray, features: Mapping[str, np.ndarray], colours: int = 0
) -> np.ndarray:
    """Filter the mean of two halves; `noise` is half their difference. See `denoise_halves`."""
    height, width, bins, channels = mean.shape
    features = check_features(features, (height, width))
    colours = colours or (channels // 4 if channels in (4, 12) else channels)
    albedo, kind = features["albedo"].reshape(-1, 3), features["kind"].ravel()
    scale = np.ones((height * width, channels), np.float32)
    if channels % 3 == 0:
        scale[:] = np.tile(np.maximum(albedo, LEAST_ALBEDO), channels // 3)
        scale[kind == KINDS["emitter"]] = 1
    blocks = Blocks(height, width, bins)

    # Channels first, divided by albedo; the last one is the noise of their sum
    values = np.empty((height * width, channels + 1, bins), np.float32)
    inverse = 1 / scale[:, :, None]
    for part in blocks.parts:
        mean_part, noise_part = (
            each.reshape(-1, bins, channels)[part].transpose(0, 2, 1) for each in (mean, noise)
        )
        np.multiply(mean_part, inverse[part], out=values[part, :channels])
        values[part, channels] = _sum(noise_part[:, :colours] * inverse[part, :colours], colours)
    before = values[:, :channels].sum(axis=-1)

    _remove_noise(values, colours, features, blocks)

    # Keep the sums of each kind
    after = values[:, :channels].sum(axis=-1)
    for own in (kind == each for each in np.unique(kind)):
        was, now = (
            np.sum((scale * each)[own, :colours], axis=0, dtype=np.float64)
            for each in (before, after)
        )
        factor = np.divide(was, now, out=np.ones(colours), where=now > 0)
        scale[own] *= np.tile(factor, channels // colours)
    values[:, :channels] *= scale[:, :, None]
    return values[:, :channels].transpose(0, 2, 1).reshape(mean.shape)


def _remove_noise(
    values: np.ndarray, colours: int, features: Mapping[str, np.ndarray], blocks: Blocks
) -> None:
    """Remove the stages' residuals, as far as they are noise, from values and their noise."""
    original, noise = _sum(values, colours), values[:, -1].copy()
    emitter = features["kind"].ravel() == KINDS["emitter"]
    variance = np.stack([blocks.sums(noise[p] ** 2, n) for n, p in enumerate(blocks.parts)])
    # A firefly must not decide for its neighbours
    weight = 1 / np.maximum(uniform_filter(variance, POOL, mode="nearest"), np.float32(1e-30))
    crossed = blocks.repeated(_is_like_neighbours(variance))
    for over, step in STAGES:
        if over == "bins":
            residuals_of = kernels.over_bins(step, blocks.parts)
        else:
            residuals_of = kernels.over_pixels(features, step, blocks.parts)
        residuals, sums = [], []
        for number, found in enumerate(residuals_of(values, crossed)):
            part, light = blocks.parts[number], _sum(found, colours)
            excess = _sum(values[part], colours)
            excess -= original[part]
            excess *= light
            excess += noise[part] * found[:, -1]
            light *= light
            sums.append([blocks.sums(each, number) for each in (excess, light)])
            residuals.append(found)
        excess, power = (
            uniform_filter(weight * np.stack(each), POOL, mode="constant")
            for each in zip(*sums, strict=True)
        )
        signal = 1 - np.divide(excess, power, out=np.zeros_like(power), where=power > 0)
        gains = blocks.interpolated(np.clip(1 - MARGIN * np.maximum(signal, 0), 0, 1))
        for gain, found, part in zip(gains, residuals, blocks.parts, strict=True):
            gain[emitter[part]] = 0
            found *= gain[:, None]
            values[part] -= found


def _is_like_neighbours(variance: np.ndarray) -> np.ndarray:
    """Whether blocks are not much noisier than any neighbour, whom their noise would reach."""
    steady = uniform_filter(variance, (1, 1, POOL), mode="nearest")
    return steady <= NOISIER * minimum_filter(steady, (POOL, POOL, 1), mode="nearest")


def _sum(values: np.ndarray, colours: int) -> np.ndarray:
    """Sum of the first channels of values (pixels, channels, bins)."""
    found = values[:, 0].copy()
    for channel in range(1, colours):
        found += values[:, channel]
    return found


def check_features(
    features: Mapping[str, np.ndarray], size: tuple[int, int]
) -> dict[str, np.ndarray]:
    """Refuse features that are incomplete, do not fit the film or are not finite."""
    checks.instance("features", features, Mapping, f"a dict of {', '.join(FEATURES)}")
    found = {}
    for name, channels in FEATURES.items():
        if name not in features:
            raise ValueError(f"features: has no {name}; must have {', '.join(FEATURES)}")
        array = np.asarray(features[name], dtype=np.float32)
        shape = size if channels == 1 else (*size, channels)
        checks.shape(f"features: {name}", array, array.shape == shape, f"{shape}, as the film")
        checks.finite(f"features: {name}", array)
        found[name] = array
    return found
