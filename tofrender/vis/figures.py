"""Axes with units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..signals.units import ns_to_opl, opl_to_ns
from .transient import Transient

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def pixel_axes(axes: Axes) -> None:
    """Pixels in whole numbers on both axes."""
    axes.set_xlabel("x [pixel]")
    axes.set_ylabel("y [pixel]")
    axes.locator_params(integer=True)


def map_axes(axes: Axes, values: Any, **options: Any) -> Any:
    """Draw values (height, width), with options as for `imshow`; where they are NaN, a hatch shows.

    Returns:
        The image, for a colour bar.
    """
    axes.patch.set(facecolor="0.62", edgecolor="0.5", hatch="////", linewidth=0)
    pixel_axes(axes)
    return axes.imshow(values, interpolation="nearest", **options)


def time_axes(axes: Axes, sequence: Transient) -> None:
    """Time below, path length above, quantity on the left."""
    axes.set_xlabel("time [ns]")
    axes.set_ylabel(sequence.quantity)
    axes.set_xlim(opl_to_ns(sequence.opl[0]), opl_to_ns(sequence.opl[-1]) + 1e-9)
    axes.grid(alpha=0.3)
    above = axes.secondary_xaxis("top", functions=(ns_to_opl, opl_to_ns))
    above.set_xlabel("optical path length [m]")


def picture_aspect(height: int, width: int, low: float, high: float) -> float:
    """Height over width, kept within [low, high] so that a figure stays readable."""
    return min(high, max(low, height / width))
