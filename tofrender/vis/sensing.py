"""Figure of a sensor's measurement and its expectation."""

from typing import Annotated, Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from ..labels import SENSED, pixel_steps, read
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from ..runtime.plots import color_bar, percentile_range, wrap_text

AXES = {"opl": "optical path length [m]", "delay_opl": "delay of the gate [m]"}
AXES |= {"sweep": "path length along the sweep [m]"}


@in_style()
def measurement_figure(measured: Annotated[xr.Dataset, SENSED]) -> Figure:
    """Draw a result of `sense`: sums, peaks or depths, and a bright pixel with its expectation.

    This pixel is brighter than 90 % of all pixels. Another Dataset is a ValueError.

    Example:
        >>> from tofrender import render
        >>> from tofrender.sensors import sense
        >>> box = render("cornell_box", spp=4, size=(64, 64), window="auto", progress=False)
        >>> [axes.get_title() for axes in measurement_figure(sense(box, "itof")).axes[::2]]
        ['sum of taps', 'depth [m]', '']
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
    peaks = np.where(total > 0, places[curves[name].argmax(axis=-1)], np.nan)
    depth = {"depth [m]": measured["depth"].values} if "depth" in measured else {}
    maps = {f"sum of {name}": total, **(depth or {"brightest at [m]": peaks})}

    # Draw both maps
    width = figure_width(7.0)
    figure = new_figure(width, 0.75 * width)
    grid = figure.add_gridspec(2, 2, height_ratios=[0.55, 0.45])
    for k, (title, picture) in enumerate(maps.items()):
        axes = figure.add_subplot(grid[0, k])
        low, high, beyond = percentile_range(picture)
        colors: Any = {"cmap": "viridis" if k else "inferno", "vmin": low, "vmax": high}
        shown = axes.imshow(picture, extent=extent, **colors)
        axes.plot(*middle, "o", mfc="none", mec="white")
        axes.set_title(title)
        color_bar(shown, axes, "", extend=beyond)

    # Plot the response of the pixel
    plot = figure.add_subplot(grid[1, :])
    for style, color, (label, curve) in zip(".-", palette().lines, curves.items(), strict=False):
        steps: Any = {"drawstyle": "default" if axis else "steps-mid", "label": label}
        plot.plot(places, curve[row, column], style, color=color, **steps)
    units = "counts" if name == "counts" else attrs["units"]
    plot.set(xlabel=AXES.get(str(axis), "frame and tap"), ylabel=units)
    plot.legend(title=f"pixel ({x}, {y})", frameon=False)
    cycles = int(measured["cycles"].max())
    figure.suptitle(wrap_text(f"{attrs['scene']}, {cycles} cycles", width))
    return figure
