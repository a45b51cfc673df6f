"""Single pictures of light in flight: arrival times of all light, and one time gate."""

import math
from typing import Annotated, Any

import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from ..labels import TRANSIENT
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure
from ..runtime.plots import color_bar, fit_height, percentile_range, wrap_text
from ..signals.color import luminance
from ..signals.units import opl_to_ns
from .color_maps import hue_map, time_map
from .tone import auto_exposure, tonemap
from .transient_figures import Transient, explain_hatch, picture_aspect, pixel_axes, read_light

STYLES = {"arrival": "arrival time", "peak": "peak time", "rainbow": "isochrones"}
"""Titles by style."""


@in_style()
def light_in_flight(
    data: Annotated[Any, TRANSIENT],
    start_opl: float | None = None,
    bin_width_opl: float | None = None,
    *,
    style: str = "arrival",
    period_ns: float | None = None,
    exposure: float | None = None,
) -> Figure:
    """Show when light arrives and how much light arrives in one picture.

    The brightness of a pixel is its brightness in the steady image. Its color shows the time:

    - `"arrival"`: the mean arrival time, weighted by luminance;
    - `"peak"`: the center of the brightest bin;
    - `"rainbow"`: bands of equal arrival time, which repeat every `period_ns`. The hue is the
      argument of the phasor P = sum over bins of L exp(2πi t / period_ns). The saturation is
      sqrt(abs P / sum of L), so that pixels with light at many times are gray.

    Pixels without light in the window are gray. Unfinished pixels (NaN) are hatched.

    Args:
        data: A Dataset, or an array (height, width, bins) or (height, width, bins, channels). For
            Stokes vectors, S0 is shown. Without a steady image, the sum over bins is used.
        start_opl: Start of the first bin [m]. By default the start of the Dataset.
        bin_width_opl: Width of a bin [m], above 0. By default the width of the Dataset.
        style: "arrival", "peak" or "rainbow".
        period_ns: Period of "rainbow" [ns], at least two bins; by default about an eighth of the
            range of mean arrival times.
        exposure: Gain of the steady image; by default its 98th percentile is white.

    Raises:
        ValueError: Another shape, an unknown style, a period without "rainbow" or below two bins,
            a bad exposure, or a time axis that is missing or not positive.

    Example:
        >>> figure = light_in_flight(np.ones((4, 6, 10)), 3.5, 0.02, style="rainbow", period_ns=0.2)
        >>> figure.axes[0].get_title()
        'isochrones'
    """
    checks.one_of("style", style, STYLES)
    data = read_light(data) if isinstance(data, xr.Dataset) else data
    sequence = Transient.of(data, start_opl, bin_width_opl)
    if period_ns is not None:
        _check_period(period_ns, style, sequence)
    if exposure is not None:
        checks.number("exposure", exposure, positive=True)

    # Brightness, and pixels that are not finished
    has_steady = isinstance(data, xr.Dataset) and "steady" in data
    steady = data["steady"].values if has_steady else _sum_over_bins(sequence)
    unfinished = np.asarray(np.isnan(steady).any(axis=2))
    for (rows, columns, *_), values in sequence.values.pieces():
        unfinished[rows, columns] |= np.isnan(values).any(axis=(2, 3))

    # Color by time
    extend = "neither"
    if style == "rainbow":
        color, scale, label = _rainbow(sequence, period_ns)
    elif style == "peak":
        color, scale, extend = _colors_of_times(sequence.brightest()[1])
        label = "time of the brightest bin [ns]"
    else:
        color, scale, extend = _colors_of_times(_mean_ns(sequence))
        label = "mean arrival time [ns]"

    # Multiply both
    gray = tonemap(luminance(steady), exposure=exposure, percentile=98)
    picture = np.where(unfinished[..., None], tonemap(np.full(gray.shape, np.nan)), color * gray)
    parts = picture.astype(np.uint8), STYLES[style], scale, label, extend, unfinished
    return _picture_figure(*parts, extent=sequence.extent)


def _check_period(period_ns: Any, style: str, sequence: Transient) -> None:
    checks.require("period_ns", period_ns, style == "rainbow", f"None for style = {style!r}")
    period = checks.number("period_ns", period_ns, unit="nanoseconds", positive=True)
    shortest = opl_to_ns(2 * sequence.bin_width_opl)
    enough = period >= shortest * (1 - 1e-9)
    checks.require("period_ns", period_ns, enough, f"at least two bins, {shortest:.6g} ns")


def _sum_over_bins(sequence: Transient) -> np.ndarray:
    cube = sequence.values
    steady = np.zeros((*sequence.size, cube.shape[3]), np.result_type(cube.dtype, np.float32))
    for (rows, columns, *_), values in cube.pieces():
        steady[rows, columns] += values.sum(axis=2)
    return steady


def _mean_ns(sequence: Transient) -> np.ndarray:
    """Return the mean arrival time [ns] (height, width). Pixels without light are NaN."""
    energy, product = sequence.sums(opl_to_ns(sequence.opl))
    with np.errstate(invalid="ignore"):
        return product / energy


