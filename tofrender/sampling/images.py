"""Images as densities: reading images, and integrating them over the texels of other grids."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from ..runtime import checks

# Largest number of pixels along a side. A pyramid of 2^14 x 2^14 texels needs 3 GB
MAX_SIDE = 16384


def read_image(image: Any) -> np.ndarray:
    """Return the linear values of an image, float64 of shape (H, W, 1) or (H, W, 3).

    Alpha channels are dropped, and files are converted to linear values.

    Args:
        image: An image as for `HierarchicalWarp`, which lists the errors. It has 1 to 4 channels:
            gray, gray and alpha, RGB, or RGB and alpha.
    """
    named = "image"
    # Load a file
    if isinstance(image, str | os.PathLike):
        named = f"image = {checks.quote(os.fspath(image))}"
        path = checks.path("image", image)
        if not path.is_file():
            raise FileNotFoundError(f"{named}: must be a file that exists")
        try:
            image = mi.Bitmap(str(path))
        except RuntimeError:
            raise ValueError(f"{named}: must be an image that Mitsuba reads, such as EXR") from None

    # Convert to an array of one or three channels
    if isinstance(image, mi.Bitmap):
        image = _linear(image, named)
    values = _as_array(image, named)
    values = values[..., :1] if values.shape[-1] < 3 else values[..., :3]

    # Check the values
    bad = ~np.isfinite(values) | (values < 0)
    if bad.any():
        y, x, _ = np.argwhere(bad)[0]
        raise ValueError(
            f"{named}: the value at row {y}, column {x} is {values[bad][0]:g}; must be finite and "
            "0 or more"
        )
    if not values.any():
        raise ValueError(f"{named}: all pixels are 0; at least one must be above 0")
    return values


def power_of_two(size: int) -> int:
    """Return the smallest power of two that is at least `size`."""
    return 1 << (size - 1).bit_length()


def resized(image: np.ndarray, n: int) -> np.ndarray:
    """Average an image of constant pixels, shape (H, W), over each texel of an n x n grid.

    Image and grid cover the unit square. The integral over the square is preserved. A texel is 0 if
    and only if all pixels that it touches are 0.

    Example:
        >>> resized(np.array([[3.0, 0.0, 6.0]]), 2).tolist()
        [[2.0, 4.0], [2.0, 4.0]]
    """
    # Average rows, then columns, which are rows of the transpose
    for _ in range(2):
        cut = _Cuts(n, image.shape[0], 0)
        parts = image[cut.below] * (n * (cut.stop - cut.start))[:, None]
        image = np.add.reduceat(parts, cut.first, axis=0).T
    return image


def latitude_longitude_weights(image: np.ndarray, n: int) -> np.ndarray:
    r"""Integrate a latitude-longitude image, shape (H, W), over each texel of an n x n grid.

    The image is interpolated linearly as in Mitsuba's `envmap`: pixel centers are at u = (i+1/2)/W
    with wrapping, and v = j/(H-1) with the first and the last row at the poles. The weight of texel
    (i, j) is \int\int L(u, v) sin(pi v) du dv. It is integrated with four Gauss points in each
    piece in which L is smooth, and is 0 if and only if L is 0.
    """
    height, width = image.shape
    rows = _Cuts(n, height - 1, 0)
    columns = _Cuts(n, width, 1)

    # Integrate along v
    above = np.minimum(rows.below + 1, height - 1)
    image = rows.integrate(image, rows.below, above, lambda v: np.sin(np.pi * v)).T

    # Integrate along u, which wraps
    left = columns.below % width
    right = (columns.below + 1) % width
    return columns.integrate(image, left, right, np.ones_like).T


class _Cuts:
    """Pieces of [0, 1], cut at the edges of n equal cells and at samples (k + half / 2) / size."""

    def __init__(self, n: int, size: int, half: int) -> None:
        # All cuts are integer multiples of 1 / unit
        unit = 2 * size * n
        samples = n * (2 * np.arange(size) + half)
        cells = 2 * size * np.arange(n)
        cuts = np.union1d(samples, cells)

        # First piece of each cell, for `np.add.reduceat`
        self.first = np.searchsorted(cuts, cells)

        # Start and end of each piece
        self.start = cuts / unit
        self.stop = np.append(cuts[1:], unit) / unit

        # Last sample k at or before each piece, or -1
        self.below = (cuts - half * n) // (2 * n)
        self.size = size
        self.half = half

    def integrate(
        self, image: np.ndarray, before: np.ndarray, after: np.ndarray, weight: Callable[..., Any]
    ) -> np.ndarray:
        """Integrate `weight` times the image over each cell.

        Edges of cells and samples of the image cut [0, 1] into pieces. The function integrates each
        piece, and adds the integrals of the pieces of each cell.

        Args:
            image: The image (samples, columns).
            before: Index of the sample before each piece.
            after: Index of the sample after each piece. Between both, the image is linear.
            weight: Function of the position.

        Returns:
            The integrals (cells, columns).
        """
        # Gauss points in each piece
        nodes, factors = np.polynomial.legendre.leggauss(4)
        length = (self.stop - self.start)[:, None]
        x = self.start[:, None] + 0.5 * length * (nodes + 1)
        mass = 0.5 * length * factors * weight(x)

        # Interpolation weights of both samples
        s = np.clip(x * self.size - 0.5 * self.half - self.below[:, None], 0, 1)
        low, high = ((mass * each).sum(axis=1, keepdims=True) for each in (1 - s, s))
        return np.add.reduceat(image[before] * low + image[after] * high, self.first, axis=0)


def _linear(bitmap: mi.Bitmap, named: str) -> np.ndarray:
    """Convert a bitmap to linear values, gray or RGB."""
    formats = mi.Bitmap.PixelFormat
    gray = (formats.Y, formats.YA)
    color = (formats.RGB, formats.RGBA, formats.XYZ, formats.XYZA)
    if bitmap.pixel_format() not in (*gray, *color):
        count = bitmap.channel_count()
        raise ValueError(f"{named}: has {count} channels of other kinds; must be gray or RGB")
    target = formats.Y if bitmap.pixel_format() in gray else formats.RGB
    return np.array(bitmap.convert(target, mi.Struct.Type.Float32, srgb_gamma=False))


def _as_array(image: Any, named: str) -> np.ndarray:
    """Convert an image to float64 with the shape (H, W, C)."""
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
