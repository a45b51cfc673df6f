"""Axes and figures with units of a transient's pixels and times."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import plots
from ..runtime.canvas import figure_width, new_figure
from ..signals.units import ns_to_opl, opl_to_ns
from .transient import Transient

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def pixel_axes(axes: Axes) -> None:
    """Label both axes in whole pixels."""
    axes.set_xlabel("x [pixel]")
    axes.set_ylabel("y [pixel]")
    plots.few_ticks(axes, integer=True)


def map_axes(axes: Axes, values: Any, **options: Any) -> Any:
    """Draw values (height, width) like `imshow`, hatched where they are NaN; returns the image."""
    axes.patch.set(**plots.HATCH, linewidth=0)
    pixel_axes(axes)
    return axes.imshow(values, interpolation="nearest", **options)


def time_axes(axes: Axes, sequence: Transient) -> None:
    """Label time below, path length above, quantity on the left; for axes with all curves."""
    axes.set_xlabel("time [ns]")
    factor, formatter = plots.tick_scale(max(map(abs, axes.get_ylim())))
    axes.yaxis.set_major_formatter(formatter)
    quantity = plots.label_with_factor(sequence.quantity, factor)
    figure: Any = axes.get_figure(root=True)
    narrow = figure.get_figwidth() < plots.COLUMN
    axes.set_ylabel(quantity.replace(" [", "\n[") if narrow else quantity)
    axes.set_xlim(opl_to_ns(sequence.opl[0]), opl_to_ns(sequence.opl[-1]) + 1e-9)
    axes.grid(alpha=0.3)
    axes.locator_params(axis="x", nbins=7)
    above = axes.secondary_xaxis("top", functions=(ns_to_opl, opl_to_ns))
    above.set_xlabel("optical path length [m]")


def picture_aspect(height: float, width: float, low: float, high: float) -> float:
    """Height over width, clamped to [low, high] so that a figure stays readable."""
    return min(high, max(low, height / width))


def explain_hatch(figure: Figure, mask: np.ndarray, dark: bool = False) -> None:
    """Explain the hatch of pixels without a value below, or that of `tonemap`, which is dark."""
    if mask.any():
        handle = plots.hatch_patch("not finished" if dark else plots.NO_VALUE, dark)
        figure.legend(handles=[handle], loc="outside lower center", frameon=False)


def picture_figure(
    picture: np.ndarray,
    title: str,
    scale: Any,
    label: str,
    extend: str,
    unfinished: np.ndarray,
    *,
    above: str | None = None,
    **options: Any,
) -> Figure:
    """A figure of one RGB picture with a colour bar, and options for `imshow`."""
    wide = figure_width(4.6)
    high = wide * picture_aspect(picture.shape[0], picture.shape[1], 0.4, 2.0) + 1.0
    figure = new_figure(wide, high, "compressed")
    axes = figure.add_subplot()
    axes.imshow(picture, interpolation="nearest", **options)
    axes.set_title(title)
    pixel_axes(axes)
    plots.colour_bar(scale, axes, label, extend=extend)
    if above is not None:
        figure.suptitle(plots.wrap_text(above, wide))
    explain_hatch(figure, unfinished, dark=True)
    plots.fit_height(figure)
    return figure
