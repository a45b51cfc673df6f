"""Summary of a render on one page."""

from typing import Annotated, Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..labels import FILM, intensity, read, with_energy
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from ..runtime.plots import COLUMN, color_bar, percentile_range, wrap_text
from ..runtime.progress import status
from ..signals.color import luminance
from ..signals.units import opl_to_ns
from .tone import tonemap
from .transient_figures import (
    Transient,
    explain_hatch,
    map_axes,
    picture_aspect,
    pixel_axes,
    time_axes,
)


@status("Drawing the summary")
@in_style()
def summary_figure(dataset: Annotated[xr.Dataset, FILM], pixels: Any = None) -> Figure:
    """Draw a render on one page: steady image, time of the brightest bin, some responses.

    Args:
        dataset: The result of `render`, or a part of it. For Stokes vectors, S0 is drawn.
        pixels: (x, y) pairs to plot, in the Dataset's pixel coordinates. By default three pixels: a
            bright pixel, a pixel with an early peak and a pixel with a late peak.

    Raises:
        ValueError: A pixel outside the image.

    Example:
        >>> from tofrender import cornell_box, render
        >>> dataset = render(cornell_box(width=16, height=16), spp=16, window="auto")
        >>> [axes.get_title() for axes in summary_figure(dataset).axes[:2]]
        ['steady image', 'time of the brightest bin']
    """
    # Check the arguments
    dataset = with_energy(intensity(read(dataset, FILM, "dataset"), "dataset"), "dataset")
    for name in ("scene", "spp", "energy_outside_window", "complete"):
        if name not in dataset.attrs:
            raise ValueError(f"dataset: attribute {name} is missing; must be as `render` writes it")

    # Choose the pixels
    sequence = Transient.of(dataset)
    energy, peak_ns = sequence.brightest()
    if pixels is None:
        pixels = _default_pixels(energy, peak_ns, sequence)
    pairs = _pairs(pixels)
    try:
        responses = [luminance(sequence.pixel(x, y)) for x, y in pairs]
    except ValueError as error:
        raise ValueError(f"pixels: {error}") from None

    # Lay out the figure
    dark = np.isnan(peak_ns)
    width = figure_width(7.0)
    narrow = width < COLUMN
    title = wrap_text(_title(dataset), width)
    figure, steady, peak, plot, bar = _panels(
        width, picture_aspect(*sequence.size, low=0.4, high=2.0), title, bool(dark.any())
    )

    # Draw the steady image, and the time of the brightest bin
    steady.imshow(tonemap(dataset["steady"].values, percentile=98), extent=sequence.extent)
    steady.set_title("steady image")
    first, last, beyond = percentile_range(peak_ns)
    times = {"cmap": "viridis", "vmin": first, "vmax": last}
    shown = map_axes(peak, peak_ns, extent=sequence.extent, **times)
    peak.set_title("brightest bin" if narrow else "time of the brightest bin")
    label = "time of the brightest bin [ns]" if narrow else "time [ns]"
    color_bar(shown, cax=bar, label=label, below=narrow, extend=beyond)
    pixel_axes(steady)
    peak.set_ylabel("")
    peak.tick_params(labelleft=False)

    # Plot the responses, and mark their pixels
    for index, ((x, y), response) in enumerate(zip(pairs, responses, strict=True)):
        color = palette().lines[index % 7]
        mark = "osD^v<>"[index % 7]
        plot.plot(opl_to_ns(sequence.opl), response, color=color)
        plot.plot([], [], color=color, marker=mark, label=f"({x}, {y})")
        for axes in (steady, peak):
            axes.plot(x, y, mark, mfc=color, mec="white", ms=6, mew=1)
    plot.legend(title="pixel", frameon=False)
    time_axes(plot, sequence)
    explain_hatch(figure, dark)
    return figure


def _title(dataset: xr.Dataset) -> str:
    """Return a title with the scene, the samples, and the energy outside the window."""
    outside = f"{100 * dataset.attrs['energy_outside_window']:.1f} % of the energy outside"
    title = f"{dataset.attrs['scene']}, {dataset.attrs['spp']} spp, {outside} the render's window"
    return title if dataset.attrs["complete"] else f"{title} (interrupted)"


def _panels(
    width: float, aspect: float, title: str, hatched: bool
) -> tuple[Figure, Axes, Axes, Axes, Axes]:
    """Return a figure with axes for both pictures, their color bar and the responses.

    The axes have fixed places [inches]. A layout by Matplotlib would draw the figure twice.
    """
    # Sizes of the pictures
    narrow = width < COLUMN
    left, right = (0.7, 0.12) if narrow else (0.6, 0.14)
    gap = 0.12
    bar_width = 0.0 if narrow else 0.62  # Color bar with its numbers
    wide = (width - left - gap - bar_width - right) / 2
    top = 0.1 + 0.155 * (title.count("\n") + 1) + 0.21
    high = aspect * wide

    # Places below the pictures
    below = top + high + 0.36
    bar_top = below + 0.06
    plot_top = below + (0.85 if narrow else 0.45)
    plot_high = 0.6 + 0.2 * width
    height = plot_top + plot_high + 0.4 + 0.2 * hatched
    figure = new_figure(width, height, layout=None)
    figure.suptitle(title, y=1 - 0.07 / height, va="top")

    def add(x: float, y: float, across: float, down: float, **options: Any) -> Axes:
        box = (x / width, 1 - (y + down) / height, across / width, down / height)
        return figure.add_axes(box, **options)

    steady = add(left, top, wide, high)
    peak = add(left + wide + gap, top, wide, high, sharex=steady, sharey=steady)
    plot = add(left, plot_top, width - left - right, plot_high)
    if narrow:
        bar = add(left, bar_top, 2 * wide + gap, 0.08)
    else:
        bar = add(left + 2 * wide + gap + 0.1, top, 0.12, high)
    return figure, steady, peak, plot, bar


def _pairs(pixels: Any) -> list[tuple[Any, Any]]:
    """Return pixels as pairs of column and row."""
    try:
        pairs = [(x, y) for x, y in pixels]
    except (TypeError, ValueError):
        pairs = None
    if pairs is None or isinstance(pixels, str | bytes | dict):
        raise ValueError(f"pixels = {checks.quote(pixels)}: must be pairs (x, y)")
    return pairs


def _default_pixels(energy: np.ndarray, peak_ns: np.ndarray, sequence: Transient) -> list[Any]:
    """Return a bright, an early and a late pixel. All have at least the median light."""
    if not (energy > 0).any():
        return [(sequence.x0 + energy.shape[1] // 2, sequence.y0 + energy.shape[0] // 2)]
    bright = np.flatnonzero(energy >= np.median(energy[energy > 0]))
    by_energy = bright[np.argsort(energy.flat[bright], kind="stable")]
    by_time = bright[np.argsort(peak_ns.flat[bright], kind="stable")]

    # Avoid the extremes, which are the light source itself, edges and noise
    last = len(bright) - 1
    chosen = [by_energy[int(0.9 * last)], by_time[int(0.05 * last)], by_time[int(0.97 * last)]]
    rows, columns = np.unravel_index(list(dict.fromkeys(map(int, chosen))), energy.shape)
    return [*zip((columns + sequence.x0).tolist(), (rows + sequence.y0).tolist(), strict=True)]
