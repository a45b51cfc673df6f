"""Pictures of light in flight: tone mapping, animations, and a summary of a render."""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from . import checks
from .dataset import first_pixel, time_axis
from .units import ns_to_opl, opl_to_ns

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Weights of linear R, G, B in luminance (ITU-R BT.709)."""

# ------------------------------------------------------------------------------ tone mapping

_SAMPLES = 1 << 21


def auto_exposure(values: Any, *, percentile: float = 99.5) -> float:
    """The gain that shows the `percentile` of all light as white.

    Only finite values above zero count, so that dark bins and pixels do not matter. Of more than
    two million values a fixed random choice is used.

    Args:
        values: Linear values of any shape: one image or a whole sequence.
        percentile: In (0, 100].

    Returns:
        Gain, finite and above 0; 1 where there is no light.

    Raises:
        ValueError: The percentile is out of range.

    Example:
        >>> auto_exposure(np.full((2, 2, 3), 0.5))
        2.0
    """
    if not 0 < percentile <= 100:
        raise ValueError(f"percentile = {percentile!r}: must be above 0 and at most 100")
    flat = np.asarray(values).reshape(-1)
    lit = flat[:0]
    if flat.size > _SAMPLES:
        lit = _lit(flat[np.random.default_rng(0).integers(0, flat.size, _SAMPLES)])
    if lit.size < 1000:  # also for a large but nearly dark sequence
        lit = _lit(flat)
    white = float(np.percentile(lit, percentile)) if lit.size else 1.0
    return 1 / white if math.isfinite(1 / white) else 1.0


def _lit(values: np.ndarray) -> np.ndarray:
    return values[(values > 0) & np.isfinite(values)]


def tonemap(values: Any, *, exposure: float | None = None, percentile: float = 99.5) -> np.ndarray:
    """Turn linear radiance into an sRGB picture.

    Args:
        values: Linear values, (height, width), (height, width, 1) or (height, width, 3). They are
            not changed. Negative values show as black, infinite ones as white, and pixels with a
            NaN (unfinished) as a dark grey hatch.
        exposure: Gain; `1` is shown as white after it. None takes `auto_exposure` of `values`;
            give one number for all frames of a sequence to keep them comparable.
        percentile: For `auto_exposure`, in (0, 100].

    Returns:
        uint8 (height, width, 3).

    Raises:
        ValueError: Another shape, or an exposure that is not a finite number above 0.

    Example:
        >>> tonemap(np.array([[0.0, 0.5, 1.0]]), exposure=1)[..., 0]
        array([[  0, 188, 255]], dtype=uint8)
    """
    linear = np.asarray(values)
    if linear.ndim == 2:
        linear = linear[..., None]
    if linear.ndim != 3 or linear.shape[2] not in (1, 3):
        raise ValueError(
            f"values with shape {np.shape(values)}: must be (height, width) or "
            "(height, width, channels) with 1 or 3 channels"
        )
    if exposure is None:
        exposure = auto_exposure(linear, percentile=percentile)
    check_exposure(exposure)
    unfinished = np.isnan(linear).any(axis=2)
    with np.errstate(over="ignore"):
        shown = np.clip(np.nan_to_num(linear * np.float32(exposure), nan=0), 0, 1)
    srgb = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    picture = np.rint(255 * srgb).astype(np.uint8)
    picture = np.repeat(picture, 3, axis=2) if picture.shape[2] == 1 else picture
    if unfinished.any():
        rows, columns = np.nonzero(unfinished)
        picture[rows, columns] = np.where((rows + columns) % 8 < 4, 38, 58)[:, None]
    return picture


def check_exposure(exposure: Any) -> None:
    """Refuse an exposure that is not a finite number above 0."""
    if not (isinstance(exposure, int | float | np.number) and 0 < exposure < math.inf):
        raise ValueError(f"exposure = {exposure!r}: must be a finite number above 0")


# ------------------------------------------------------------------------------------- input


@dataclass
class Transient:
    """A transient image with its time axis and the index of its first pixel."""

    values: np.ndarray
    """(height, width, bins, channels), 1 or 3 channels."""
    start_opl: float
    bin_width_opl: float
    x0: int = 0
    y0: int = 0
    quantity: str = "radiance per bin"

    @classmethod
    def of(cls, data: Any, start_opl: float | None = None, bin_width_opl: float | None = None):
        """Take a Dataset of `render`, or an array with its time axis, and check it."""
        extra: dict[str, Any] = {}
        if hasattr(data, "data_vars"):
            start, width = time_axis(data)
            start_opl = start if start_opl is None else start_opl
            bin_width_opl = width if bin_width_opl is None else bin_width_opl
            x0, y0 = first_pixel(data)
            units = re.sub(r"\^(-?\d+)", r"$^{\1}$", data.attrs["units"])
            quantity = f"{data.attrs['quantity']} [{units}]"
            extra = {"x0": x0, "y0": y0, "quantity": quantity}
            data = data["transient"].values
        start = checks.metres("start_opl", start_opl)
        width = checks.metres("bin_width_opl", bin_width_opl, positive=True)
        values = np.asarray(data)
        if values.ndim == 3:
            values = values[..., None]
        if values.ndim != 4 or values.shape[3] not in (1, 3) or 0 in values.shape:
            raise ValueError(
                f"data with shape {np.shape(data)}: must be (height, width, bins) or "
                "(height, width, bins, channels) with 1 or 3 channels last"
            )
        if values.dtype.kind not in "fiu":
            raise ValueError(f"data of type {values.dtype}: must hold real numbers")
        return cls(values, start, width, **extra)

    @property
    def opl(self) -> np.ndarray:
        """Bin centres [m]."""
        return self.start_opl + (np.arange(self.values.shape[2]) + 0.5) * self.bin_width_opl

    def label(self, index: int) -> str:
        """Time and path length at the centre of bin `index`, with digits that tell bins apart."""
        opl = float(self.opl[index])
        width = self.bin_width_opl
        in_ns, in_m = (max(2, 1 - math.floor(math.log10(w))) for w in (opl_to_ns(width), width))
        return f"t = {opl_to_ns(opl):.{in_ns}f} ns   OPL = {opl:.{in_m}f} m"

    def pixel(self, x: Any, y: Any) -> np.ndarray:
        """Response (bins, channels) of pixel (x, y)."""
        height, width = self.values.shape[:2]
        column = checks.integer("x", x, self.x0, self.x0 + width - 1) - self.x0
        row = checks.integer("y", y, self.y0, self.y0 + height - 1) - self.y0
        return self.values[row, column]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge in pixels, for `imshow`."""
        height, width = self.values.shape[:2]
        return (self.x0 - 0.5, self.x0 + width - 0.5, self.y0 + height - 0.5, self.y0 - 0.5)


