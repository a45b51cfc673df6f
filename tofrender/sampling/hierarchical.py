"""Sampling in proportion to an image by hierarchical warping, also for environment maps.

Source: P. Clarberg, W. Jarosz, T. Akenine-Möller and H. W. Jensen, "Wavelet Importance Sampling",
ACM Transactions on Graphics 24(3), 2005, section 4.
"""

from __future__ import annotations

import math
import os
import warnings

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..signals.color import luminance
from .images import latitude_longitude_weights, power_of_two, read_image, resized
from .warps import unit_square


class HierarchicalWarp:
    """Points on the unit square that are distributed like the luminance of an image.

    A warp belongs to the Mitsuba variant that is active when the warp is created.

    **Orientation.** x increases to the right over columns, y increases downwards over rows. Texel
    (i, j) is column i of row j, and covers [i/n, (i+1)/n) x [j/n, (j+1)/n). The density is constant
    within a texel.

    **Algorithm.** The image is summed over blocks of 2 x 2 texels until one number is left (a mip
    map). `sample` descends this pyramid. In each of the M levels of a 2^M x 2^M image, y selects
    the upper or the lower half of the block, in proportion to their sums. Then x selects one of the
    two quadrants of this half. The remainders of y and x are rescaled to [0, 1) and continue within
    the quadrant. In the last level, they are the position within the texel.

    **Precision.** Sums are computed in double precision, and the pyramid stores conditional
    probabilities, so that small values next to large values are not lost. A texel with the value 0
    is never sampled. Each decision consumes bits of x or y. Let q_x and q_y be the products of the
    horizontal and of the vertical decisions for a texel. With the 24 bits of Mitsuba's samplers,
    the probability q_x q_y of this texel has the relative error 2^-24 (1/q_x + 1/q_y), and its
    points have 2^24 q_x by 2^24 q_y positions. A texel may be missed if its probability is below
    2^-24 within its row or column of blocks. The resulting bias of an estimate is at most the
    contribution of this texel.

    Args:
        image: A path (EXR, or another format that Mitsuba reads), an `mi.Bitmap`, or an array of
            shape (H, W) or (H, W, C), linear. An image that is not 2^M x 2^M is resized, with a
            warning, to the next such grid with at least as many rows and columns. Each texel is the
            mean over its area, so that the integral is preserved.

    Attributes:
        size: Number n = 2^M of texels along a side.
        levels: Number M of levels.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The image has another shape, is empty, too large or black, or has a value that
            is negative or not finite.

    Example:
        >>> warp = HierarchicalWarp([[4.0, 4.0], [1.0, 1.0]])
        >>> p = warp.sample(mi.Point2f(0.25, 0.4))
        >>> print(p, warp.pdf(p))
        [[0.25, 0.25]] [1.6]
    """

    def __init__(self, image: str | os.PathLike | mi.Bitmap | np.ndarray) -> None:
        weights = luminance(read_image(image))
        height, width = weights.shape
        self.size = power_of_two(max(height, width))
        self.levels = self.size.bit_length() - 1
        if (height, width) != (self.size, self.size):
            # Resize the image
            to = f"resized to {self.size} x {self.size}, a square power of two"
            warnings.warn(f"image: {height} x {width} pixels; {to}", UserWarning, stacklevel=2)
            weights = resized(weights, self.size)

        # Divide by the largest value first, because the sum could overflow
        weights = weights / weights.max()
        self._density = mi.Float((weights * (self.size**2 / weights.sum())).ravel())
        self._decisions = mi.Float(_decisions(weights))

    def sample(self, sample: mi.Point2f) -> mi.Point2f:
        """Warp uniform points of the unit square to points in [0, 1)^2 with the density `pdf`.

        In debug mode, a point outside the unit square raises an AssertionError.
        """
        below_1 = dr.one_minus_epsilon(mi.Float)
        sample = unit_square(sample)
        x, y = (dr.clip(each, 0, below_1) for each in (sample.x, sample.y))
        column = mi.UInt32(0)
        row = mi.UInt32(0)

        # Index of the first decision of the level
        first = 0
        for level in range(self.levels):
            # Select the upper or lower half of the block, then the left or right quadrant
            blocks = 4**level
            block = first + row * 2**level + column
            y, lower = _decide(y, dr.gather(mi.Float, self._decisions, block))
            row = 2 * row + lower
            half = first + blocks + row * 2**level + column
            x, right = _decide(x, dr.gather(mi.Float, self._decisions, half))
            column = 2 * column + right
            first += 3 * blocks
        return mi.Point2f(_within(column, x), _within(row, y)) / self.size

    def pdf(self, p: mi.Point2f) -> mi.Float:
        """Return the density of `sample` per unit area at points `p`, 0 outside the unit square.

        At the right and lower edge of the square, it is the density of the last column and row.
        """
        inside = (p.x >= 0) & (p.x <= 1) & (p.y >= 0) & (p.y <= 1)
        column, row = self.texel(p)
        return dr.gather(mi.Float, self._density, row * self.size + column, inside)

    def texel(self, p: mi.Point2f) -> tuple[mi.UInt32, mi.UInt32]:
        """Return column and row of the texel that contains `p`, or of the nearest texel."""
        last = self.size - 1
        column, row = (mi.UInt32(dr.clip(each * self.size, 0, last)) for each in (p.x, p.y))
        return column, row

    def __repr__(self) -> str:
        """Return the size as text."""
        return f"HierarchicalWarp({self.size} x {self.size})"


