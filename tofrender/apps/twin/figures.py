"""Figures of the twin: measured and rendered histograms, residuals, and agreement by recording."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...runtime.canvas import figure_width, in_style, new_figure, palette
from .agreement import FIRST_BIN, LAST_BIN, correlations
from .experiment import Experiment


@in_style()
def histogram_figure(result: Experiment, name: str, quantile: float = 0.5) -> Figure:
    """Draw the measured and rendered histograms of all zones of one pose that was not fitted.

    The pose has the given quantile of the correlation, the median by default.
    """
    measured, expected, pose = _pose_at(result, name, quantile)
    bins = np.arange(FIRST_BIN, LAST_BIN + 1)

    # Draw the zones as in the sensor's picture
    width = figure_width(7.0)
    figure = new_figure(width, 0.8 * width)
    grid = figure.subplots(3, 3, sharex=True, sharey=True)
    colors = palette().lines
    for zone, axes in enumerate(_in_view(grid)):
        axes.step(bins, measured[zone, bins], where="mid", color=colors[0], label="measured")
        axes.step(bins, expected[zone, bins], where="mid", color=colors[1], label="rendered")
        axes.set_yscale("log")
        axes.set_title(f"zone {zone}", fontsize="small")
    for axes in grid[-1]:
        axes.set_xlabel("bin")
    for axes in grid[:, 0]:
        axes.set_ylabel("counts")
    grid[0, -1].legend(fontsize="small")
    figure.suptitle(f"{name}, pose {pose}")
    return figure


@in_style()
def residual_figure(result: Experiment, name: str, quantile: float = 0.5) -> Figure:
    """Draw rendered minus measured counts over the largest count of each zone of the same pose."""
    measured, expected, pose = _pose_at(result, name, quantile)
    bins = np.arange(FIRST_BIN, LAST_BIN + 1)
    width = figure_width(7.0)
    figure = new_figure(width, 0.8 * width)
    grid = figure.subplots(3, 3, sharex=True, sharey=True)
    for zone, axes in enumerate(_in_view(grid)):
        largest = measured[zone, bins].max()
        difference = (expected - measured)[zone, bins] / largest
        axes.axhline(0, color="0.6", linewidth=0.8)
        axes.step(bins, 100 * difference, where="mid", color=palette().lines[1])
        axes.set_title(f"zone {zone}", fontsize="small")
    for axes in grid[-1]:
        axes.set_xlabel("bin")
    for axes in grid[:, 0]:
        axes.set_ylabel("% of the peak")
    figure.suptitle(f"{name}, pose {pose}: rendered - measured")
    return figure


def _pose_at(result: Experiment, name: str, quantile: float) -> tuple[Any, Any, int]:
    """Return measured and expected counts of the pose with a quantile of the correlation."""
    held = np.flatnonzero(result.held_out[name])
    bins = slice(FIRST_BIN, LAST_BIN + 1)
    measured = result.measured[name][held]
    expected = result.expected[name][held]
    found = correlations(
        expected[..., bins].reshape(len(held), -1), measured[..., bins].reshape(len(held), -1)
    )
    chosen = int(np.argsort(found)[round(quantile * (len(held) - 1))])
    return measured[chosen], expected[chosen], int(held[chosen])


def _in_view(grid: Any) -> list[Any]:
    """Return the axes of zones in their order, as the sensor's picture shows them.

    Zone 3 column + row: columns go from +x, which is on the left, and rows from +y, the top.
    """
    return [grid[zone % 3, zone // 3] for zone in range(9)]
