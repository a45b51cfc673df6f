"""Counts and integrals of the chi-square test: cells, expected counts, Pearson's statistic.

Half of the cells' edges are spread evenly over the domain, half by a pilot run of the sampler, so
that narrow densities are resolved too. Expected counts are integrals of the density over the
cells, by jittered points: more of them in cells whose estimate has a large spread, or in which
samples have met a density that the points have not. The variance that is left goes into the
statistic, and cells that stay unresolved are counted as one: a density that is hard to integrate
makes the test weaker, not wrong.
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

STRATA = 6  # along each side of a cell at first, one point in each
REPEATS = 8  # independent integrals of each cell, whose spread gives their variance
POOR = 0.1  # variance of an integral, relative to that of the count, beyond which it is refined
MAX_POINTS = 1 << 21  # in one refinement
FEWEST = 5.0  # smallest expected count for which Pearson's statistic follows its distribution
ROUNDING = 1e-6  # relative difference of two moments that single precision explains

MOMENTS = {2: ("x", "y", "xx", "xy", "yy"), 3: ("x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz")}
"""First and second moments in the plane and in space."""


@dataclass(frozen=True)
class Integrals:
    """Integrals of a density, with the variances of these estimates."""

    cells: np.ndarray  # probability of each cell, shape (rows, columns)
    variance: np.ndarray  # variance of `cells`
    resolved: np.ndarray  # whether that is small enough
    moments: np.ndarray  # integrals of the density times each function, shape (functions,)
    moments_variance: np.ndarray  # variance of `moments`
    total: float  # integral over the domain
    total_error: float  # standard error of `total`
    lowest: float  # smallest value of the density at any point
    not_finite: float  # fraction of the points at which it was NaN or infinite


def cell_edges(domain: Domain, pilot: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the columns and of the rows: quantiles of a mixture, half of it uniform.

    The other half are the `pilot` points in the plane, shape (2, n). A row or column has at most
    twice the part of either that an even division would give it.
    """
    counts = (max(2, round(resolution * domain.aspect)), resolution)
    edges = []
    for low, high, points, count in zip(domain.low, domain.high, pilot, counts, strict=True):
        even = np.linspace(low, high, max(points.size, 2))
        mixture = np.concatenate([even, np.clip(points, low, high)])
        edges.append(np.unique(np.quantile(mixture, np.linspace(0, 1, count + 1))))
    for value in domain.jumps:
        edges[1][np.argmin(np.abs(edges[1] - value))] = value
    return edges[0], edges[1]


