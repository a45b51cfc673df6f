"""What a correlation camera measures: I, Q, amplitude, phase and depth, a row per frequency."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis.unwrapping import unambiguous_range, unwrap
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style
from ..runtime.plots import COLUMN, NO_VALUE, PictureGrid, percentile_range
from ..signals.units import SPEED_OF_LIGHT, check_frequencies
from .colours import phase_map
from .figures import map_axes, picture_aspect

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_WRAPS = 128
"""A depth is unwrapped if that takes no more wraps of the highest frequency than so many."""

_RADIANCE = "[W m⁻² sr⁻¹]"
_PREFIXES = ((1e9, "GHz"), (1e6, "MHz"), (1e3, "kHz"), (1.0, "Hz"))


@in_style
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
    Of two or more frequencies whose phases repeat soon enough together, a row below has the depth
    unwrapped by `analysis.unwrap` and its residual, which is large where no depth fits.

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
        unfinished (NaN). The strongest two percent of I, Q and amplitude are clipped.

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


@dataclass
class _Map:
    """A picture of numbers, and what its colour bar says."""

    name: str
    values: np.ndarray
    label: str
    colours: dict[str, Any]
    extend: str = "neither"


def _panel(
    frequencies: list[float], images: dict[str, np.ndarray | None], title: str | None
) -> Figure:
    phasors = np.asarray(images["I"]) + 1j * np.asarray(images["Q"])
    count, height, width = phasors.shape
    lit = np.isfinite(phasors) & (phasors != 0)
    unwrapped = _unwrapped(frequencies, phasors, lit)
    wide = figure_width(7.0)
    columns = 5 if wide >= COLUMN else 3
    rows = -(-5 // columns)
    last = count * rows - 1
    grid = PictureGrid(
        wide,
        last + 1 + bool(unwrapped),
        columns,
        picture_aspect(height, width, 0.4, 2.0),
        title=title or "",
        bar_lines=2,
        left=0.66,
        with_x={last, last + 1},
        hatch="" if lit.all() else NO_VALUE,
    )
    blocks = [
        (
            _in_hertz(frequency),
            _maps(frequency, {n: v if v is None else v[k] for n, v in images.items()}),
        )
        for k, frequency in enumerate(frequencies)
    ]
    first = _draw(grid, 0, blocks)
    if unwrapped:
        _draw(grid, last + 1, [("all", unwrapped)], first)
    return grid.figure


def _draw(
    grid: PictureGrid, row: int, blocks: list[tuple[str, list[_Map]]], first: Axes | None = None
) -> Axes | None:
    """Draw blocks of maps from a row on, a word to the left of each; returns the first axes."""
    placed = []
    for beside, maps in blocks:
        for k, each in enumerate(maps):
            here, column = row + k // grid.columns, k % grid.columns
            axes = grid.axes(here, column, each.name, sharex=first, sharey=first)
            shown = map_axes(axes, each.values, **each.colours)
            grid.trim(axes, here, column)
            if k == 0:
                _beside(axes, beside)
            placed.append((each, shown, here, column))
            first = first or axes
        row += -(-len(maps) // grid.columns)
    for each, shown, here, column in placed:
        bar = grid.bar(shown, here, column, each.label, extend=each.extend)
        if each.name == "phase":
            bar.set_ticks([-math.pi, 0, math.pi], labels=["−π", "0", "π"])
    return first


def _beside(axes: Axes, text: str) -> None:
    """What a row shows, to the left of its first panel."""
    axes.annotate(
        text,
        (0, 0.5),
        xytext=(-39, 0),
        xycoords="axes fraction",
        textcoords="offset points",
        ha="center",
        va="center",
        rotation="vertical",
        fontsize="large",
    )


def _unwrapped(frequencies: list[float], phasors: np.ndarray, lit: np.ndarray) -> list[_Map]:
    """Depth and residual by the phases at all frequencies; none where there are too many wraps."""
    if len(set(frequencies)) < max(2, len(frequencies)):
        return []
    longest = unambiguous_range(frequencies)
    if longest > MOST_WRAPS * SPEED_OF_LIGHT / (2 * max(frequencies)):
        return []
    phasors = np.where(lit, phasors, np.nan)
    phases, amplitudes = np.angle(phasors), np.nan_to_num(abs(phasors))
    depth, residual = unwrap(phases, frequencies, amplitudes=amplitudes)
    near, far, beyond = percentile_range(depth)
    worst = percentile_range(residual)[1]
    return [
        _Map(
            "unwrapped",
            depth,
            f"half the path length\n[m], of {longest:.4g} m",
            {"cmap": "viridis", "vmin": near, "vmax": far},
            beyond,
        ),
        _Map(
            "residual",
            residual,
            "disagreement\n[m]",
            {"cmap": "cividis", "vmin": 0, "vmax": worst},
            "max",
        ),
    ]


def _maps(frequency: float, given: dict[str, np.ndarray | None]) -> list[_Map]:
    """The five maps of one frequency."""
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
    signed = {"cmap": "RdBu_r", "vmin": -strongest, "vmax": strongest}
    sizes = {"cmap": "magma", "vmin": 0, "vmax": _white(amplitude)}
    angles = {"cmap": phase_map(), "vmin": -math.pi, "vmax": math.pi}
    depths = {"cmap": "viridis", "vmin": 0, "vmax": furthest}
    path = f"half the path length\n[m], c/2f = {unambiguous:.4g} m"
    return [
        _Map("I", phasor.real, f"I\n{_RADIANCE}", signed, "both"),
        _Map("Q", phasor.imag, f"Q\n{_RADIANCE}", signed, "both"),
        _Map("amplitude", amplitude, f"amplitude\n{_RADIANCE}", sizes, "max"),
        _Map("phase", phase, "phase\n[rad]", angles),
        _Map("depth", depth, path, depths),
    ]


def _white(values: np.ndarray) -> float:
    """A scale that two percent of the values exceed; 1 where there is no light."""
    size = abs(values[np.isfinite(values) & (values != 0)])
    return float(np.percentile(size, 98)) if size.size else 1.0


def _in_hertz(frequency: float) -> str:
    scale, unit = next((p for p in _PREFIXES if frequency >= p[0]), _PREFIXES[-1])
    return f"{frequency / scale:.6g} {unit}"
