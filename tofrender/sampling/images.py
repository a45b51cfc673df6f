"""Images as densities: reading them, and integrating them over the texels of other grids."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from ..runtime import checks

MAX_SIDE = 16384  # pixels along a side: the pyramid of 2^14 x 2^14 texels takes 3 GB


def read_image(image: Any) -> np.ndarray:
    """Return the linear values of an image, float64 of shape (H, W, 1) or (H, W, 3).

    `image` is one of those of `HierarchicalWarp`, which lists the errors. C is from 1 to 4: grey,
    grey and alpha, RGB, RGB and alpha. Alpha is dropped. Arrays are linear; files are made so.
    """
    named = "image"
    if isinstance(image, str | os.PathLike):
        named = f"image = {checks.quote(os.fspath(image))}"
        path = checks.path("image", image)
        if not path.is_file():
            raise FileNotFoundError(f"{named}: must be a file that exists")
        try:
            image = mi.Bitmap(str(path))
        except RuntimeError:
            raise ValueError(f"{named}: must be an image that Mitsuba reads, such as EXR") from None
    if isinstance(image, mi.Bitmap):
        image = _linear(image, named)
    values = _as_array(image, named)
    values = values[..., :1] if values.shape[-1] < 3 else values[..., :3]
    bad = ~np.isfinite(values) | (values < 0)
    if bad.any():
        y, x, _ = np.argwhere(bad)[0]
        found = f"{values[bad][0]:g} at row {y}, column {x}"
        raise ValueError(f"{named}: holds {found}; each value must be finite and 0 or more")
    if not values.any():
        raise ValueError(f"{named}: all pixels are 0; at least one must be above 0")
    return values


def power_of_two(size: int) -> int:
    """Smallest power of two that is at least `size`."""
    return 1 << (size - 1).bit_length()


def resized(image: np.ndarray, n: int) -> np.ndarray:
    """Average an image of constant pixels, shape (H, W), over each texel of an n x n grid.

    Both cover the unit square. The integral over the square stays as it was, and a texel is 0
    exactly if all pixels that it touches are.

    Example:
        >>> resized(np.array([[3.0, 0.0, 6.0]]), 2).tolist()
        [[2.0, 4.0], [2.0, 4.0]]
    """
    for _ in range(2):  # Rows; then columns, which are rows of the transpose
        cut = _Cuts(n, image.shape[0], 0)
        parts = image[cut.below] * (n * (cut.stop - cut.start))[:, None]
        image = np.add.reduceat(parts, cut.first, axis=0).T
    return image


def latitude_longitude_weights(image: np.ndarray, n: int) -> np.ndarray:
    r"""Integrate a latitude-longitude image, shape (H, W), over each texel of an n x n grid.

    The image is interpolated linearly as Mitsuba's `envmap` does: pixel centres at u = (i+1/2)/W
    with wrapping, v = j/(H-1) with the first and the last row at the poles. The weight of texel
    (i, j) is \int\int L(u, v) sin(pi v) du dv, by four Gauss points in every piece where L is
    smooth. It is 0 exactly where L is.
    """
    height, width = image.shape
    rows, columns = _Cuts(n, height - 1, 0), _Cuts(n, width, 1)
    above = np.minimum(rows.below + 1, height - 1)
    image = rows.integrate(image, rows.below, above, lambda v: np.sin(np.pi * v)).T
    left, right = columns.below % width, (columns.below + 1) % width
    return columns.integrate(image, left, right, np.ones_like).T


class _Cuts:
    """Pieces of [0, 1], cut at n equal cells and at samples (k + half / 2) / size."""

    def __init__(self, n: int, size: int, half: int) -> None:
        unit = 2 * size * n  # All cuts are whole multiples of 1 / unit
        samples = n * (2 * np.arange(size) + half)
        cells = 2 * size * np.arange(n)
        cuts = np.union1d(samples, cells)
        self.first = np.searchsorted(cuts, cells)  # piece of each cell, for `np.add.reduceat`
        self.start, self.stop = cuts / unit, np.append(cuts[1:], unit) / unit
        self.below = (cuts - half * n) // (2 * n)  # last sample k at or before each piece, or -1
        self.size, self.half = size, half

    def integrate(
        self, image: np.ndarray, before: np.ndarray, after: np.ndarray, weight: Callable[..., Any]
    ) -> np.ndarray:
        """Integral of `weight` times the image over each cell; linear between two rows a piece."""
        nodes, factors = np.polynomial.legendre.leggauss(4)
        length = (self.stop - self.start)[:, None]
        x = self.start[:, None] + 0.5 * length * (nodes + 1)
        mass = 0.5 * length * factors * weight(x)
        s = np.clip(x * self.size - 0.5 * self.half - self.below[:, None], 0, 1)
        low, high = ((mass * each).sum(axis=1, keepdims=True) for each in (1 - s, s))
        return np.add.reduceat(image[before] * low + image[after] * high, self.first, axis=0)


def _linear(bitmap: mi.Bitmap, named: str) -> np.ndarray:
    """Linear values, grey or RGB."""
    formats = mi.Bitmap.PixelFormat
    grey, colour = (formats.Y, formats.YA), (formats.RGB, formats.RGBA, formats.XYZ, formats.XYZA)
    if bitmap.pixel_format() not in (*grey, *colour):
        count = bitmap.channel_count()
        raise ValueError(f"{named}: has {count} channels of other kinds; must be grey or RGB")
    target = formats.Y if bitmap.pixel_format() in grey else formats.RGB
    return np.array(bitmap.convert(target, mi.Struct.Type.Float32, srgb_gamma=False))


def _as_array(image: Any, named: str) -> np.ndarray:
    """Values as float64 of shape (H, W, C)."""
    allowed = "must have the shape (height, width) or (height, width, 1 to 4 channels)"
    try:
        values = checks.real_array("", image, np.float64)
    except ValueError:
        kind = type(image).__name__
        raise ValueError(f"{named}: {kind}; must be a path, an mi.Bitmap or an array") from None
    if values.size == 0:
        raise ValueError(f"{named}: shape {values.shape} is empty; {allowed}")
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[-1] > 4:
        raise ValueError(f"{named}: shape {np.shape(image)}; {allowed}")
    if max(values.shape[:2]) > MAX_SIDE:
        raise ValueError(f"{named}: shape {values.shape}; a side must have at most {MAX_SIDE}")
    return values
