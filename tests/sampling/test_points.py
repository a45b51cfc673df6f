"""Point sets: in the unit square, one in each cell, as many as asked for."""

from __future__ import annotations

import numpy as np
import pytest

import tofrender
from tofrender.sampling.domains import to_numpy
from tofrender.sampling.points import POINT_SETS, grid, independent, point_set, stratified

COUNTS = [1, 2, 3, 7, 16, 97, 1000, 4096]


def cells(count: int) -> list[tuple[float, float, float, float]]:
    """(left, right, low, high) of every cell, row after row, as the module's text has them."""
    rows = round(count**0.5)
    result, done = [], 0
    for row in range(rows):
        n = count // rows + (row < count % rows)
        result += [(k / n, (k + 1) / n, done / count, (done + n) / count) for k in range(n)]
        done += n
    assert done == count
    return result


@pytest.mark.parametrize("count", COUNTS)
def test_cells_have_equal_area(count):
    areas = [(right - left) * (high - low) for left, right, low, high in cells(count)]
    assert areas == pytest.approx([1 / count] * count)


@pytest.mark.parametrize("count", COUNTS)
def test_grid_has_the_centres(count):
    points = to_numpy(grid(count), count).T
    for point, (left, right, low, high) in zip(points, cells(count), strict=True):
        assert point == pytest.approx([(left + right) / 2, (low + high) / 2], abs=1e-6)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("seed", [0, 5])
def test_stratified_has_one_in_each_cell(count, seed):
    points = to_numpy(stratified(count, seed), count).T
    for (x, y), (left, right, low, high) in zip(points, cells(count), strict=True):
        assert left - 1e-6 <= x <= right + 1e-6
        assert low - 1e-6 <= y <= high + 1e-6


@pytest.mark.parametrize("kind", POINT_SETS)
@pytest.mark.parametrize("count", [1, 1000, 300_001])
def test_in_the_unit_square(kind, count):
    points = to_numpy(point_set(kind, count, 3), count)
    assert points.shape == (2, count)
    assert points.min() >= 0
    assert points.max() < 1
    again = to_numpy(point_set(kind, count, 3), count)
    assert np.array_equal(points, again)


@pytest.mark.parametrize("draw", [independent, stratified])
def test_seeds_differ(draw):
    assert not np.array_equal(to_numpy(draw(64, 1), 64), to_numpy(draw(64, 2), 64))


@pytest.mark.statistical
@pytest.mark.parametrize("draw", [independent, stratified])
@pytest.mark.parametrize("count", [4096, 5000])
def test_mean_is_unbiased(draw, count):
    """Mean of x y over 50 seeds: 1/4, within five standard errors of independent points."""
    means = [np.prod(to_numpy(draw(count, seed), count), axis=0).mean() for seed in range(50)]
    error = np.sqrt((1 / 9 - 1 / 16) / (50 * count))
    assert np.mean(means) == pytest.approx(1 / 4, abs=5 * error)


def test_stratified_has_less_noise():
    """The variance of the mean of x y, by more than a hundred for 4096 points."""
    variance = {
        draw.__name__: np.var(
            [np.prod(to_numpy(draw(4096, seed), 4096), axis=0).mean() for seed in range(50)]
        )
        for draw in (independent, stratified)
    }
    assert variance["stratified"] < 0.01 * variance["independent"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: grid(0), "count = 0: must be an integer from 1 to 16777216"),
        (lambda: independent(-1), "count = -1: must be an integer from 1 to"),
        (lambda: stratified(2.5), "count = 2.5: must be an integer from 1 to"),
        (lambda: stratified(4, -1), "seed = -1: must be an integer from 0 to"),
        (lambda: point_set("sobol", 4), "kind = 'sobol': must be one of independent, grid"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_public_names():
    assert tofrender.sampling.grid is grid
    assert "stratified" in dir(tofrender.sampling)
    with pytest.raises(AttributeError, match="has no attribute 'halton'"):
        _ = tofrender.sampling.halton
