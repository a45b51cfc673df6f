"""Figures of moving scenes: light over range and velocity, and maps of velocities."""

from typing import Annotated, Any

import numpy as np
import xarray as xr
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..labels import PIXELS, RANGE_RATES, read, read_array, require_consecutive
from ..motion.fmcw import Fmcw, checked_film
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure
from ..runtime.plots import color_bar, fit_height, wrap_text
from .transient_figures import explain_hatch, map_axes, picture_aspect, typeset

DECADES = 4  # Range of the colors of light, in powers of ten
CELLS_PER_INCH = 60  # Cells of a map, few enough that each cell covers dots of the picture


@in_style()
def range_velocity_map(
    film: Annotated[xr.Dataset, RANGE_RATES],
    *,
    lidar: Fmcw | None = None,
    pixel: tuple[int, int] | None = None,
    title: str | None = None,
) -> Figure:
    """Draw light over range, half the path length, and velocity, half its rate of change.

    If a film has more bins than the figure can show, each cell of the map shows the largest of its
    bins. A single bright bin therefore keeps its color.

    Args:
        film: A Dataset of `range_rate`, or a part of it, `film.isel(x=..., y=...)`.
        lidar: FMCW lidar. Its resolution is drawn as a rectangle. None omits the rectangle.
        pixel: Column and row, in the Dataset's coordinates. By default, all pixels are added.
        title: Title of the figure. By default the name of the scene.

    Raises:
        ValueError: A Dataset of another kind, or a pixel outside the image.

    Example:
        >>> import tofrender
        >>> quick = {"size": (8, 8), "spp": 4, "bins": 50, "window": (3, 60), "progress": False}
        >>> light = tofrender.range_rate("cornell_box", **quick)
        >>> range_velocity_map(light).axes[0].get_ylabel()
        'velocity, half the rate [m/s]'
    """
    # Check the arguments
    film = read(film, RANGE_RATES, "film")
    require_consecutive(film, "film")
    light, *axes_of_film = checked_film(film)
    checks.instance("lidar", lidar, Fmcw | None, "an Fmcw or None")
    title = checks.text("title", title)

    # Choose the pixel
    if pixel is None:
        values = light.sum(axis=(0, 1))
    else:
        places = [film[axis].values for axis in "xy"]
        found = checks.items("pixel", pixel, 2, "column and row")
        column, row = (
            checks.integer("pixel", each, int(place[0]), int(place[-1])) - int(place[0])
            for each, place in zip(found, places, strict=True)
        )
        values = light[row, column]

    # Draw the map
    wide = figure_width(5.5)
    figure = new_figure(wide, 0.75 * wide)
    axes = figure.add_subplot()
    (left, right), (low, high) = (
        (each.start / 2, (each.start + each.count * each.width) / 2) for each in axes_of_film
    )
    most = float(values.max()) or 1.0
    scale: Any = {"cmap": "inferno", "norm": LogNorm(most / 10**DECADES, most, clip=True)}
    extent = (left, right, low, high)
    width_inches, height_inches = figure.get_size_inches()
    most_cells = int(CELLS_PER_INCH * width_inches), int(CELLS_PER_INCH * height_inches)
    cells = largest_of_cells(values, most_cells)
    options = scale | {"origin": "lower", "aspect": "auto", "interpolation": "nearest"}
    shown = axes.imshow(cells.T, extent=extent, **options)

    # Draw a cell of the lidar's resolution
    if lidar is not None:
        along, across = (each / 2 for each in lidar.resolution)
        corner = left + 0.03 * (right - left), low + 0.03 * (high - low)
        cell = Rectangle(corner, along, across, fc="none", ec="white", label="resolution cell")
        axes.add_patch(cell)
        axes.legend(loc="upper right", labelcolor="white", facecolor="black", framealpha=0.5)

    # Label axes and colors
    axes.set(xlabel="range, half the path length [m]", ylabel="velocity, half the rate [m/s]")
    bar = figure.colorbar(shown, ax=axes, extend="min", aspect=22, pad=0.02)
    what = "radiance per bin" if cells.shape == values.shape else "largest radiance per bin"
    bar.set_label(f"{what} [{typeset(film['radiance'].attrs.get('units', '1'))}]")
    seen = "all pixels" if pixel is None else f"pixel ({pixel[0]}, {pixel[1]})"
    name = str(film.attrs.get("scene", "")) if title is None else title
    axes.set_title(wrap_text(", ".join(filter(None, [name, seen])), wide))
    return figure


