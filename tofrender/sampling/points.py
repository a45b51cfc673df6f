"""Point sets in the unit square, the input of warps.

    independent   independent points, with gaps and clusters
    grid          the centers of equal cells, without gaps but with a regular pattern
    stratified    one random point in each of these cells, without gaps and without a pattern

Any number of points is supported. The cells form round(sqrt(count)) rows. If `count` is not a
multiple of the number of rows, the first rows have one more cell and are higher, so that all cells
have the area 1 / count. Square numbers give a square grid.

Source: M. Pharr, W. Jakob and G. Humphreys, "Physically Based Rendering", 4th edition, sections
2.2.1 and 8.5 (stratified sampling).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from ..runtime import checks

# Largest integer range that single precision represents exactly
MAX_COUNT = 1 << 24


def independent(count: int, seed: int = 0) -> mi.Point2f:
    """Sample independent uniform points in [0, 1)^2.

    Args:
        count: Number of points, from 1 to 2^24.
        seed: Seed of the random numbers, from 0 to 2^32 - 1.

    Example:
        >>> dr.width(independent(10))
        10
    """
    checks.integer("count", count, 1, MAX_COUNT)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(checks.integer("seed", seed, 0, checks.MAX_SEED), count)
    return sampler.next_2d()


def grid(count: int) -> mi.Point2f:
    """Return the centers of `count` cells of equal area, row by row.

    Example:
        >>> grid(4)
        [[0.25, 0.25],
         [0.75, 0.25],
         [0.25, 0.75],
         [0.75, 0.75]]
    """
    return _in_cells(count, mi.Point2f(0.5))


def stratified(count: int, seed: int = 0) -> mi.Point2f:
    """Sample a uniform point in each of `count` cells of equal area, row by row (jittering).

    Example:
        >>> p = stratified(4)
        >>> [int(i) for i in 2 * p.x], [int(i) for i in 2 * p.y]
        ([0, 1, 0, 1], [0, 0, 1, 1])
    """
    return _in_cells(count, independent(count, seed))


POINT_SETS: dict[str, Callable[[int, int], Any]] = {
    "independent": independent,
    "grid": lambda count, seed: grid(count),
    "stratified": stratified,
}
"""Point sets by name, called with count and seed."""


def point_set(kind: str, count: int, seed: int = 0) -> mi.Point2f:
    """Return a point set by name.

    Args:
        kind: "independent", "grid" or "stratified".
        count: Number of points, from 1 to 2^24.
        seed: Seed of the random numbers, from 0 to 2^32 - 1.

    Raises:
        ValueError: The name is unknown, or a number is out of range.

    Example:
        >>> point_set("gird", 4)
        Traceback (most recent call last):
        ValueError: kind = 'gird': did you mean 'grid'? Must be one of independent, grid, stratified
    """
    return POINT_SETS[checks.one_of("kind", kind, POINT_SETS)](count, seed)


def _in_cells(count: int, offset: mi.Point2f) -> mi.Point2f:
    """Return one point per cell, at the relative position `offset` in [0, 1)^2 in its cell."""
    # Number of cells in a short row, and number of rows with one more cell
    rows = round(checks.integer("count", count, 1, MAX_COUNT) ** 0.5)
    short, longer = divmod(count, rows)

    # Find row and column of each cell
    i = dr.arange(mi.UInt32, count)
    rest = dr.maximum(mi.Int32(i) - longer * (short + 1), 0)
    in_longer = i < longer * (short + 1)
    cells = dr.select(in_longer, mi.UInt32(short + 1), mi.UInt32(short))
    column = dr.select(in_longer, i % (short + 1), mi.UInt32(rest) % short)

    # Scale the position to the cell
    x = (mi.Float(column) + offset.x) / mi.Float(cells)
    y = (mi.Float(i - column) + mi.Float(cells) * offset.y) / count
    return dr.minimum(mi.Point2f(x, y), dr.one_minus_epsilon(mi.Float))
