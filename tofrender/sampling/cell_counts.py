"""Counts and integrals of the chi-square test: cells, expected counts, Pearson's statistic.

Half of the edges of the cells are spaced evenly. The other half are quantiles of a pilot run of the
sampler, so that narrow densities are resolved as well. Expected counts are integrals of the density
over the cells, estimated with jittered points. More points are used in cells with a large variance,
and in cells where samples met a much higher density than the points. The remaining variance is part
of the statistic. Cells that remain unresolved are counted as one cell. Therefore a density that is
hard to integrate makes the test weaker, but not wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from .domains import Domain, to_drjit
from .verdicts import Moment

# Number of strata along each side of a cell at first, with one point each
STRATA = 6

# Number of independent integrals of each cell. Their spread gives the variance
REPEATS = 8

# A cell is refined if the variance of its integral, relative to its count, is larger
POOR = 0.1

# Largest number of points in one refinement
MAX_POINTS = 1 << 21

# Smallest expected count for which Pearson's statistic follows its distribution
FEWEST = 5.0

# Relative difference of two moments that single precision explains
ROUNDING = 1e-6

MOMENTS = {2: ("x", "y", "xx", "xy", "yy"), 3: ("x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz")}
"""First and second moments in the plane and in space."""


@dataclass(frozen=True)
class Integrals:
    """Integrals of a density, and the variances of these estimates."""

    # Probability of each cell (rows, columns), and its variance
    cells: np.ndarray
    variance: np.ndarray

    # Mask of the cells with a small enough variance
    resolved: np.ndarray

    # Integrals of the density times each function (functions,), and their variance
    moments: np.ndarray
    moments_variance: np.ndarray

    # Integral over the domain, and its standard error
    total: float
    total_error: float

    # Smallest value of the density at any point
    lowest: float

    # Fraction of the points at which the density is NaN or infinite
    not_finite: float


def cell_edges(domain: Domain, pilot: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges of the columns and of the rows of cells.

    Edges are quantiles of a mixture of even points and the `pilot` points in the plane (2, n).
    Therefore a row or column contains at most twice its share of each kind of point.
    """
    counts = (max(2, round(resolution * domain.aspect)), resolution)
    edges = []
    for low, high, points, count in zip(domain.low, domain.high, pilot, counts, strict=True):
        even = np.linspace(low, high, max(points.size, 2))
        mixture = np.concatenate([even, np.clip(points, low, high)])
        edges.append(np.unique(np.quantile(mixture, np.linspace(0, 1, count + 1))))

    # Move the nearest edge to each discontinuity
    for value in domain.jumps:
        edges[1][np.argmin(np.abs(edges[1] - value))] = value
    return edges[0], edges[1]