class EnvironmentWarp:
    """Directions that are distributed like the radiance of a latitude-longitude environment map.

    An environment belongs to the Mitsuba variant that is active when the environment is created.

    Directions correspond to pixels as in Mitsuba's `envmap` without `to_world`: +y is up,
    u = atan2(x, -z) / (2 pi) increases over columns, and v = acos(y) / pi increases downwards over
    rows. The image is interpolated linearly.

    Directions are divided into n x n texels with equal steps in u and v. n is the next power of two
    that is not smaller than the sides of the image. The probability of a texel is proportional to
    the integral of luminance over its solid angle. Within a texel, the density per solid angle is
    constant. Therefore the density is finite at the poles, and positive for all directions with
    light.

    Args:
        image: As for `HierarchicalWarp`, with at least 2 columns and 3 rows. Each such size is
            integrated exactly, without a warning.

    Attributes:
        warp: The `HierarchicalWarp` of the probabilities of the texels.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: As for `HierarchicalWarp`, or the image is too small, or a spectral variant is
            active.

    Example:
        >>> sky = np.ones((4, 8))
        >>> sky[0] = 5  # Brighter at the zenith
        >>> light = EnvironmentWarp(sky)
        >>> d, pdf = light.sample(mi.Point2f(0.5, 0.1))
        >>> d.y > 0.5, dr.abs(light.pdf(d) - pdf) < 1e-6, light.eval(d).x > 1
        ([True], [True], [True])
    """

    def __init__(self, image: str | os.PathLike | mi.Bitmap | np.ndarray) -> None:
        checks.require("variant", mi.variant(), not mi.is_spectral, "an rgb or mono variant")
        values = read_image(image)
        height, width = values.shape[:2]
        if height < 3 or width < 2:
            raise ValueError(f"image: {height} x {width} pixels; must be at least 3 x 2")

        # Integrate luminance over the texels
        weights = latitude_longitude_weights(luminance(values), power_of_two(max(height, width)))
        self.warp = HierarchicalWarp(weights)

        # Store the radiance. An additional column at both ends wraps u. Hardware textures would
        # round the interpolation weights
        if mi.is_monochromatic:
            values = luminance(values)[..., None]
        self._shape = height, width
        wrapped = mi.TensorXf(np.pad(values, ((0, 0), (1, 1), (0, 0)), "wrap"))
        self._texture = mi.Texture2f(wrapped, use_accel=False)

    def sample(self, sample: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
        """Sample unit vectors towards the light, from points of the unit square.

        Returns:
            The directions, and their density [1/sr].
        """
        # Sample a texel and a position in it
        n = self.warp.size
        p = self.warp.sample(sample)
        _, row = self.warp.texel(p)
        fraction = p.y * n - row

        # Mirror southern rows to the north, where t = sin^2(theta / 2) is small and exact
        south = 2 * row >= n
        row_n = dr.select(south, n - 1 - row, row)
        fraction = dr.select(south, 1 - fraction, fraction)

        # A solid angle is 2 dt dphi. Therefore t is uniform between the edges of a row
        t = dr.square(dr.sin(row_n * (0.5 * math.pi / n))) + fraction * self._step(row_n)
        cos_theta = 1 - 2 * t
        sin_theta = 2 * dr.safe_sqrt(t * (1 - t))
        sin_phi, cos_phi = dr.sincos(2 * math.pi * p.x)
        y = dr.select(south, -cos_theta, cos_theta)
        return mi.Vector3f(sin_phi * sin_theta, y, -cos_phi * sin_theta), self._pdf(p)

    def pdf(self, direction: mi.Vector3f) -> mi.Float:
        """Return the density of `sample` in a direction [1/sr]."""
        return self._pdf(self._uv(direction))

    def eval(self, direction: mi.Vector3f) -> mi.UnpolarizedSpectrum:
        """Return the radiance from a direction, in the unit of the image."""
        uv = self._uv(direction)
        height, width = self._shape
        p = mi.Point2f((uv.x * width + 1) / (width + 2), (uv.y * (height - 1) + 0.5) / height)
        return mi.UnpolarizedSpectrum(*self._texture.eval(p))

    def _pdf(self, uv: mi.Point2f) -> mi.Float:
        """Return the density [1/sr]: a texel's probability over its solid angle (4 pi / n) step."""
        _, row = self.warp.texel(uv)
        return self.warp.pdf(uv) / (4 * math.pi * self.warp.size * self._step(row))

    def _step(self, row: mi.UInt32) -> mi.Float:
        """Return the difference of sin^2(theta / 2) over a row, as sin(a + b) sin(a - b).

        This form has no cancellation.
        """
        n = self.warp.size
        return dr.sin((row + 0.5) * (math.pi / n)) * math.sin(0.5 * math.pi / n)

    @staticmethod
    def _uv(direction: mi.Vector3f) -> mi.Point2f:
        """Return the image coordinates of a direction."""
        u = dr.atan2(direction.x, -direction.z) / (2 * math.pi)
        v = dr.atan2(dr.hypot(direction.x, direction.z), direction.y) / math.pi
        return mi.Point2f(u - dr.floor(u), v)

    def __repr__(self) -> str:
        """Return the size of the image as text."""
        return f"EnvironmentWarp({self._shape[0]} x {self._shape[1]})"


def _decisions(weights: np.ndarray) -> np.ndarray:
    """Return the probability of the upper half of each block, and of the left part of each half.

    Levels of 2^l x 2^l blocks are ordered from coarse to fine. Each level is stored row by row,
    first the decisions on halves, then the decisions on quadrants.
    """
    levels = []
    while weights.size > 1:
        halves = weights[:, 0::2] + weights[:, 1::2]
        blocks = halves[0::2] + halves[1::2]
        levels = [_ratio(halves[0::2], blocks), _ratio(weights[:, 0::2], halves), *levels]
        weights = blocks
    return np.concatenate([level.ravel() for level in levels]) if levels else np.zeros(1)


def _ratio(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return part / whole, or 0 if both are 0. Such a decision is never reached."""
    return np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)


def _decide(u: mi.Float, p: mi.Float) -> tuple[mi.Float, mi.UInt32]:
    """Choose 0 with the probability `p`, otherwise 1, and rescale the remainder of `u` to [0, 1).

    Returns:
        The remainder, and the choice.
    """
    second = u >= p
    remainder = dr.select(second, (u - p) / (1 - p), u / p)
    return dr.minimum(remainder, dr.one_minus_epsilon(mi.Float)), dr.select(second, mi.UInt32(1), 0)


def _within(index: mi.UInt32, u: mi.Float) -> mi.Float:
    """Return index + u, rounded down where rounding up would give the next index."""
    return dr.minimum(index + u, (index + 1) * dr.one_minus_epsilon(mi.Float))
