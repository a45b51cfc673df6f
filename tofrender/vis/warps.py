"""Figures of warps and of the chi-square test."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .figures import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..sampling.chi_square import Verdict


def verdict_figure(verdict: Verdict) -> Figure:
    """Observed and expected density of a chi-square test, and their difference in each cell.

    Directions are drawn over azimuth and cosine, where equal areas are equal solid angles; rows
    without density are left out. The difference is in standard deviations: noise of size 1 with no
    pattern is what a right sampler shows.

    Args:
        verdict: What `chi_square_test` returns.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot; `figure.savefig(...)` writes it.

    Example:
        >>> from tofrender.sampling import warp_case
        >>> verdict = warp_case("tent").test(samples=10_000, resolution=21)
        >>> figure = verdict.figure()
        >>> [axes.get_title() for axes in figure.axes[:3]]
        ['observed density', 'expected density', 'difference']
    """
    figure = new_figure(15.0, 5.2, "compressed")
    _panels(figure.subplots(1, 3), verdict)
    _caption(figure, verdict)
    return figure


def warp_figure(points: Any, verdict: Verdict, title: str = "points") -> Figure:
    """Warped points and the density they should have, above the verdict of a chi-square test.

    Args:
        points: Warped points to draw, shape (2, n) in the plane or (3, n) on the sphere. A
            hemisphere is drawn as seen from above, a sphere over azimuth and cosine.
        verdict: What `chi_square_test` returns for the warp.
        title: Title of the first panel.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot; `figure.savefig(...)` writes it.

    Example:
        >>> from tofrender.sampling import grid, warp_case
        >>> case = warp_case("tent")
        >>> verdict = case.test(samples=10_000, resolution=21)
        >>> figure = warp_figure(np.array(case.sample(grid(64))), verdict)
        >>> [axes.get_title() for axes in figure.axes[:4]]
        ['points', 'expected density', 'observed density', 'difference']
    """
    figure = new_figure(11.5, 10.0, "compressed")
    (first, expected), (observed, difference) = figure.subplots(2, 2)
    _points(first, np.asarray(points, dtype=np.float64), verdict)
    first.set_title(title)
    _panels((observed, expected, difference), verdict)
    _caption(figure, verdict)
    return figure


def _points(axes: Axes, points: np.ndarray, verdict: Verdict) -> None:
    size = float(np.clip(600 / np.sqrt(points.shape[1]), 0.2, 12))
    if points.shape[0] == 2:
        x, y = points
        labels = verdict.domain.labels
    elif verdict.domain.upper_only:
        x, y = points[:2]
        labels = ("x (seen from above)", "y")
    else:
        x, y = np.arctan2(points[1], points[0]), points[2]
        labels = ("φ [rad]", "cos θ")
    axes.scatter(x, y, s=size, linewidths=0)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.locator_params(nbins=5)
    axes.set_box_aspect(1)
    if points.shape[0] == 2:
        (low_x, low_y), (high_x, high_y) = verdict.domain.low, verdict.domain.high
        axes.set(xlim=(low_x, high_x), ylim=(low_y, high_y))
    elif verdict.domain.upper_only:
        reach = 1.05 * float(np.max(np.hypot(x, y), initial=0.0)) or 1.0
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    else:
        axes.set(xlim=(-np.pi, np.pi), ylim=(-1, 1))


def _panels(all_axes: Any, verdict: Verdict) -> None:
    """Densities observed and expected, on one scale, and the difference in standard deviations."""
    a, b = verdict.edges
    rows = _occupied(verdict)
    directions = verdict.domain.dimensions == 3
    up = np.cos(b) if directions else b
    area = np.abs(np.multiply.outer(np.diff(up), np.diff(a)))
    total = max(float(verdict.observed.sum()), 1.0) / max(verdict.valid, 1e-9)
    area = np.maximum(area, 1e-300) * total
    observed, expected = verdict.observed / area, verdict.expected / area
    difference = (verdict.observed - verdict.expected) / np.sqrt(np.maximum(verdict.expected, 1))
    top = 1.2 * float(np.percentile(expected[rows], 99.5)) or 1.0  # room for noise above
    unit = "density [sr$^{-1}$]" if directions else "density [per unit area]"
    for axes, values, title in zip(
        all_axes,
        (observed, expected, difference),
        ("observed density", "expected density", "difference"),
        strict=True,
    ):
        is_difference = title == "difference"
        options = (
            {"cmap": "RdBu_r", "vmin": -5, "vmax": 5}
            if is_difference
            else {"cmap": "viridis", "vmin": 0, "vmax": top}
        )
        shown = axes.pcolormesh(
            a, up[rows.start : rows.stop + 1], values[rows], rasterized=True, **options
        )
        label = "(observed - expected) / √expected" if is_difference else unit
        axes.figure.colorbar(shown, ax=axes, label=label, extend="both" if is_difference else "max")
        axes.set(
            title=title,
            xlabel=verdict.domain.labels[0],
            ylabel="cos θ" if directions else verdict.domain.labels[1],
        )
        axes.locator_params(nbins=5)
        axes.set_box_aspect(1)


def _occupied(verdict: Verdict) -> slice:
    """The rows that hold all points, observed or expected, but for one in ten thousand."""
    weight = (verdict.observed + np.maximum(verdict.expected, 0)).sum(axis=1)
    if verdict.domain.dimensions == 2 or not weight.sum() > 0:
        return slice(0, weight.size)
    inside = np.flatnonzero(weight > 1e-4 * weight.sum() / weight.size)
    return slice(int(inside[0]), int(inside[-1]) + 1)


def _caption(figure: Figure, verdict: Verdict) -> None:
    """The verdict above everything, green or red, in lines that fit."""
    import textwrap

    lines = [textwrap.shorten(line, 150) for line in str(verdict).splitlines()]
    figure.suptitle("\n".join(lines), color="darkgreen" if verdict.passed else "firebrick")
