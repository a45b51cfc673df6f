"""What a chi-square test found, as a figure."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, palette
from ..runtime.plots import COLUMN, PictureGrid, few_ticks
from .verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = ("observed density", "expected density", "difference")


@in_style
def verdict_figure(verdict: Verdict) -> Figure:
    """Observed and expected density of a chi-square test, and their difference in each cell.

    Directions are drawn over azimuth and cosine, where equal areas are equal solid angles; rows
    without density are left out. The difference is in standard deviations: noise of size 1 with no
    pattern is what a right sampler shows.

    Args:
        verdict: What `chi_square_test` returns.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot; `save_figure` writes it.

    Example:
        >>> from tofrender.sampling import warp_case
        >>> verdict = warp_case("tent").test(samples=10_000, resolution=21)
        >>> figure = verdict.figure()
        >>> [axes.get_title() for axes in figure.axes[:3]]
        ['observed density', 'expected density', 'difference']
    """
    checks.instance("verdict", verdict, Verdict, "a result of chi_square_test")
    width = figure_width(7.0)
    columns = 3 if width >= COLUMN else 2
    grid = PictureGrid(width, -(-3 // columns), columns, 1.0, own_y=True, **caption(verdict))
    density_panels(grid, verdict, [(k // columns, k % columns) for k in range(3)])
    return grid.figure


def density_panels(
    grid: PictureGrid, verdict: Verdict, places: Sequence[tuple[int, int]], names: Any = NAMES
) -> None:
    """Densities observed and expected, on one scale, and the difference in standard deviations.

    Args:
        grid: Where to draw.
        verdict: What to draw.
        places: Row and column of each panel.
        names: Which of `NAMES` each is.
    """
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
    unit = "density [sr⁻¹]" if directions else "density [1/area]"
    panels = dict(zip(NAMES, (observed, expected, difference), strict=True))
    drawn = []
    for name, (row, column) in zip(names, places, strict=True):
        options: Any = {"cmap": "viridis", "vmin": 0, "vmax": top}
        label, extend = unit, "max"
        if name == "difference":
            options = {"cmap": "RdBu_r", "vmin": -5, "vmax": 5}
            label, extend = "standard deviations", "both"
        axes = grid.axes(row, column, name)
        values = panels[name][rows]
        shown = axes.pcolormesh(
            a, up[rows.start : rows.stop + 1], values, rasterized=True, **options
        )
        axes.set_xlabel(verdict.domain.labels[0])
        axes.set_ylabel("cos θ" if directions else verdict.domain.labels[1])
        if verdict.domain.down:
            axes.invert_yaxis()
        few_ticks(axes)
        grid.trim(axes, row, column)
        drawn.append((shown, row, column, label, extend))
    for shown, row, column, label, extend in drawn:
        grid.bar(shown, row, column, label, extend=extend)


def caption(verdict: Verdict) -> dict[str, Any]:
    """The verdict as the title of a `PictureGrid`, in the colour of good or of bad."""
    lines = [textwrap.shorten(line, 150) for line in str(verdict).splitlines()]
    colours = palette()
    return {
        "title": "\n".join(lines),
        "title_colour": colours.good if verdict.passed else colours.bad,
    }


def _occupied(verdict: Verdict) -> slice:
    """The rows that hold all points, observed or expected, but for one in ten thousand."""
    weight = (verdict.observed + np.maximum(verdict.expected, 0)).sum(axis=1)
    if verdict.domain.dimensions == 2 or not weight.sum() > 0:
        return slice(0, weight.size)
    inside = np.flatnonzero(weight > 1e-4 * weight.sum() / weight.size)
    return slice(int(inside[0]), int(inside[-1]) + 1)
