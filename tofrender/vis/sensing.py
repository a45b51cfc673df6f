"""What a sensor measures, on one page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from ..runtime.plots import colour_bar, percentile_range, wrap_text

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

AXES = {"opl": "optical path length [m]", "delay_opl": "delay of the gate [m]"}
AXES |= {"sweep": "path length along the sweep [m]"}


@in_style()
def measurement_figure(measured: xr.Dataset, pixel: tuple[int, int] | None = None) -> Figure:
    """Draw a measurement: its sum, where it peaks or its depth, and a pixel with its expectation.

    Args:
        measured: A result of `tofrender.sensors.sense`.
        pixel: Column and row of a pixel, from 0; by default one brighter than 90 % of them.

    Raises:
        ValueError: Another Dataset, or a pixel outside it.

    Example:
        >>> from tofrender import render
        >>> from tofrender.sensors import sense
        >>> box = render("cornell_box", spp=4, size=(64, 64), window="auto", progress=False)
        >>> [axes.get_title() for axes in measurement_figure(sense(box, "itof")).axes[::2]]
        ['sum of taps', 'depth [m]', '']
    """
    attrs = getattr(measured, "attrs", {})
    valid = "sensor" in attrs and attrs.get("quantity") in measured
    checks.require("measured", measured, valid, "a Dataset of sense")
    name, units = str(attrs["quantity"]), attrs["units"] if attrs["units"] != "1" else "counts"
    values = measured[name].transpose("y", "x", ...).values.astype(np.float64)
    values = values.reshape(*values.shape[:2], -1)
    total, last = values.sum(axis=-1), values.shape[0] * values.shape[1] - 1
    if pixel is None:
        at = np.argsort(total, axis=None, kind="stable")[int(0.9 * last)]
        row, column = (int(n) for n in np.unravel_index(at, total.shape))
    else:
        column, row = checks.items("pixel", pixel, 2, "(column, row)")
        checks.integer("pixel", column, 0, total.shape[1] - 1)
        checks.integer("pixel", row, 0, total.shape[0] - 1)
    axis = next((each for each in AXES if each in measured.coords), None)
    places = np.arange(values.shape[2]) if axis is None else measured[axis].values
    width = figure_width(7.0)
    figure = new_figure(width, 0.75 * width)
    grid = figure.add_gridspec(2, 2, height_ratios=[0.55, 0.45])
    second = "depth [m]" if "depth" in measured else "brightest at [m]"
    peaks = np.where(total > 0, places[values.argmax(axis=-1)], np.nan)
    peaks = measured["depth"].values if "depth" in measured else peaks
    for k, (title, picture) in enumerate({f"sum of {name}": total, second: peaks}.items()):
        axes = figure.add_subplot(grid[0, k])
        low, high, beyond = percentile_range(picture)
        shown = axes.imshow(picture, cmap="viridis" if k else "inferno", vmin=low, vmax=high)
        axes.plot(column, row, "o", mfc="none", mec="white")
        axes.set_title(title)
        colour_bar(shown, axes, "" if k else units, extend=beyond)
    plot = figure.add_subplot(grid[1, :])
    plot.plot(places, values[row, column], ".", color=palette().lines[0], label=name)
    if "expected" in measured:
        line = measured["expected"].transpose("y", "x", ...).values[row, column].ravel()
        steps = "default" if axis else "steps-mid"
        plot.plot(places, line, color=palette().lines[1], ds=steps, label="expectation")
    plot.set(xlabel=AXES.get(str(axis), "frame and tap"), ylabel=units)
    plot.legend(title=f"pixel ({column}, {row})", frameon=False)
    title = f"{attrs.get('scene') or 'render'}, {attrs['cycles']} cycles"
    figure.suptitle(wrap_text(title, width))
    return figure
