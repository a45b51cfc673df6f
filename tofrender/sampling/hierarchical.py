"""Sampling in proportion to an image: hierarchical warping, and importance-sampled environments.

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
from ..signals.colour import luminance
from .images import latitude_longitude_weights, power_of_two, read_image, resized
from .warps import unit_square


class HierarchicalWarp:
    """Points on the unit square, distributed like the luminance of an image.

    A warp belongs to the Mitsuba variant that is active when it is made.

    **Orientation.** x runs to the right over columns, y runs down over rows: texel (i, j), column i
    of row j, covers [i/n, (i+1)/n) x [j/n, (j+1)/n). The density is constant within a texel.

    **Algorithm.** The image is summed over 2 x 2 blocks up to one number (a mip map). `sample` goes
    down again. In each of the M levels of a 2^M x 2^M image, the point's y selects the upper or
    the lower half of the block, in proportion to their sums, and its x then one of the two
    quadrants of that half. The rest of y and x, stretched to [0, 1), continues within the quadrant;
    within the texel it is the position.

    **Precision.** The sums are made in double precision, and the pyramid stores conditional
    probabilities, so that no small number is lost beside a large one. A texel that is 0 is never
    sampled. Each decision uses up bits of x or y: with the 24 bits of Mitsuba's samplers, a texel
    of probability q_x q_y (products of its horizontal and of its vertical decisions) is hit with
    that probability to a relative 2^-24 (1/q_x + 1/q_y), and has 2^24 q_x by 2^24 q_y positions.
    One below 2^-24 of its row or column of blocks may be missed, which biases an estimate by no
    more than the texel's part of it.

    Args:
        image: A path (EXR, or another format that Mitsuba reads), an `mi.Bitmap`, or an array of
            shape (H, W) or (H, W, C), linear. Images that are not 2^M x 2^M are resized, with a
            warning, to the next such grid that has at least as many rows and columns; each texel
            is the mean over its area, so that the integral stays.

    Attributes:
        size: n = 2^M, texels along a side.
        levels: M.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: Not an image, of another shape, empty, too large, all black, or with a value
            that is negative or not finite.

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
            to = f"resized to {self.size} x {self.size}, a square power of two"
            warnings.warn(f"image: {height} x {width} pixels; {to}", UserWarning, stacklevel=2)
            weights = resized(weights, self.size)
        weights = weights / weights.max()  # Their sum could overflow
        self._density = mi.Float((weights * (self.size**2 / weights.sum())).ravel())
        self._decisions = mi.Float(_decisions(weights))

    def sample(self, sample: mi.Point2f) -> mi.Point2f:
        """Warp uniform points of the unit square to points in [0, 1)^2 of the density `pdf`.

        In debug mode, a point outside of the unit square raises an AssertionError.
        """
        below_1 = dr.one_minus_epsilon(mi.Float)
        sample = unit_square(sample)
        x, y = (dr.clip(each, 0, below_1) for each in (sample.x, sample.y))
        column, row = mi.UInt32(0), mi.UInt32(0)
        first = 0  # Of the level's decisions
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
        """Density of `sample` per unit area at points `p`; 0 outside of the unit square.

        At the square's right and lower edge it is that of the last column and row.
        """
        inside = (p.x >= 0) & (p.x <= 1) & (p.y >= 0) & (p.y <= 1)
        column, row = self.texel(p)
        return dr.gather(mi.Float, self._density, row * self.size + column, inside)

    def texel(self, p: mi.Point2f) -> tuple[mi.UInt32, mi.UInt32]:
        """Column and row of the texel that holds `p`; the nearest one if `p` lies outside."""
        last = self.size - 1
        column, row = (mi.UInt32(dr.clip(each * self.size, 0, last)) for each in (p.x, p.y))
        return column, row

    def __repr__(self) -> str:
        """Size."""
        return f"HierarchicalWarp({self.size} x {self.size})"