def largest_of_cells(values: np.ndarray, most_cells: tuple[int, int]) -> np.ndarray:
    """Reduce both axes to `most_cells` or fewer. A cell has the largest value that it covers."""
    for axis, most in enumerate(most_cells):
        count = values.shape[axis]
        cells = min(most, count)
        largest = []
        for cell in range(cells):
            first = cell * count // cells
            stop = -(-(cell + 1) * count // cells)
            largest.append(values.take(range(first, stop), axis).max(axis))
        values = np.stack(largest, axis)
    return values


@in_style()
def velocity_map(
    rate: Annotated[xr.DataArray, PIXELS],
    *,
    limit_m_s: float | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the velocity of each pixel, half the rate of change of its path length.

    The title states which rate the map shows, as the attribute `long_name` of `rate` describes it:
    `doppler_rate` measures the change of the path length at a fixed pixel, and FMCW lidars measure
    the change along the moving material. These rates differ if a tilted surface slides through the
    view. Pixels without light are hatched, and velocities above the limit are clipped.

    Args:
        rate: Result of `doppler_rate`, or `rate` of `Fmcw.estimates`, (y, x) [m/s].
        limit_m_s: Velocity at the ends of the scale [m/s], for example the largest velocity in the
            scene. By default, five percent of the pixels are faster.
        title: Title of the figure, or None.

    Raises:
        ValueError: `rate` is not a DataArray of rates.

    Example:
        >>> import xarray as xr
        >>> velocity_map(xr.DataArray(np.ones((4, 6)), dims=("y", "x"))).axes[0].get_title()
        'receding (red), approaching (blue)'
    """
    # Check the arguments
    checks.instance("rate", rate, xr.DataArray, "a DataArray of doppler_rate")
    rate = read_array(rate, PIXELS, "rate")
    require_consecutive(rate, "rate")
    checks.require("rate", rate, rate.dtype.kind == "f", "real numbers")
    title = checks.text("title", title)

    # Choose the scale
    velocity = rate.values / 2
    known = np.abs(velocity[np.isfinite(velocity)])
    if limit_m_s is not None:
        fastest = checks.number("limit_m_s", limit_m_s, unit="m/s", positive=True)
    else:
        fastest = float(np.percentile(known, 95)) if known.any() else 0.0
        fastest = fastest or float(known.max(initial=0.0)) or 1.0

    # Draw the map
    wide = figure_width(4.6)
    figure = new_figure(
        wide, wide * picture_aspect(*rate.shape, low=0.4, high=2.0) + 1.0, "compressed"
    )
    axes = figure.add_subplot()
    x, y = (int(rate[axis][0]) for axis in "xy")
    extent = (x - 0.5, x + rate.shape[1] - 0.5, y + rate.shape[0] - 0.5, y - 0.5)
    scale: Any = {"cmap": "RdBu_r", "vmin": -fastest, "vmax": fastest, "extent": extent}
    shown = map_axes(axes, velocity, **scale)
    meaning = str(rate.attrs.get("long_name", ""))
    directions = "receding (red), approaching (blue)"
    axes.set_title(wrap_text("\n".join(filter(None, [meaning, directions])), wide - 1))
    beyond = "both" if (known > fastest).any() else "neither"
    color_bar(shown, axes, "velocity, half the rate [m/s]", extend=beyond)
    if title is not None:
        figure.suptitle(wrap_text(title, wide))
    explain_hatch(figure, np.isnan(velocity))
    fit_height(figure)
    return figure
