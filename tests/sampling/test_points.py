"""Point sets are in the unit square, with one point in each cell, for any number of points."""

import numpy as np
import pytest

from tofrender.sampling.domains import to_numpy
from tofrender.sampling.points import POINT_SETS, grid, independent, point_set, stratified


def cells(count: int) -> list[tuple[float, float, float, float]]:
    """Return (left, right, low, high) of each cell, row by row, as documented in the module."""
    rows = round(count**0.5)
    result, done = [], 0
    for row in range(rows):
        n = count // rows + (row < count % rows)
        result += [(k / n, (k + 1) / n, done / count, (done + n) / count) for k in range(n)]
        done += n
    assert done == count
    return result


@pytest.mark.parametrize("count", [1, 2, 3, 7, 16, 97, 1000, 4096])
def test_one_point_in_each_cell(count):
    left, right, low, high = np.array(cells(count)).T
    centers = to_numpy(grid(count), count)
    assert centers == pytest.approx(np.array([left + right, low + high]) / 2, abs=1e-6)
    for seed in (0, 5):
        x, y = to_numpy(stratified(count, seed), count)
        assert np.all((left - 1e-6 <= x) & (x <= right + 1e-6))
        assert np.all((low - 1e-6 <= y) & (y <= high + 1e-6))


@pytest.mark.parametrize("kind", POINT_SETS)
@pytest.mark.parametrize("count", [1, 1000, 300_001])
def test_in_the_unit_square(kind, count):
    points = to_numpy(point_set(kind, count, 3), count)
    assert points.shape == (2, count)
    assert points.min() >= 0
    assert points.max() < 1
    again = to_numpy(point_set(kind, count, 3), count)
    assert np.array_equal(points, again)


def means(draw, count: int) -> list[float]:
    """Return means of x y for 50 seeds."""
    return [np.prod(to_numpy(draw(count, seed), count), axis=0).mean() for seed in range(50)]


@pytest.mark.statistical
@pytest.mark.parametrize("count", [4096, 5000])
def test_mean_is_unbiased_and_stratified_has_less_noise(count):
    """The mean is 1/4, within five standard errors of independent points."""
    error = np.sqrt((1 / 9 - 1 / 16) / (50 * count))
    variance = {}
    for draw in (independent, stratified):
        found = means(draw, count)
        assert np.mean(found) == pytest.approx(1 / 4, abs=5 * error), draw
        variance[draw] = np.var(found)
    assert 0 < variance[stratified] < 0.01 * variance[independent]