def cell_of(edges: tuple[np.ndarray, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Cell of each of the points (2, n), numbered row by row; an upper edge belongs to its cell."""
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
    """Integrals of a density over each cell, and of its product with functions over all of them.

    `functions` maps points (dimensions, n) to values (functions, n). The integrals are precise
    enough for a comparison with so many `samples`, whose `highest` density in each cell is given.
    """
    rng = np.random.default_rng(seed)
    columns, rows = (each.size - 1 for each in edges)
    count = rows * columns
    a, b = (np.stack([each[:-1], np.diff(each)]) for each in edges)
    cells = np.concatenate([np.tile(a, rows), np.repeat(b, columns, axis=1)])
    mean = variance = np.empty(0)
    lowest, bad, points = np.inf, 0, 0
    todo, strata = np.arange(count), STRATA
    while todo.size and todo.size * strata**2 <= max(MAX_POINTS, count * STRATA**2):
        # Integrate the cells that are not yet resolved, several times for the variance
        here = cells[:, todo]
        runs = [_jittered(pdf, functions, domain, here, strata, rng) for _ in range(REPEATS)]
        sums, tops, lows, bads = zip(*runs, strict=True)
        if not points:
            mean, variance = (np.empty((len(sums[0]), count)) for _ in range(2))
        mean[:, todo] = np.mean(sums, axis=0)
        variance[:, todo] = np.var(sums, axis=0, ddof=1) / REPEATS
        lowest, bad = min(lowest, *lows), bad + sum(bads)
        points += REPEATS * todo.size * strata**2
        # Refine those of a large variance, or of a density that the points have missed
        expected = np.maximum(samples * mean[0, todo], FEWEST)
        poor = samples**2 * variance[0, todo] > POOR * expected
        todo = todo[poor | (highest[todo] > 2 * np.max(tops, axis=0))]
        strata *= 2
        if bad or lowest < 0:
            break  # it is no density; more points would not help
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
    """Estimate from one random point in each of strata^2 parts of each cell.

    Returns the integrals of the density and of its products with the functions, shape
    (1 + functions, cells); the highest density in each cell; the lowest one of all; and how many
    were not finite.
    """
    a0, da, b0, db = cells[:, :, None, None]
    shape = (cells.shape[1], strata, strata)
    steps = np.arange(strata)
    a = (a0 + da * ((rng.random(shape) + steps) / strata)).ravel()
    b = (b0 + db * ((rng.random(shape) + steps[:, None]) / strata)).ravel()
    plane = np.stack([a, b])
    points = domain.to_points(plane)
    density = np.broadcast_to(np.asarray(mi.Float(pdf(to_drjit(points))), np.float64), a.size)
    finite = np.isfinite(density)
    density = np.where(finite, density, 0.0)
    mass = density * domain.area(plane) * np.repeat(cells[1] * cells[3] / strata**2, strata**2)
    values = np.concatenate([mass[None], mass * functions(points)])
    sums = values.reshape(values.shape[0], -1, strata**2).sum(axis=-1)
    top = density.reshape(-1, strata**2).max(axis=1)
    return sums, top, float(density.min()), a.size - int(finite.sum())


def pearson(observed: np.ndarray, expected: np.ndarray, variance: np.ndarray) -> tuple[float, int]:
    """Pearson's statistic, sum of (O - E)^2 / (E + variance of E), and its degrees of freedom.

    Cells that expect fewer than `FEWEST` are pooled, in the order of their expected counts, until
    the pool expects as many. The sum of all counts is fixed, which costs one degree of freedom.

    Example:
        >>> pearson(np.array([12, 8]), np.array([10.0, 10.0]), np.zeros(2))
        (0.8, 1)
    """
    order = np.argsort(expected, axis=None, kind="stable")
    o, e, v = (
        np.asarray(x, dtype=np.float64).ravel()[order] for x in (observed, expected, variance)
    )
    small = e < FEWEST
    # A step of 2 FEWEST in the running sum holds at least FEWEST, as no cell adds more than that.
    pool = np.floor(np.cumsum(e[small]) / (2 * FEWEST)).astype(int)
    _, pool = np.unique(pool, return_inverse=True)
    groups = int(pool.max(initial=-1)) + 1
    group = np.concatenate([pool, groups + np.arange(e.size - small.sum())])
    o, e, v = (np.bincount(group, x) for x in (o, e, v))
    if groups and e[groups - 1] < FEWEST:  # the last pool is filled up with the cell beside it
        beside = groups if e.size > groups else groups - 2
        if beside < 0:
            return float("nan"), 0
        for x in (o, e, v):
            x[beside] += x[groups - 1]
        o, e, v = (np.delete(x, groups - 1) for x in (o, e, v))
    return float(np.sum((o - e) ** 2 / (e + v))), e.size - 1


def statistic(observed: np.ndarray, integrals: Integrals, samples: int) -> tuple[float, int]:
    """Pearson's statistic of all resolved cells, of the others as one, and of samples in none."""
    good = integrals.resolved
    cells = (observed, integrals.cells, integrals.variance)
    outside = (samples - observed.sum(), max(1 - integrals.total, 0.0), integrals.total_error**2)
    o, p, v = (
        np.concatenate([each[good], [each[~good].sum(), rest]])
        for each, rest in zip(cells, outside, strict=True)
    )
    return pearson(o, samples * np.maximum(p, 0), samples**2 * v)


def second_moments(points: np.ndarray) -> np.ndarray:
    """Coordinates and their products, in the order of `MOMENTS`."""
    d = points.shape[0]
    products = [points[i] * points[j] for i in range(d) for j in range(i, d)]
    return np.stack([*points, *products])


def compare_moments(
    points: np.ndarray, integrals: Integrals, known: Mapping[str, float]
) -> tuple[Moment, ...]:
    """Compare all moments with those of the density, and with the known ones."""
    names = MOMENTS[points.shape[0]]
    values = second_moments(points)
    count = max(points.shape[1], 1)
    mean, square = values.sum(axis=1) / count, (values**2).sum(axis=1) / count
    variance = np.maximum(square - mean**2, 0) / count
    total = integrals.total if integrals.total > 0 else math.nan
    expected = mean + integrals.moments / total
    variances = variance + integrals.moments_variance / total**2
    compared = zip(names, mean, expected, variances, square, strict=True)
    moments = [_moment(*each) for each in compared]
    for name, value in known.items():
        k = names.index(name)
        moments.append(_moment(f"{name} (known)", mean[k], float(value), variance[k], square[k]))
    return tuple(moments)


def _moment(name: str, mean: float, expected: float, variance: float, square: float) -> Moment:
    """Test a mean of this variance; `square` is the mean square, the scale of rounding."""
    difference = mean - expected
    if math.isnan(difference):
        return Moment(name, float(mean), math.nan, math.nan, 0.0)
    beyond = max(abs(difference) - ROUNDING * math.sqrt(square), 0.0)
    z = beyond / math.sqrt(variance) if variance > 0 else (math.inf if beyond > 0 else 0.0)
    p_value = math.erfc(z / math.sqrt(2))
    return Moment(name, float(mean), float(expected), math.copysign(z, difference), p_value)