def cell_of(edges: tuple[np.ndarray, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Return the index of the cell of each point (2, n), row by row. Upper edges are included."""
    a, b = (
        np.clip(np.searchsorted(each, p) - 1, 0, each.size - 2)
        for each, p in zip(edges, points, strict=True)
    )
    return b * (edges[0].size - 1) + a


def integrate(
    pdf: Callable[[Any], mi.Float],
    functions: Callable[[np.ndarray], np.ndarray],
    domain: Domain,
    edges: tuple[np.ndarray, np.ndarray],
    *,
    samples: int,
    highest: np.ndarray,
    seed: int,
) -> Integrals:
    """Integrate a density over each cell, and its product with functions over all cells.

    Args:
        pdf: The density.
        functions: Function that maps points (dimensions, n) to values (functions, n).
        domain: The domain.
        edges: Edges of the columns and of the rows.
        samples: Number of samples with which the integrals will be compared.
        highest: Largest density at a sample in each cell.
        seed: Seed of the random points.
    """
    # Low edge and size of each cell along both axes
    rng = np.random.default_rng(seed)
    columns, rows = (each.size - 1 for each in edges)
    count = rows * columns
    a, b = (np.stack([each[:-1], np.diff(each)]) for each in edges)
    cells = np.concatenate([np.tile(a, rows), np.repeat(b, columns, axis=1)])

    # Integrals so far, and the cells that remain
    mean = np.empty(0)
    variance = np.empty(0)
    lowest = np.inf
    bad = 0
    points = 0
    todo = np.arange(count)
    strata = STRATA
    while todo.size and todo.size * strata**2 <= max(MAX_POINTS, count * STRATA**2):
        # Integrate the cells that are not yet resolved, several times for the variance
        here = cells[:, todo]
        runs = [_jittered(pdf, functions, domain, here, strata, rng) for _ in range(REPEATS)]
        sums, tops, lows, bads = zip(*runs, strict=True)
        if not points:
            mean, variance = (np.empty((len(sums[0]), count)) for _ in range(2))
        mean[:, todo] = np.mean(sums, axis=0)
        variance[:, todo] = np.var(sums, axis=0, ddof=1) / REPEATS
        lowest = min(lowest, *lows)
        bad = bad + sum(bads)
        points += REPEATS * todo.size * strata**2

        # Refine cells with a large variance, or with a density that the points have missed
        expected = np.maximum(samples * mean[0, todo], FEWEST)
        poor = samples**2 * variance[0, todo] > POOR * expected
        todo = todo[poor | (highest[todo] > 2 * np.max(tops, axis=0))]
        strata *= 2

        # If it is not a density, more points do not help
        if bad or lowest < 0:
            break
    return Integrals(
        cells=mean[0].reshape(rows, columns),
        variance=variance[0].reshape(rows, columns),
        resolved=~np.isin(np.arange(count), todo).reshape(rows, columns),
        moments=mean[1:].sum(axis=1),
        moments_variance=variance[1:].sum(axis=1),
        total=float(mean[0].sum()),
        total_error=float(np.sqrt(variance[0].sum())),
        lowest=lowest,
        not_finite=bad / points,
    )


def _jittered(
    pdf: Callable[[Any], mi.Float],
    functions: Callable[[np.ndarray], np.ndarray],
    domain: Domain,
    cells: np.ndarray,
    strata: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Estimate integrals from one random point in each of strata^2 parts of each cell.

    Args:
        pdf: The density.
        functions: Function that maps points to values.
        domain: The domain.
        cells: Low edge and size along both axes of each cell, (4, cells).
        strata: Number of strata along each side of a cell.
        rng: Random numbers.

    Returns:
        Integrals of the density and of its products with the functions (1 + functions, cells), the
        highest density in each cell, the lowest density in all cells, and the number of values
        that are not finite.
    """
    # Place the points
    a0, da, b0, db = cells[:, :, None, None]
    shape = (cells.shape[1], strata, strata)
    steps = np.arange(strata)
    a = (a0 + da * ((rng.random(shape) + steps) / strata)).ravel()
    b = (b0 + db * ((rng.random(shape) + steps[:, None]) / strata)).ravel()
    plane = np.stack([a, b])
    points = domain.to_points(plane)

    # Evaluate the density
    density = np.broadcast_to(np.asarray(mi.Float(pdf(to_drjit(points))), np.float64), a.size)
    finite = np.isfinite(density)
    density = np.where(finite, density, 0.0)

    # Sum over each cell
    mass = density * domain.area(plane) * np.repeat(cells[1] * cells[3] / strata**2, strata**2)
    values = np.concatenate([mass[None], mass * functions(points)])
    sums = values.reshape(values.shape[0], -1, strata**2).sum(axis=-1)
    top = density.reshape(-1, strata**2).max(axis=1)
    return sums, top, float(density.min()), a.size - int(finite.sum())


def pearson(observed: np.ndarray, expected: np.ndarray, variance: np.ndarray) -> tuple[float, int]:
    """Return Pearson's statistic, sum of (O - E)^2 / (E + variance of E), and degrees of freedom.

    Cells with expected counts below `FEWEST` are pooled, in the order of their expected counts,
    until the pool reaches `FEWEST`. The total count is fixed, which costs one degree of freedom.

    Example:
        >>> pearson(np.array([12, 8]), np.array([10.0, 10.0]), np.zeros(2))
        (0.8, 1)
    """
    # Sort the cells by expected count
    order = np.argsort(expected, axis=None, kind="stable")
    o, e, v = (
        np.asarray(x, dtype=np.float64).ravel()[order] for x in (observed, expected, variance)
    )

    # Pool small cells. A step of 2 FEWEST in the running sum contains at least FEWEST, because no
    # cell adds more than FEWEST
    small = e < FEWEST
    pool = np.floor(np.cumsum(e[small]) / (2 * FEWEST)).astype(int)
    _, pool = np.unique(pool, return_inverse=True)
    groups = int(pool.max(initial=-1)) + 1
    group = np.concatenate([pool, groups + np.arange(e.size - small.sum())])
    o, e, v = (np.bincount(group, x) for x in (o, e, v))

    # Complete the last pool with its neighbor
    if groups and e[groups - 1] < FEWEST:
        beside = groups if e.size > groups else groups - 2
        if beside < 0:
            return float("nan"), 0
        for x in (o, e, v):
            x[beside] += x[groups - 1]
        o, e, v = (np.delete(x, groups - 1) for x in (o, e, v))
    return float(np.sum((o - e) ** 2 / (e + v))), e.size - 1


def statistic(observed: np.ndarray, integrals: Integrals, samples: int) -> tuple[float, int]:
    """Return Pearson's statistic and its degrees of freedom.

    Its cells are all resolved cells, one for the unresolved cells, and one for samples outside.
    """
    good = integrals.resolved
    cells = (observed, integrals.cells, integrals.variance)
    outside = (samples - observed.sum(), max(1 - integrals.total, 0.0), integrals.total_error**2)
    o, p, v = (
        np.concatenate([each[good], [each[~good].sum(), rest]])
        for each, rest in zip(cells, outside, strict=True)
    )
    return pearson(o, samples * np.maximum(p, 0), samples**2 * v)


def second_moments(points: np.ndarray) -> np.ndarray:
    """Return the coordinates and their products, in the order of `MOMENTS`."""
    d = points.shape[0]
    products = [points[i] * points[j] for i in range(d) for j in range(i, d)]
    return np.stack([*points, *products])


def compare_moments(
    points: np.ndarray, integrals: Integrals, known: Mapping[str, float]
) -> tuple[Moment, ...]:
    """Compare all moments of the samples with the moments of the density, and with known values."""
    # Mean and variance of the samples
    names = MOMENTS[points.shape[0]]
    values = second_moments(points)
    count = max(points.shape[1], 1)
    mean = values.sum(axis=1) / count
    square = (values**2).sum(axis=1) / count
    variance = np.maximum(square - mean**2, 0) / count

    # Moments of the density
    total = integrals.total if integrals.total > 0 else math.nan
    expected = mean + integrals.moments / total
    variances = variance + integrals.moments_variance / total**2
    compared = zip(names, mean, expected, variances, square, strict=True)
    moments = [_moment(*each) for each in compared]

    # Known moments
    for name, value in known.items():
        k = names.index(name)
        moments.append(_moment(f"{name} (known)", mean[k], float(value), variance[k], square[k]))
    return tuple(moments)


def _moment(name: str, mean: float, expected: float, variance: float, square: float) -> Moment:
    """Compare a mean with its expected value.

    Args:
        name: Name of the moment.
        mean: Mean over the samples.
        expected: Its expected value.
        variance: Variance of the difference of both.
        square: Mean square, which determines the scale of rounding errors.
    """
    difference = mean - expected
    if math.isnan(difference):
        return Moment(name, float(mean), math.nan, math.nan, 0.0)
    beyond = max(abs(difference) - ROUNDING * math.sqrt(square), 0.0)
    z = beyond / math.sqrt(variance) if variance > 0 else (math.inf if beyond > 0 else 0.0)
    p_value = math.erfc(z / math.sqrt(2))
    return Moment(name, float(mean), float(expected), math.copysign(z, difference), p_value)
