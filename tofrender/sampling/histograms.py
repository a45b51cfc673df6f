"""What the chi-square test counts and integrates: cells, expected counts, Pearson's statistic.

Half of the cells' edges are spread evenly over the domain, half by a pilot run of the sampler, so
that narrow densities are resolved too. Expected counts are integrals of the density over the
cells, by jittered points: more of them in cells where their spread is large, or where samples have
met a density that they have not. What variance is left goes into the statistic, and cells that
stay unresolved are counted as one: a density that is hard to integrate makes the test weaker, not
wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from .domains import Domain, to_drjit

STRATA = 6
"""Strata along each side of a cell at first, one point in each."""

REPEATS = 8
"""Independent integrals of each cell, whose spread gives their variance."""

POOR = 0.1
"""Variance of an integral, relative to that of the count, beyond which it is refined."""

MAX_POINTS = 1 << 21
"""Most points in one refinement."""

FEWEST = 5.0
"""Smallest expected count of a cell for which Pearson's statistic follows its distribution."""


@dataclass(frozen=True)
class Integrals:
    """Integrals of a density.

    Attributes:
        cells: Probability of each cell, shape (rows, columns).
        variance: Variance of that estimate.
        resolved: Whether that is small enough.
        moments: Integrals of the density times each function, shape (functions,).
        moments_variance: Variance of that estimate.
        total: Integral over the domain.
        total_error: Standard error of that estimate.
        lowest: Smallest value of the density that was met.
        not_finite: Share of the points where it was NaN or infinite.
    """

    cells: np.ndarray
    variance: np.ndarray
    resolved: np.ndarray
    moments: np.ndarray
    moments_variance: np.ndarray
    total: float
    total_error: float
    lowest: float
    not_finite: float


def cell_edges(domain: Domain, pilot: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Edges of the columns and of the rows.

    They are quantiles of a mixture, half of it uniform and half the `pilot` points in the plane,
    of shape (2, n): a cell has at most twice its even share of either.
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
    """Number of the cell that holds each of the points (2, n); an upper edge belongs to its cell.

    Cells are numbered row by row.

    Example:
        >>> edges = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0])
        >>> cell_of(edges, np.array([[0.5, 1.0, 1.5], [0.5, 0.5, 0.5]]))
        array([0, 0, 1])
    """
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

    Args:
        pdf: Density, of Dr.Jit points.
        functions: Values of shape (functions, n) at points (dimensions, n).
        domain: Where both are defined.
        edges: The cells.
        samples: Number of samples that the integrals are compared with.
        highest: Highest density at a sample of each cell, 0 where there is none; shape (cells,).
        seed: Seed of the jitter.
    """
    rng = np.random.default_rng(seed)
    columns, rows = (each.size - 1 for each in edges)
    cells = np.stack(
        [
            np.tile(edges[0][:-1], rows),
            np.tile(np.diff(edges[0]), rows),
            np.repeat(edges[1][:-1], columns),
            np.repeat(np.diff(edges[1]), columns),
        ]
    )
    mean = variance = np.empty(0)
    lowest, bad, points = np.inf, 0, 0
    todo, strata = np.arange(rows * columns), STRATA
    while todo.size and todo.size * strata**2 <= max(MAX_POINTS, rows * columns * STRATA**2):
        parts = [
            _jittered(pdf, functions, domain, cells[:, todo], strata, rng) for _ in range(REPEATS)
        ]
        sums = np.stack([part[0] for part in parts])
        if not points:
            mean, variance = (np.empty((sums.shape[1], todo.size)) for _ in range(2))
        mean[:, todo], variance[:, todo] = sums.mean(axis=0), sums.var(axis=0, ddof=1) / REPEATS
        top = np.max([part[1] for part in parts], axis=0)
        lowest = min(lowest, *(part[2] for part in parts))
        bad += sum(part[3] for part in parts)
        points += REPEATS * todo.size * strata**2
        expected = np.maximum(samples * mean[0, todo], FEWEST)
        poor = samples**2 * variance[0, todo] > POOR * expected
        todo = todo[poor | (highest[todo] > 2 * top)]
        strata *= 2
        if bad or lowest < 0:
            break  # it is no density; more points would not help
    return Integrals(
        cells=mean[0].reshape(rows, columns),
        variance=variance[0].reshape(rows, columns),
        resolved=~np.isin(np.arange(rows * columns), todo).reshape(rows, columns),
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
    """One random point in each of strata^2 parts of each cell.

    Returns:
        The integrals of the density and of its products with the functions, shape
        (1 + functions, cells); the highest density met in each cell; the lowest one of all; and
        how many were not finite.
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

    Cells that expect fewer than `FEWEST` are pooled: in order of what they expect, as many as
    together expect it. The sum of all counts is fixed, which takes one degree of freedom. The
    variance is that of the expected counts, from their integration.

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