# ------------------------------------------------------------------- animation and one pixel


def visualize_transient(
    data: Any, start_opl: float | None = None, bin_width_opl: float | None = None
) -> FuncAnimation:
    """Animate light moving through the scene; the title shows the time of each bin's centre.

    In a notebook show it with `HTML(animation.to_jshtml())`; `animation.save("light.gif")` writes
    it (`save_video` does so faster and at full resolution).

    Args:
        data: Array (height, width, bins) or (height, width, bins, channels), or a Dataset.
        start_opl: Where the first bin starts [m]; a Dataset knows it.
        bin_width_opl: Width of a bin [m], above 0; a Dataset knows it.

    Returns:
        A `matplotlib.animation.FuncAnimation` of one frame a bin, 20 a second, all at the same
        exposure. It is made outside of pyplot.

    Raises:
        ValueError: Another shape, or a time axis that is missing or not positive.

    Example:
        >>> animation = visualize_transient(np.ones((4, 6, 10)), 3.5, 0.02)
        >>> html = animation.to_jshtml()
    """
    from matplotlib.animation import FuncAnimation

    sequence = Transient.of(data, start_opl, bin_width_opl)
    exposure = auto_exposure(sequence.values)
    figure = _figure(5.0, 5.0 * min(2.0, max(0.5, _aspect(sequence))) + 0.35)
    axes = figure.add_subplot()

    def picture(index: int) -> np.ndarray:
        return tonemap(sequence.values[:, :, index], exposure=exposure)

    image = axes.imshow(picture(0), extent=sequence.extent, interpolation="nearest")
    title = axes.set_title(sequence.label(0))
    _pixel_axes(axes)

    def update(index: int) -> list[Any]:
        image.set_data(picture(index))
        title.set_text(sequence.label(index))
        return [image, title]

    return FuncAnimation(figure, update, frames=sequence.values.shape[2], interval=50, blit=False)