def _colors_of_times(time_ns: np.ndarray) -> tuple[np.ndarray, Any, str]:
    """Return colors (height, width, 3) from blue (early) to orange (late), and the color bar.

    The color bar is returned as its scale and its ends. The scale spans the 1st to the 99th
    percentile. The bar ends with an arrow if earlier or later times exist.
    """
    first, last, extend = percentile_range(time_ns)
    scale = _scale(first, last, time_map())
    known = np.isfinite(time_ns)[..., None]
    return np.where(known, scale.to_rgba(np.nan_to_num(time_ns))[..., :3], 1.0), scale, extend


def _rainbow(sequence: Transient, period_ns: float | None) -> tuple[np.ndarray, Any, str]:
    """Return colors (height, width, 3), and scale and label of the color bar."""
    # Sum the phasors of all bins
    period = _default_period_ns(sequence) if period_ns is None else float(period_ns)
    cycles = opl_to_ns(sequence.opl) / period
    energy, phasor = sequence.sums(np.exp(2j * math.pi * cycles).astype(np.complex64))
    coherence = np.divide(abs(phasor), energy, out=np.zeros_like(energy), where=energy > 0)

    # Hue by the argument, saturation by the magnitude
    hues = hue_map()(np.mod(np.angle(phasor) / (2 * math.pi), 1))[..., :3]
    saturation = np.sqrt(np.clip(coherence, 0, 1))[..., None]
    color = saturation * hues + (1 - saturation)
    label = f"arrival time, modulo {period:.4g} ns [ns]"
    return color, _scale(0, period, hue_map()), label


def _scale(low: float, high: float, colors: Any) -> Any:
    """Return the colors of numbers, for a color bar."""
    return ScalarMappable(Normalize(low, high, clip=True), colors)


def _default_period_ns(sequence: Transient) -> float:
    """Return an eighth of the range of mean arrival times, rounded to one or two digits."""
    mean_ns = _mean_ns(sequence)
    known = mean_ns[np.isfinite(mean_ns)]
    span = np.ptp(np.percentile(known, (2, 98))) / 8 if known.size else 0.0
    period = max(float(span), opl_to_ns(4 * sequence.bin_width_opl))
    digit = 10.0 ** math.floor(math.log10(period))
    return float(math.ceil(2 * period / digit) / 2 * digit)


@in_style()
def gate_figure(
    image: Any,
    opl: float,
    pulse_width_opl: float,
    *,
    exposure: float | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the picture of a Gaussian time gate, with its time, width and brightness.

    The color bar shows the radiance of white and grays, which is the radiance of each channel.

    Args:
        image: Result of `render_at_time`, radiance per meter [W m^-3 sr^-1]: (height, width) or
            (height, width, channels) with 1 or 3 channels.
        opl: Path length at the middle of the gate [m].
        pulse_width_opl: Standard deviation of the gate [m], above 0.
        exposure: Gain. The product 1 is white. By default the 99.5th percentile of the light is
            white.
        title: Title above the line with the time, or None.

    Raises:
        ValueError: Another shape, or a number out of range.

    Example:
        >>> figure = gate_figure(np.ones((4, 6, 3)), opl=5.9, pulse_width_opl=0.03)
        >>> figure.axes[0].get_title()
        't = 19.68 ± 0.10 ns, OPL = 5.900 ± 0.030 m'
    """
    # Check the arguments
    opl = checks.meters("opl", opl)
    width = checks.meters("pulse_width_opl", pulse_width_opl, positive=True)
    checks.text("title", title)
    image = checks.real_array("image", image)
    gain = auto_exposure(image) if exposure is None else exposure
    gain = checks.number("exposure", gain, positive=True)
    try:
        picture = tonemap(image, exposure=gain)
    except ValueError as error:
        raise ValueError(str(error).replace("values", "image", 1)) from None

    # Color bar, and the time and width of the gate
    grays = tonemap(np.linspace(0, 1, 256)[None], exposure=1)[0] / 255
    scale = _scale(0, 1 / gain, ListedColormap(grays.tolist()))
    label = "radiance per meter [W m⁻³ sr⁻¹]"
    extend = "max" if (image * gain > 1.0001).any() else "neither"
    time = _with_width(opl_to_ns(opl), opl_to_ns(width), "ns")
    when = f"t = {time}, OPL = {_with_width(opl, width, 'm')}"
    return _picture_figure(picture, when, scale, label, extend, np.isnan(image), above=title)


def _with_width(middle: float, width: float, unit: str) -> str:
    """Format middle and width of a gate, with digits for a tenth of the width."""
    digits = min(12, max(1, 1 - math.floor(math.log10(width))))
    return f"{middle:.{digits}f} ± {width:.{digits}f} {unit}"


def _picture_figure(
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
    """Return a figure of one RGB picture with a color bar. The options are for `imshow`."""
    wide = figure_width(4.6)
    high = wide * picture_aspect(picture.shape[0], picture.shape[1], 0.4, 2.0) + 1.0
    figure = new_figure(wide, high, "compressed")
    axes = figure.add_subplot()
    axes.imshow(picture, interpolation="nearest", **options)
    axes.set_title(title)
    pixel_axes(axes)
    color_bar(scale, axes, label, extend=extend)
    if above is not None:
        figure.suptitle(wrap_text(above, wide))
    explain_hatch(figure, unfinished, dark=True)
    fit_height(figure)
    return figure
