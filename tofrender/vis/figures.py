"""Axes with units of a transient's pixels and times."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime.plots import (
    COLUMN,
    HATCH,
    NO_VALUE,
    few_ticks,
    hatch_patch,
    label_with_factor,
    tick_scale,
)
from ..signals.units import ns_to_opl, opl_to_ns
from .transient import Transient

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def pixel_axes(axes: Axes) -> None:
    """Pixels in whole numbers on both axes."""
    axes.set_xlabel("x [pixel]")
    axes.set_ylabel("y [pixel]")
    few_ticks(axes, integer=True)


def map_axes(axes: Axes, values: Any, **options: Any) -> Any:
    """Draw values (height, width), with options as for `imshow`; where they are NaN, a hatch shows.

    Returns:
        The image, for a colour bar.
    """
    axes.patch.set(**HATCH, linewidth=0)
    pixel_axes(axes)
    return axes.imshow(values, interpolation="nearest", **options)


def hatch_area(axes: Axes, extent: tuple[float, float, float, float]) -> None:
    """Lay a hatch below a picture, where no value of it hides the hatch."""
    from matplotlib.patches import Rectangle

    left, right, low, high = extent
    area = Rectangle((left, low), right - left, high - low, **HATCH, linewidth=0, zorder=-1)
    axes.add_patch(area)


def time_axes(axes: Axes, sequence: Transient) -> None:
    """Time below, path length above, quantity on the left; call it when all is drawn."""
    axes.set_xlabel("time [ns]")
    factor, formatter = tick_scale(max(map(abs, axes.get_ylim())))
    axes.yaxis.set_major_formatter(formatter)
    quantity = label_with_factor(sequence.quantity, factor)
    figure: Any = axes.get_figure(root=True)
    narrow = figure.get_figwidth() < COLUMN
    axes.set_ylabel(quantity.replace(" [", "\n[") if narrow else quantity)
    axes.set_xlim(opl_to_ns(sequence.opl[0]), opl_to_ns(sequence.opl[-1]) + 1e-9)
    axes.grid(alpha=0.3)
    axes.locator_params(axis="x", nbins=7)
    above = axes.secondary_xaxis("top", functions=(ns_to_opl, opl_to_ns))
    above.set_xlabel("optical path length [m]")


def picture_aspect(height: int, width: int, low: float, high: float) -> float:
    """Height over width, kept within [low, high] so that a figure stays readable."""
    return min(high, max(low, height / width))


def explain_hatch(figure: Figure, *hidden: Any, dark: bool = False) -> None:
    """Say below what the hatch means, if any of the masks holds a pixel.

    Args:
        figure: The figure.
        hidden: Which pixels have no value, arrays of bool.
        dark: Whether the hatch is that of `tonemap`, for what is not finished.
    """
    if any(np.any(each) for each in hidden):
        handle = hatch_patch("not finished" if dark else NO_VALUE, dark)
        figure.legend(handles=[handle], loc="outside lower center", frameon=False)
