"""Tone mapping that survives sparse, unfinished and extreme data."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..rendering.cubes import Cube
from ..runtime import checks

_SAMPLES = 1 << 21


def auto_exposure(values: Any, *, percentile: float = 99.5) -> float:
    """The gain that shows the `percentile` of all light as white.

    Only finite values above zero count, so that dark bins and pixels do not matter. Of more than
    two million values a fixed random choice is used.

    Args:
        values: Linear values of any shape: one image or a whole sequence, also a `Cube`.
        percentile: In (0, 100].

    Returns:
        Gain, finite and above 0; 1 where there is no light.

    Raises:
        ValueError: The percentile is out of range.

    Example:
        >>> auto_exposure(np.full((2, 2, 3), 0.5))
        2.0
    """
    percentile = checks.number("percentile", percentile, positive=True, high=100)
    cube = Cube.of("values", values)
    size = math.prod(cube.shape)
    lit = np.zeros(0, cube.dtype)
    if size > _SAMPLES:
        lit = _lit(cube.take(np.random.default_rng(0).integers(0, size, _SAMPLES)))
    if lit.size < 1000:  # also for a large but nearly dark sequence
        lit = np.concatenate([lit[:0], *(_lit(piece) for _, piece in cube.pieces())])
    white = float(np.percentile(lit, percentile)) if lit.size else 1.0
    return 1 / white if math.isfinite(1 / white) else 1.0


def _lit(values: np.ndarray) -> np.ndarray:
    return values[(values > 0) & np.isfinite(values)]


def tonemap(values: Any, *, exposure: float | None = None, percentile: float = 99.5) -> np.ndarray:
    """Turn linear radiance into an sRGB picture.

    Args:
        values: Linear values, (height, width), (height, width, 1) or (height, width, 3). They are
            not changed. Negative values show as black, infinite ones as white, and pixels with a
            NaN (unfinished) as a dark grey hatch.
        exposure: Gain; `1` is shown as white after it. None takes `auto_exposure` of `values`;
            give one number for all frames of a sequence to keep them comparable.
        percentile: For `auto_exposure`, in (0, 100].

    Returns:
        uint8 (height, width, 3).

    Raises:
        ValueError: Another shape, or an exposure that is not a finite number above 0.

    Example:
        >>> tonemap(np.array([[0.0, 0.5, 1.0]]), exposure=1)[..., 0]
        array([[  0, 188, 255]], dtype=uint8)
    """
    linear = checks.real_array("values", values)
    if linear.ndim == 2:
        linear = linear[..., None]
    if linear.ndim != 3 or linear.shape[2] not in (1, 3):
        raise ValueError(
            f"values with shape {np.shape(values)}: must be (height, width) or "
            "(height, width, channels) with 1 or 3 channels"
        )
    if exposure is None:
        exposure = auto_exposure(linear, percentile=percentile)
    exposure = checks.number("exposure", exposure, positive=True)
    unfinished = np.isnan(linear).any(axis=2)
    with np.errstate(over="ignore"):
        shown = np.clip(np.nan_to_num(linear * np.float32(exposure), nan=0), 0, 1)
    srgb = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    picture = np.rint(255 * srgb).astype(np.uint8)
    picture = np.repeat(picture, 3, axis=2) if picture.shape[2] == 1 else picture
    if unfinished.any():
        rows, columns = np.nonzero(unfinished)
        picture[rows, columns] = np.where((rows + columns) % 8 < 4, 38, 58)[:, None]
    return picture
