"""Figure of a sensor's measurement and its expectation."""

from typing import Annotated, Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from ..labels import SENSED, pixel_steps, read
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from ..runtime.plots import color_bar, ends_beyond, hatch_patch, percentile_range, wrap_text
from .transient_figures import map_axes, typeset

AXES = {"opl": "optical path length [m]", "delay_opl": "delay of the gate [m]"}
AXES |= {"sweep": "path length along the sweep [m]"}

LEAST_LIGHT = 0.02
"""Light of a pixel, as a fraction of a bright pixel's, below which the figure shows no depth."""

CLEAR_LIGHT = 0.1
"""The same fraction, from which a pixel counts for the range of the map of depths."""

TOO_DARK = f"less than {LEAST_LIGHT:.0%} of a bright pixel's light, or no estimate"


@in_style()
def measurement_figure(measured: Annotated[xr.Dataset, SENSED]) -> Figure:
    """Draw a result of `sense`: sums, peaks or depths, and a bright pixel with its expectation.

    The pixel is brighter than 90 % of all pixels. Pixels that are almost dark have no depth, and
    the map is hatched there. Only pixels with a tenth of the bright pixel's light determine the
    range of the map, so that a border with background light alone does not widen the range.
    Another Dataset is a ValueError.

    Example:
        >>> from tofrender import render
        >>> from tofrender.sensors import sense
        >>> box = render("cornell_box", spp=4, size=(64, 64), window="auto", progress=False)
        >>> [axes.get_title() for axes in measurement_figure(sense(box, "itof")).axes[::2]]
        ['sum of taps', 'depth', '']
    """
    # Read the measurement and its expectation
    attrs = getattr(measured, "attrs", {})
    valid = "sensor" in attrs and attrs.get("quantity") in measured
    checks.require("measured", measured, valid, "a Dataset of sense")
    name = str(attrs["quantity"])
    measured = read(measured, SENSED, "measured")
    steps = pixel_steps(measured, "measured")
    lines = {name: measured[name], "expectation": measured.get("expected")}
    curves = {k: v.transpose("y", "x", ...).values for k, v in lines.items() if v is not None}
    curves = {k: v.reshape(*v.shape[:2], -1) for k, v in curves.items()}

    # Choose a bright pixel
    total = curves[name].sum(axis=-1, dtype=np.float64)
    at = np.argsort(total, axis=None, kind="stable")[int(0.9 * (total.size - 1))]
    row, column = (int(n) for n in np.unravel_index(at, total.shape))
    y, x = (int(measured[side][n]) for side, n in (("y", row), ("x", column)))

    # A larger pixel has the label of its first pixel on the film
    (left, right), (top, bottom) = (
        (int(measured[side][0]) - 0.5, int(measured[side][-1]) + steps[side] - 0.5)
        for side in ("x", "y")
    )
    middle = x + (steps["x"] - 1) / 2, y + (steps["y"] - 1) / 2
    extent = (left, right, bottom, top)

    # Find the brightest path length, or the depth
    axis = next((each for each in AXES if each in measured.coords), None)
    places = measured[axis].values if axis else np.arange(curves[name].shape[2])
    units = "counts" if name == "counts" else str(attrs["units"])

    # The second map: the depth, or the place of the peak, of pixels with enough light
    lit = total >= max(LEAST_LIGHT * total[row, column], np.finfo(float).tiny)
    if "depth" in measured:
        second = "depth"
        label = "depth [m]"
        found = measured["depth"].values
    else:
        second = "brightest at"
        label = AXES.get(str(axis), "frame and tap")
        found = places[curves[name].argmax(axis=-1)]
    maps = {
        f"sum of {name}": (total, typeset(units), "inferno"),
        second: (np.where(lit, found, np.nan), label, "viridis"),
    }

    # Draw both maps
    width = figure_width(7.0)
    figure = new_figure(width, 0.75 * width)
    grid = figure.add_gridspec(2, 2, height_ratios=[0.55, 0.45])
    for k, (title, (picture, unit, colors)) in enumerate(maps.items()):
        axes = figure.add_subplot(grid[0, k])
        clear = picture[total >= CLEAR_LIGHT * total[row, column]] if k else picture
        low, high, _ = percentile_range(clear)
        beyond = ends_beyond(picture, low, high)
        shown = map_axes(axes, picture, extent=extent, cmap=colors, vmin=low, vmax=high)
        axes.plot(*middle, "o", mfc="none", mec="white")
        axes.set_title(title)
        color_bar(shown, axes, unit, extend=beyond)
    if np.isnan(maps[second][0]).any():
        patch = hatch_patch(TOO_DARK)
        figure.legend(handles=[patch], loc="outside lower center", frameon=False)

    # Plot the response of the pixel
    plot = figure.add_subplot(grid[1, :])
    for style, color, (label, curve) in zip(".-", palette().lines, curves.items(), strict=False):
        steps: Any = {"drawstyle": "default" if axis else "steps-mid", "label": label}
        plot.plot(places, curve[row, column], style, color=color, **steps)
    plot.set(xlabel=AXES.get(str(axis), "frame and tap"), ylabel=typeset(units))
    plot.legend(title=f"pixel ({x}, {y})", frameon=False)
    cycles = int(measured["cycles"].max())
    figure.suptitle(wrap_text(f"{attrs['scene']}, {cycles} cycles", width))
    return figure
