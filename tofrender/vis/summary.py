"""Summary of a render on one page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..rendering.dataset import check_dataset
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from ..runtime.plots import COLUMN, colour_bar, percentile_range, wrap_text
from ..runtime.progress import status
from ..signals.colour import luminance
from ..signals.units import opl_to_ns
from .tone import tonemap
from .transient import Transient, explain_hatch, map_axes, picture_aspect, pixel_axes, time_axes

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure


@status("Drawing the summary")
@in_style()
def summary_figure(dataset: xr.Dataset, pixels: Any = None) -> Figure:
    """Draw a render on one page: steady image, time of the brightest bin, some responses.

    Args:
        dataset: The result of `render`.
        pixels: (x, y) pairs to plot, in the Dataset's pixel coordinates. By default a bright
            pixel, one that peaks early and one that peaks late.

    Raises:
        ValueError: A pixel outside the image.

    Example:
        >>> from tofrender import cornell_box, render
        >>> dataset = render(cornell_box(width=16, height=16), spp=16, window="auto")
        >>> [axes.get_title() for axes in summary_figure(dataset).axes[:2]]
        ['steady image', 'time of the brightest bin']
    """
    check_dataset(dataset)
    for name in ("scene", "spp", "energy_outside_window", "complete"):
        if name not in dataset.attrs:
            raise ValueError(f"dataset: attribute {name} is missing; must be as `render` writes it")
    sequence = Transient.of(dataset)
    energy, peak_ns = sequence.brightest()
    if pixels is None:
        pixels = _default_pixels(energy, peak_ns, sequence)
    pairs = _pairs(pixels)
    try:
        responses = [luminance(sequence.pixel(x, y)) for x, y in pairs]
    except ValueError as error:
        raise ValueError(f"pixels: {error}") from None

    width = figure_width(7.0)
    narrow = width < COLUMN
    pictures = 0.42 * width * picture_aspect(*sequence.size, low=0.4, high=2.0)
    pictures += 1.1 if narrow else 0.7
    below = 1.0 + 0.2 * width
    figure = new_figure(width, pictures + below + 0.5)
    grid = figure.add_gridspec(2, 2, height_ratios=[pictures, below])
    steady = figure.add_subplot(grid[0, 0])
    peak = figure.add_subplot(grid[0, 1], sharex=steady, sharey=steady)
    plot = figure.add_subplot(grid[1, :])
    steady.imshow(tonemap(dataset["steady"].values, percentile=98), extent=sequence.extent)
    steady.set_title("steady image")
    first, last, beyond = percentile_range(peak_ns)
    times = {"cmap": "viridis", "vmin": first, "vmax": last}
    shown = map_axes(peak, peak_ns, extent=sequence.extent, **times)
    peak.set_title("brightest bin" if narrow else "time of the brightest bin")
    if narrow:
        label = "time of the brightest bin [ns]"
        colour_bar(shown, [steady, peak], label, below=True, extend=beyond, aspect=30)
    else:
        colour_bar(shown, peak, "time [ns]", extend=beyond)
    pixel_axes(steady)
    peak.set_ylabel("")
    peak.tick_params(labelleft=False)
    for index, ((x, y), response) in enumerate(zip(pairs, responses, strict=True)):
        color, mark = palette().lines[index % 7], "osD^v<>"[index % 7]
        plot.plot(opl_to_ns(sequence.opl), response, color=color)
        plot.plot([], [], color=color, marker=mark, label=f"({x}, {y})")
        for axes in (steady, peak):
            axes.plot(x, y, mark, mfc=color, mec="white", ms=6, mew=1)
    plot.legend(title="pixel", frameon=False)
    time_axes(plot, sequence)
    outside = f"{100 * dataset.attrs['energy_outside_window']:.1f} % of the energy outside"
    title = f"{dataset.attrs['scene']}, {dataset.attrs['spp']} spp, {outside} the render's window"
    title += "" if dataset.attrs["complete"] else " (interrupted)"
    figure.suptitle(wrap_text(title, width))
    explain_hatch(figure, np.isnan(peak_ns))
    return figure


def _pairs(pixels: Any) -> list[tuple[Any, Any]]:
    """Pixels as pairs of column and row."""
    try:
        pairs = [(x, y) for x, y in pixels]
    except (TypeError, ValueError):
        pairs = None
    if pairs is None or isinstance(pixels, str | bytes | dict):
        raise ValueError(f"pixels = {checks.quote(pixels)}: must be pairs (x, y)")
    return pairs


def _default_pixels(energy: np.ndarray, peak_ns: np.ndarray, sequence: Transient) -> list[Any]:
    """A bright, an early and a late pixel among those with at least median light."""
    if not (energy > 0).any():
        return [(sequence.x0 + energy.shape[1] // 2, sequence.y0 + energy.shape[0] // 2)]
    bright = np.flatnonzero(energy >= np.median(energy[energy > 0]))
    by_energy = bright[np.argsort(energy.flat[bright], kind="stable")]
    by_time = bright[np.argsort(peak_ns.flat[bright], kind="stable")]
    # Not the extremes, which are the light source itself, edges and noise.
    last = len(bright) - 1
    chosen = [by_energy[int(0.9 * last)], by_time[int(0.05 * last)], by_time[int(0.97 * last)]]
    rows, columns = np.unravel_index(list(dict.fromkeys(map(int, chosen))), energy.shape)
    return [*zip((columns + sequence.x0).tolist(), (rows + sequence.y0).tolist(), strict=True)]
