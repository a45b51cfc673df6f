"""What a correlation camera measures: I, Q, amplitude, phase and depth, a row per frequency."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from ..runtime.canvas import new_figure
from ..signals.frequencies import check_frequencies
from ..signals.units import SPEED_OF_LIGHT
from .figures import map_axes, picture_aspect

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_RADIANCE = "[W m$^{-2}$ sr$^{-1}$]"
_PREFIXES = ((1e9, "GHz"), (1e6, "MHz"), (1e3, "kHz"), (1.0, "Hz"))


def phasor_panel(
    frequencies_hz: Any,
    I: Any,  # noqa: E741 (the field's letter)
    Q: Any,
    amplitude: Any,
    phase: Any,
    depth: Any,
    *,
    title: str | None = None,
) -> Figure:
    """Draw phasor images: a row for each frequency, columns I, Q, amplitude, phase and depth.

    Colour channels are added as phasors, I and Q each; phases are never averaged. Amplitude, phase
    and depth that come per channel are therefore worked out again from the sums: with P = I + iQ,
    amplitude = abs P, phase = arg P in (-π, π], depth = c (phase mod 2π) / (4π f) in [0, c/2f).
    Those that come without channels are drawn as they are, so that an unwrapped depth can be shown.

    The last column is half the path length. It is the depth only where light and camera coincide.

    Args:
        frequencies_hz: One modulation frequency [Hz] or several, finite and above 0.
        I: In-phase images, sum of L cos(2π f opl / c) [W m^-2 sr^-1]: (height, width, channels)
            for one frequency, or (frequencies, height, width, channels); 1 or 3 channels.
        Q: Quadrature images, sum of L sin(2π f opl / c), of the same shape.
        amplitude: [W m^-2 sr^-1], of the shape of I with or without the channels.
        phase: [rad], likewise.
        depth: [m], likewise.
        title: Above everything; None for no title.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot. Hatched pixels have no light or are
        unfinished (NaN). The strongest half percent of I, Q and amplitude is clipped.

    Raises:
        ValueError: A frequency that is no finite number above 0, or shapes that do not fit.

    Example:
        >>> phasor = np.full((4, 6, 3), 2 + 1j)
        >>> parts = phasor.real, phasor.imag, abs(phasor), np.angle(phasor), abs(phasor)
        >>> [axes.get_title() for axes in phasor_panel(50e6, *parts).axes[:5]]
        ['I', 'Q', 'amplitude', 'phase', 'depth']
    """
    frequencies, _ = check_frequencies(frequencies_hz, "frequencies_hz")
    checks.text("title", title)
    parts = {"I": I, "Q": Q, "amplitude": amplitude, "phase": phase, "depth": depth}
    images = _summed(len(frequencies), {n: checks.real_array(n, v) for n, v in parts.items()})
    return _panel(frequencies, images, title)


def _summed(count: int, parts: dict[str, np.ndarray]) -> dict[str, np.ndarray | None]:
    """Images (frequencies, height, width), None where they follow from I and Q."""
    shape = parts["I"].shape
    if len(shape) not in (3, 4) or shape[-1] not in (1, 3) or 0 in shape:
        raise ValueError(
            f"I with shape {shape}: must be (height, width, channels) or (frequencies, height, "
            "width, channels) with 1 or 3 channels last"
        )
    if count != (shape[0] if len(shape) == 4 else 1):
        wanted = f"({count}, height, width, channels)"
        raise ValueError(f"I with shape {shape}: must be {wanted} for {count} frequencies")
    for name, values in parts.items():
        allowed = [shape] if name in "IQ" else [shape, shape[:-1]]
        if values.shape not in allowed:
            raise ValueError(
                f"{name} with shape {values.shape}: must be {' or '.join(map(str, allowed))}, "
                f"as I has {shape}"
            )
    plane = (count, *shape[-3:-1])
    return {
        name: values.sum(axis=-1, dtype=np.float64).reshape(plane)
        if name in "IQ"
        else (values.reshape(plane) if values.ndim < len(shape) else None)
        for name, values in parts.items()
    }


def _panel(
    frequencies: list[float], images: dict[str, np.ndarray | None], title: str | None
) -> Figure:
    count, height, width = images["I"].shape  # pyright: ignore[reportOptionalMemberAccess]
    aspect = picture_aspect(height, width, 0.4, 2.0)
    figure = new_figure(17.5, count * (2.35 * aspect + 0.3) + (1.0 if title else 0.6), "compressed")
    grid: Any = figure.subplots(count, 5, sharex=True, sharey=True, squeeze=False)
    for row, (frequency, all_axes) in enumerate(zip(frequencies, grid, strict=True)):
        given = {name: None if v is None else v[row] for name, v in images.items()}
        _row(all_axes, frequency, given)
        for axes in all_axes:
            axes.label_outer()
        all_axes[0].annotate(
            _in_hertz(frequency),
            (0, 0.5),
            xytext=(-52, 0),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="center",
            va="center",
            rotation="vertical",
            fontsize="large",
        )
    for axes, name in zip(grid[0], ("I", "Q", "amplitude", "phase", "depth"), strict=True):
        axes.set_title(name)
    if title is not None:
        figure.suptitle(title)
    return figure


def _row(all_axes: Any, frequency: float, given: dict[str, np.ndarray | None]) -> None:
    """Draw the five maps of one frequency."""
    phasor = np.asarray(given["I"]) + 1j * np.asarray(given["Q"])
    lit = np.isfinite(phasor) & (phasor != 0)
    unambiguous = SPEED_OF_LIGHT / (2 * frequency)
    amplitude, phase, depth = given["amplitude"], given["phase"], given["depth"]
    if amplitude is None:
        amplitude = abs(phasor)
    if phase is None:
        phase = np.angle(phasor)
    if depth is None:
        depth = np.mod(np.angle(phasor), 2 * math.pi) / (2 * math.pi) * unambiguous
    phase, depth = np.where(lit, phase, np.nan), np.where(lit, depth, np.nan)
    furthest = np.max(depth, where=np.isfinite(depth), initial=unambiguous)
    strongest = _white(np.stack([phasor.real, phasor.imag]))

    for axes, values, name in zip(all_axes, (phasor.real, phasor.imag), "IQ", strict=False):
        shown = map_axes(axes, values, cmap="RdBu_r", vmin=-strongest, vmax=strongest)
        _bar(shown, axes, f"{name} {_RADIANCE}", extend="both")
    shown = map_axes(all_axes[2], amplitude, cmap="magma", vmin=0, vmax=_white(amplitude))
    _bar(shown, all_axes[2], f"amplitude {_RADIANCE}", extend="max")
    shown = map_axes(all_axes[3], phase, cmap="twilight", vmin=-math.pi, vmax=math.pi)
    bar = _bar(shown, all_axes[3], "phase [rad]")
    bar.set_ticks(np.arange(-2, 3) * (math.pi / 2), labels=["-π", "-π/2", "0", "π/2", "π"])
    shown = map_axes(all_axes[4], depth, cmap="viridis", vmin=0, vmax=furthest)
    _bar(shown, all_axes[4], f"half the path length [m]\n(c/2f = {unambiguous:.4g} m)")


def _bar(shown: Any, axes: Axes, label: str, **options: Any) -> Any:
    return shown.figure.colorbar(shown, ax=axes, label=label, **options)


def _white(values: np.ndarray) -> float:
    """A scale that half a percent of the values exceed; 1 where there is no light."""
    size = abs(values[np.isfinite(values) & (values != 0)])
    return float(np.percentile(size, 99.5)) if size.size else 1.0


def _in_hertz(frequency: float) -> str:
    scale, unit = next((p for p in _PREFIXES if frequency >= p[0]), _PREFIXES[-1])
    return f"{frequency / scale:.6g} {unit}"