def plot_pixel_transient(
    data: Any, x: int, y: int, start_opl: float | None = None, bin_width_opl: float | None = None
) -> Figure:
    """Plot what one pixel sees over time, a line for each channel.

    Args:
        data: Array (height, width, bins) or (height, width, bins, channels), or a Dataset.
        x: Column; for a cropped Dataset in pixels of the whole film, as its coordinates are.
        y: Row, likewise.
        start_opl: Where the first bin starts [m]; a Dataset knows it.
        bin_width_opl: Width of a bin [m], above 0; a Dataset knows it.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot; time in ns at bin centres.

    Raises:
        ValueError: Another shape, a pixel outside, or a time axis that is missing or not positive.

    Example:
        >>> figure = plot_pixel_transient(
        ...     np.ones((4, 6, 10)), 5, 3, start_opl=3.5, bin_width_opl=0.02
        ... )
        >>> figure.axes[0].get_xlabel()
        'time [ns]'
    """
    sequence = Transient.of(data, start_opl, bin_width_opl)
    response = sequence.pixel(x, y)
    figure = _figure(7.0, 3.8)
    axes = figure.add_subplot()
    styles = zip(("tab:red", "tab:green", "tab:blue"), "RGB", strict=True)
    for channel, (color, name) in enumerate(styles if response.shape[1] == 3 else [("black", "L")]):
        axes.plot(opl_to_ns(sequence.opl), response[:, channel], color=color, label=name)
    if response.shape[1] == 3:
        axes.legend(frameon=False)
    axes.set_title(f"pixel ({x}, {y})")
    _time_axes(axes, sequence)
    return figure


# ----------------------------------------------------------------------------------- summary


def summary_figure(dataset: xr.Dataset, pixels: Any = None) -> Figure:
    """One page about a render: the steady image, when each pixel is brightest, a few responses.

    Args:
        dataset: The result of `render`.
        pixels: (x, y) pairs to plot, in the Dataset's pixel coordinates. By default a bright
            pixel, one that peaks early and one that peaks late.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot; `figure.savefig(...)` writes it.

    Raises:
        ValueError: A pixel outside the image.

    Example:
        >>> summary_figure(dataset).savefig("summary.png")  # doctest: +SKIP
    """
    sequence = Transient.of(dataset)
    energy = np.nan_to_num(luminance(sequence.values))
    lit = energy.max(axis=2) > 0
    peak_ns = np.where(lit, opl_to_ns(sequence.opl)[energy.argmax(axis=2)], np.nan)
    if pixels is None:
        pixels = _telling_pixels(energy.sum(axis=2), peak_ns, sequence)
    responses = [luminance(sequence.pixel(x, y)) for x, y in pixels]

    aspect = min(2.0, max(0.4, _aspect(sequence)))
    figure = _figure(10.0, 4.0 * aspect + 4.4)
    grid = figure.add_gridspec(2, 2, height_ratios=[4.0 * aspect + 0.6, 3.2])
    steady, peak, plot = (
        figure.add_subplot(grid[0, 0]),
        figure.add_subplot(grid[0, 1]),
        figure.add_subplot(grid[1, :]),
    )
    steady.imshow(tonemap(dataset["steady"].values, percentile=98), extent=sequence.extent)
    steady.set_title("steady image")
    peak.set_facecolor("0.85")
    shown = peak.imshow(peak_ns, extent=sequence.extent, cmap="viridis", interpolation="nearest")
    peak.set_title("time of the brightest bin")
    figure.colorbar(shown, ax=peak, label="time [ns]")
    for axes in (steady, peak):
        _pixel_axes(axes)
    for index, ((x, y), response) in enumerate(zip(pixels, responses, strict=True)):
        color = f"C{index % 10}"
        plot.plot(opl_to_ns(sequence.opl), response, color=color, lw=1.2, label=f"({x}, {y})")
        for axes in (steady, peak):
            axes.plot(x, y, "o", mfc=color, mec="white", ms=7)
    plot.legend(title="pixel", frameon=False)
    _time_axes(plot, sequence)
    figure.suptitle(_title(dataset))
    return figure


