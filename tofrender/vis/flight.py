"""Light in flight in one picture: the steady image, coloured by when its light arrives."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure
from ..runtime.plots import colour_bar, fit_height, percentile_range
from ..signals.colour import luminance
from ..signals.units import opl_to_ns
from .colours import hue_map, time_map
from .figures import explain_hatch, picture_aspect, pixel_axes
from .tone import tonemap
from .transient import Transient

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLES = ("arrival", "peak", "rainbow")


@in_style
def light_in_flight(
    data: Any,
    start_opl: float | None = None,
    bin_width_opl: float | None = None,
    *,
    style: str = "arrival",
    period_ns: float | None = None,
    exposure: float | None = None,
) -> Figure:
    """Show when light arrives and how much of it in one picture.

    The brightness of a pixel is that of the steady image, its colour tells the time:

    - `"arrival"`: the mean arrival time, weighted by luminance;
    - `"peak"`: the centre of the brightest bin;
    - `"rainbow"`: bands of equal arrival time. The colours go around once in `period_ns`: they
      tell the argument of the phasor P = sum over bins of L exp(2πi t / period_ns). They fade by
      sqrt(abs P / sum of L), so that light spread over more than a period turns grey instead of
      taking a colour that means nothing.

    Pixels whose light all arrives outside the window are grey; unfinished ones (NaN) are hatched.

    Args:
        data: A Dataset, or an array (height, width, bins) or (height, width, bins, channels),
            whose sum over bins takes the place of the steady image.
        start_opl: Where the first bin starts [m]; a Dataset knows it.
        bin_width_opl: Width of a bin [m], above 0; a Dataset knows it.
        style: "arrival", "peak" or "rainbow".
        period_ns: Only for "rainbow": time from a hue to the same hue [ns], at least two bins.
            None takes about an eighth of the time in which the picture's pixels have their mean
            arrivals.
        exposure: Gain of the steady image; None shows its 98th percentile as white.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot.

    Raises:
        ValueError: Another shape, an unknown style, a period without "rainbow" or below two bins,
            a bad exposure, or a time axis that is missing or not positive.

    Example:
        >>> figure = light_in_flight(np.ones((4, 6, 10)), 3.5, 0.02, style="rainbow", period_ns=0.2)
        >>> figure.axes[0].get_title()
        'isochrones'
    """
    checks.one_of("style", style, STYLES)
    sequence = Transient.of(data, start_opl, bin_width_opl)
    if period_ns is not None:
        _check_period(period_ns, style, sequence)
    if exposure is not None:
        checks.number("exposure", exposure, positive=True)
    steady = _steady(data, sequence)
    unfinished = np.asarray(np.isnan(steady).any(axis=2))
    for (rows, columns, *_), values in sequence.values.pieces():
        unfinished[rows, columns] |= np.isnan(values).any(axis=(2, 3))
    if style == "rainbow":
        colour, scale, label = _rainbow(sequence, period_ns)
        beyond = "neither"
    else:
        time_ns = sequence.brightest()[1] if style == "peak" else _mean_ns(sequence)
        colour, scale, beyond = _by_time(time_ns)
        label = "time of the brightest bin [ns]" if style == "peak" else "mean arrival time [ns]"

    grey = tonemap(luminance(steady), exposure=exposure, percentile=98)
    picture = np.where(unfinished[..., None], tonemap(np.full(grey.shape, np.nan)), colour * grey)
    height, width = unfinished.shape
    wide = figure_width(4.6)
    figure = new_figure(wide, wide * picture_aspect(height, width, 0.4, 2.0) + 1.0, "compressed")
    axes = figure.add_subplot()
    axes.imshow(picture.astype(np.uint8), extent=sequence.extent, interpolation="nearest")
    axes.set_title({"arrival": "arrival time", "peak": "peak time"}.get(style, "isochrones"))
    pixel_axes(axes)
    colour_bar(scale, axes, label, extend=beyond)
    explain_hatch(figure, unfinished, dark=True)
    fit_height(figure)
    return figure


def _check_period(period_ns: Any, style: str, sequence: Transient) -> None:
    if style != "rainbow":
        raise ValueError(
            f"period_ns = {checks.quote(period_ns)}: must be None for style = {style!r}"
        )
    period = checks.number("period_ns", period_ns, unit="nanoseconds", positive=True)
    shortest = opl_to_ns(2 * sequence.bin_width_opl)
    if period < shortest * (1 - 1e-9):
        raise ValueError(
            f"period_ns = {checks.quote(period_ns)}: must be at least two bins, {shortest:.6g} ns"
        )


def _steady(data: Any, sequence: Transient) -> np.ndarray:
    """The steady image, (height, width, channels): a Dataset's, or the sum over bins."""
    if hasattr(data, "data_vars"):
        return data["steady"].values
    cube = sequence.values
    steady = np.zeros((*sequence.size, cube.shape[3]), np.result_type(cube.dtype, np.float32))
    for (rows, columns, *_), values in cube.pieces():
        steady[rows, columns] += values.sum(axis=2)
    return steady


def _mean_ns(sequence: Transient) -> np.ndarray:
    """Mean arrival time [ns], (height, width); NaN where there is no light."""
    energy, product = sequence.sums(opl_to_ns(sequence.opl))
    with np.errstate(invalid="ignore"):
        return product / energy


def _by_time(time_ns: np.ndarray) -> tuple[np.ndarray, Any, str]:
    """Colours (height, width, 3) from blue (early) to orange (late), and what a colour bar needs.

    All colours are full ones, so that darkness means little light and nothing else. They tell
    times apart that lie between the first and the last hundredth of all pixels; the bar has an
    arrow where there are times beyond.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    first, last, beyond = percentile_range(time_ns)
    scale = ScalarMappable(Normalize(first, last, clip=True), time_map())
    shown = np.isfinite(time_ns)[..., None]
    colour = np.where(shown, scale.to_rgba(np.nan_to_num(time_ns))[..., :3], 1.0)
    return colour, scale, beyond


def _rainbow(sequence: Transient, period_ns: float | None) -> tuple[np.ndarray, Any, str]:
    """Colours (height, width, 3), and what the colour bar and its label need."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    period = _period_ns(sequence) if period_ns is None else float(period_ns)
    turns = opl_to_ns(sequence.opl) / period
    energy, phasor = sequence.sums(np.exp(2j * math.pi * turns).astype(np.complex64))
    saturation = np.divide(abs(phasor), energy, out=np.zeros_like(energy), where=energy > 0)
    scale = ScalarMappable(Normalize(0, period), hue_map())
    hues = hue_map()(np.mod(np.angle(phasor) / (2 * math.pi), 1))[..., :3]
    share = np.sqrt(np.clip(saturation, 0, 1))[..., None]
    colour = share * hues + (1 - share)
    return colour, scale, f"arrival time, modulo {period:.4g} ns [ns]"


def _period_ns(sequence: Transient) -> float:
    """An eighth of the time in which pixels have their mean arrivals, to one or two digits."""
    mean_ns = _mean_ns(sequence)
    known = mean_ns[np.isfinite(mean_ns)]
    span = np.ptp(np.percentile(known, (2, 98))) / 8 if known.size else 0.0
    period = max(float(span), opl_to_ns(4 * sequence.bin_width_opl))
    digit = 10.0 ** math.floor(math.log10(period))
    return float(math.ceil(2 * period / digit) / 2 * digit)
