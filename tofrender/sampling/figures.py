"""What a chi-square test found, as a figure."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from ..runtime.canvas import new_figure
from .verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    checks.instance("verdict", verdict, Verdict, "a result of chi_square_test")
    figure = new_figure(15.0, 5.2, "compressed")
    density_panels(figure.subplots(1, 3), verdict)
    caption(figure, verdict)
    return figure


def density_panels(all_axes: Any, verdict: Verdict) -> None:
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
        if verdict.domain.down:
            axes.invert_yaxis()
        axes.locator_params(nbins=5)
        axes.set_box_aspect(1)


def _occupied(verdict: Verdict) -> slice:
    """The rows that hold all points, observed or expected, but for one in ten thousand."""
    weight = (verdict.observed + np.maximum(verdict.expected, 0)).sum(axis=1)
    if verdict.domain.dimensions == 2 or not weight.sum() > 0:
        return slice(0, weight.size)
    inside = np.flatnonzero(weight > 1e-4 * weight.sum() / weight.size)
    return slice(int(inside[0]), int(inside[-1]) + 1)


def caption(figure: Figure, verdict: Verdict) -> None:
    """The verdict above everything, green or red, in lines that fit."""
    lines = [textwrap.shorten(line, 150) for line in str(verdict).splitlines()]
    figure.suptitle("\n".join(lines), color="darkgreen" if verdict.passed else "firebrick")