def luminance(values: np.ndarray) -> np.ndarray:
    """Luminance of values with 1 or 3 channels in the last axis."""
    return values[..., 0] if values.shape[-1] == 1 else values @ LUMINANCE


def _title(dataset: xr.Dataset) -> str:
    attrs = dataset.attrs
    title = (
        f"{attrs['scene']}, {attrs['spp']} spp, "
        f"{100 * attrs['energy_outside_window']:.1f} % of the energy outside the window"
    )
    return title if attrs["complete"] else f"{title} (interrupted)"


def _telling_pixels(energy: np.ndarray, peak_ns: np.ndarray, sequence: Transient) -> list[Any]:
    """A bright, an early and a late pixel among those with at least median light."""
    if not (energy > 0).any():
        return [(sequence.x0 + energy.shape[1] // 2, sequence.y0 + energy.shape[0] // 2)]
    bright = np.flatnonzero(energy >= np.median(energy[energy > 0]))
    by_energy = bright[np.argsort(energy.flat[bright], kind="stable")]
    by_time = bright[np.argsort(peak_ns.flat[bright], kind="stable")]
    # Not the extremes, which are the light source itself, edges and noise.
    chosen = [by_energy[int(0.9 * (len(bright) - 1))]]
    chosen += [by_time[int(share * (len(bright) - 1))] for share in (0.05, 0.97)]
    rows, columns = np.unravel_index(list(dict.fromkeys(map(int, chosen))), energy.shape)
    return [
        (int(x) + sequence.x0, int(y) + sequence.y0) for x, y in zip(columns, rows, strict=True)
    ]


def _pixel_axes(axes: Axes) -> None:
    axes.set_xlabel("x [pixel]")
    axes.set_ylabel("y [pixel]")
    axes.locator_params(integer=True)


def _time_axes(axes: Axes, sequence: Transient) -> None:
    """Time below, path length above, quantity on the left."""
    axes.set_xlabel("time [ns]")
    axes.set_ylabel(sequence.quantity)
    axes.set_xlim(opl_to_ns(sequence.opl[0]), opl_to_ns(sequence.opl[-1]) + 1e-9)
    axes.grid(alpha=0.3)
    above = axes.secondary_xaxis("top", functions=(ns_to_opl, opl_to_ns))
    above.set_xlabel("optical path length [m]")


def _aspect(sequence: Transient) -> float:
    return sequence.values.shape[0] / sequence.values.shape[1]


def _figure(width: float, height: float) -> Figure:
    """A figure that no pyplot knows of, and that a notebook shows as the picture it is."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class Picture(Figure):
        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format="png")
            return stream.getvalue()

    figure = Picture(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