class EnvironmentWarp:
    """Directions distributed like the radiance of an environment, given as a lat-long image.

    An environment belongs to the Mitsuba variant that is active when it is made.

    Directions and pixels correspond as in Mitsuba's `envmap` without `to_world`: +y is up,
    u = atan2(x, -z) / (2 pi) runs over columns, v = acos(y) / pi down over rows, and the image is
    interpolated linearly.

    The directions are divided into n x n texels of equal steps in u and v, n the next power of two
    that is no smaller than the image's sides. A texel's probability is proportional to the integral
    of luminance over its solid angle, and within it the density per solid angle is constant. So the
    density is finite at the poles, and positive wherever there is light.

    Args:
        image: As for `HierarchicalWarp`, at least 2 columns and 3 rows. Any such size is
            integrated exactly as it is, without a warning.

    Attributes:
        warp: The `HierarchicalWarp` of the texels' probabilities.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: As for `HierarchicalWarp`, or an image that is too small, or a spectral variant
            of Mitsuba.

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
        weights = latitude_longitude_weights(luminance(values), power_of_two(max(height, width)))
        self.warp = HierarchicalWarp(weights)
        if mi.is_monochromatic:
            values = luminance(values)[..., None]
        self._shape = height, width
        # A column beside each end lets u wrap; hardware textures would round the weights
        wrapped = mi.TensorXf(np.pad(values, ((0, 0), (1, 1), (0, 0)), "wrap"))
        self._texture = mi.Texture2f(wrapped, use_accel=False)

    def sample(self, sample: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
        """Unit vectors towards the light, from points of the unit square; their density [1/sr]."""
        n = self.warp.size
        p = self.warp.sample(sample)
        _, row = self.warp.texel(p)
        fraction = p.y * n - row
        # Southern rows mirror the northern ones, where t = sin^2(theta / 2) is small and exact
        south = 2 * row >= n
        row_n = dr.select(south, n - 1 - row, row)
        fraction = dr.select(south, 1 - fraction, fraction)
        # A solid angle is 2 dt dphi: t is uniform between the edges of a row
        t = dr.square(dr.sin(row_n * (0.5 * math.pi / n))) + fraction * self._step(row_n)
        cos_theta, sin_theta = 1 - 2 * t, 2 * dr.safe_sqrt(t * (1 - t))
        sin_phi, cos_phi = dr.sincos(2 * math.pi * p.x)
        y = dr.select(south, -cos_theta, cos_theta)
        return mi.Vector3f(sin_phi * sin_theta, y, -cos_phi * sin_theta), self._pdf(p)

    def pdf(self, direction: mi.Vector3f) -> mi.Float:
        """Density of `sample` at a direction [1/sr]."""
        return self._pdf(self._uv(direction))

    def eval(self, direction: mi.Vector3f) -> mi.UnpolarizedSpectrum:
        """Radiance from a direction, in the image's unit."""
        uv, (height, width) = self._uv(direction), self._shape
        p = mi.Point2f((uv.x * width + 1) / (width + 2), (uv.y * (height - 1) + 0.5) / height)
        return mi.UnpolarizedSpectrum(*self._texture.eval(p))

    def _pdf(self, uv: mi.Point2f) -> mi.Float:
        """Density [1/sr]: a texel's probability over its solid angle (4 pi / n) step."""
        _, row = self.warp.texel(uv)
        return self.warp.pdf(uv) / (4 * math.pi * self.warp.size * self._step(row))

    def _step(self, row: mi.UInt32) -> mi.Float:
        """Difference of sin^2(theta / 2) over a row, as sin(a + b) sin(a - b): nothing cancels."""
        n = self.warp.size
        return dr.sin((row + 0.5) * (math.pi / n)) * math.sin(0.5 * math.pi / n)

    @staticmethod
    def _uv(direction: mi.Vector3f) -> mi.Point2f:
        u = dr.atan2(direction.x, -direction.z) / (2 * math.pi)
        v = dr.atan2(dr.hypot(direction.x, direction.z), direction.y) / math.pi
        return mi.Point2f(u - dr.floor(u), v)

    def __repr__(self) -> str:
        """Size of the image."""
        return f"EnvironmentWarp({self._shape[0]} x {self._shape[1]})"


def _decisions(weights: np.ndarray) -> np.ndarray:
    """Probabilities of the upper half of each block, then of the left quadrant of each half.

    Levels of 2^l x 2^l blocks follow each other, coarse to fine; each is stored row by row.
    """
    levels = []
    while weights.size > 1:
        halves = weights[:, 0::2] + weights[:, 1::2]
        blocks = halves[0::2] + halves[1::2]
        levels = [_ratio(halves[0::2], blocks), _ratio(weights[:, 0::2], halves), *levels]
        weights = blocks
    return np.concatenate([level.ravel() for level in levels]) if levels else np.zeros(1)


def _ratio(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Quotient; 0 where both are 0, which no decision ever reaches."""
    return np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)


def _decide(u: mi.Float, p: mi.Float) -> tuple[mi.Float, mi.UInt32]:
    """Rest of `u`, stretched to [0, 1), and 0 with probability p, else 1."""
    second = u >= p
    rest = dr.select(second, (u - p) / (1 - p), u / p)
    return dr.minimum(rest, dr.one_minus_epsilon(mi.Float)), dr.select(second, mi.UInt32(1), 0)


def _within(index: mi.UInt32, u: mi.Float) -> mi.Float:
    """Sum, rounded down if it would round up to the next index."""
    return dr.minimum(index + u, (index + 1) * dr.one_minus_epsilon(mi.Float))
