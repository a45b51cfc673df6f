"""Figures of a correlation camera: I, Q, amplitude, phase and depth, a row for each frequency."""

import math
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..analysis.unwrapping import unambiguous_range, unwrap
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style
from ..runtime.plots import COLUMN, NO_VALUE, PictureGrid, percentile_range
from ..signals.units import SPEED_OF_LIGHT, check_frequencies
from .color_maps import phase_map
from .transient_figures import map_axes, picture_aspect

MAX_WRAPS = 128  # Largest unambiguous range that is unwrapped, in wraps of the highest frequency

_RADIANCE = "[W m⁻² sr⁻¹]"
_PREFIXES = ((1e9, "GHz"), (1e6, "MHz"), (1e3, "kHz"), (1.0, "Hz"))


@in_style()
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

    Color channels are added as phasors, since phases must not be averaged. Amplitude, phase and
    depth with channels are therefore computed again from the sums: with P = I + iQ, amplitude = abs
    P, phase = arg P in (-π, π], depth = c (phase mod 2π) / (4π f) in [0, c/2f). Without
    channels, amplitude, phase and depth are drawn unchanged, for example an unwrapped depth.

    The last column is half the path length. It is a depth only if light and camera are at the same
    point. For two or more frequencies with a short common period, the last row shows the depth
    unwrapped by `analysis.unwrap` and its residual. A large residual means that a single depth does
    not explain the phases. Pixels without light and unfinished pixels (NaN) are hatched. The
    strongest two percent of I, Q and amplitude are clipped.

    Args:
        frequencies_hz: One modulation frequency [Hz] or several, finite and above 0.
        I: In-phase images, sum of L cos(2π f opl / c) [W m^-2 sr^-1]: (height, width, channels)
            for one frequency, or (frequencies, height, width, channels); 1 or 3 channels.
        Q: Quadrature images, sum of L sin(2π f opl / c), of the same shape.
        amplitude: Amplitude [W m^-2 sr^-1], in the shape of I with or without the channels.
        phase: Phase [rad], in the shape of I with or without the channels.
        depth: Depth [m], in the shape of I with or without the channels.
        title: Title of the figure, or None.

    Raises:
        ValueError: A frequency is not finite or not above 0, or the shapes do not fit.

    Example:
        >>> phasor = np.full((4, 6, 3), 2 + 1j)
        >>> parts = phasor.real, phasor.imag, abs(phasor), np.angle(phasor), abs(phasor)
        >>> [axes.get_title() for axes in phasor_panel(50e6, *parts).axes[:5]]
        ['I', 'Q', 'amplitude', 'phase', 'depth']
    """
    # Add the channels, and unwrap the depth
    frequencies, _ = check_frequencies(frequencies_hz, "frequencies_hz")
    checks.text("title", title)
    parts = {"I": I, "Q": Q, "amplitude": amplitude, "phase": phase, "depth": depth}
    arrays = {name: checks.real_array(name, values) for name, values in parts.items()}
    images = _without_channels(len(frequencies), arrays)
    phasors = images["I"] + 1j * images["Q"]
    lit = np.isfinite(phasors) & (phasors != 0)
    unwrapped = _unwrapped(frequencies, phasors, lit)

    # Lay out the maps
    wide = figure_width(7.0)
    columns = 5 if wide >= COLUMN else 3
    rows = -(-5 // columns)  # Rows of one frequency
    last = len(frequencies) * rows - 1
    grid = PictureGrid(
        wide,
        last + 1 + bool(unwrapped),
        columns,
        picture_aspect(lit.shape[1], lit.shape[2], 0.4, 2.0),
        title=title or "",
        bar_lines=2,
        left=0.66,
        with_x={last, last + 1},
        hatch="" if lit.all() else NO_VALUE,
    )

    # Draw the maps of each frequency, and the unwrapped depth
    blocks = [
        (rows * k, _in_hertz(frequency), _maps(frequency, {n: v[k] for n, v in images.items()}))
        for k, frequency in enumerate(frequencies)
    ]
    first = _draw(grid, blocks)
    if unwrapped:
        _draw(grid, [(last + 1, "all", unwrapped)], first)
    return grid.figure


def _without_channels(count: int, parts: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return images (frequencies, height, width).

    Images with channels are omitted, except for I and Q, since they follow from the sums of I and
    Q.
    """
    # Check the shape of I
    shape = parts["I"].shape
    valid = len(shape) in (3, 4) and shape[-1] in (1, 3) and 0 not in shape
    one = "(height, width, channels)"
    allowed = f"{one} or (frequencies, {one[1:]} with 1 or 3 channels last"
    checks.shape("I", parts["I"], valid, allowed)
    allowed = f"({count}, {one[1:]} for {count} frequencies"
    checks.shape("I", parts["I"], count == (shape[0] if len(shape) == 4 else 1), allowed)

    # Check the other shapes, and add the channels of I and Q
    images: dict[str, np.ndarray] = {}
    for name, values in parts.items():
        shapes = [shape] if name in "IQ" else [shape, shape[:-1]]
        allowed = f"{' or '.join(map(str, shapes))}, as I has {shape}"
        checks.shape(name, values, values.shape in shapes, allowed)
        if name in "IQ":
            values = values.sum(axis=-1, dtype=np.float64)
        if values.ndim < len(shape):
            images[name] = values.reshape(count, *shape[-3:-1])
    return images


class _Map(NamedTuple):
    """Name, values and colors of a map in a figure, and the label of its color bar."""

    name: str
    values: np.ndarray
    label: str
    colors: dict[str, Any]
    extend: str = "neither"


def _draw(
    grid: PictureGrid, blocks: list[tuple[int, str, list[_Map]]], first: Axes | None = None
) -> Axes | None:
    """Draw blocks of maps into a grid, and add the color bars.

    Args:
        grid: The grid.
        blocks: Top row, label at the left, and maps of each block.
        first: Axes whose limits all maps share; None to use those of the first map.

    Returns:
        The axes with the shared limits, None without maps.
    """
    drawn = []
    for top, label, maps in blocks:
        for k, each in enumerate(maps):
            row = top + k // grid.columns
            column = k % grid.columns
            axes = grid.axes(row, column, each.name, sharex=first, sharey=first)
            image = map_axes(axes, each.values, **each.colors)
            grid.trim(axes, row, column)

            # Label the block
            if k == 0:
                options: dict[str, Any] = {"xycoords": "axes fraction", "ha": "center"}
                options |= {"textcoords": "offset points", "va": "center", "rotation": "vertical"}
                axes.annotate(label, (0, 0.5), xytext=(-39, 0), fontsize="large", **options)
            drawn.append((each, image, row, column))
            first = first or axes

    # Add the color bars
    for each, image, row, column in drawn:
        bar = grid.bar(image, row, column, each.label, extend=each.extend)
        if each.name == "phase":
            bar.set_ticks([-math.pi, 0, math.pi], labels=["−π", "0", "π"])
    return first


def _unwrapped(frequencies: list[float], phasors: np.ndarray, lit: np.ndarray) -> list[_Map]:
    """Return the maps of depth and residual from phase unwrapping with all frequencies.

    The list is empty if frequencies are equal, or if there are too many wraps to search.
    """
    # Is the common period short enough?
    if len(set(frequencies)) < max(2, len(frequencies)):
        return []
    longest = unambiguous_range(frequencies)
    if longest > MAX_WRAPS * SPEED_OF_LIGHT / (2 * max(frequencies)):
        return []

    # Unwrap the depth
    phasors = np.where(lit, phasors, np.nan)
    phases = np.angle(phasors)
    amplitudes = np.nan_to_num(abs(phasors))
    depth, residual = unwrap(phases, frequencies, amplitudes=amplitudes)
    near, far, extend = percentile_range(depth)
    depths = {"cmap": "viridis", "vmin": near, "vmax": far}
    residuals = {"cmap": "cividis", "vmin": 0, "vmax": percentile_range(residual)[1]}
    label = f"half the path length\n[m], of {longest:.4g} m"
    return [
        _Map("unwrapped", depth, label, depths, extend),
        _Map("residual", residual, "disagreement\n[m]", residuals, "max"),
    ]


def _maps(frequency: float, images: dict[str, np.ndarray]) -> list[_Map]:
    """Return the five maps of one frequency."""
    # Compute images that were not given
    phasor = images["I"] + 1j * images["Q"]
    lit = np.isfinite(phasor) & (phasor != 0)
    unambiguous = SPEED_OF_LIGHT / (2 * frequency)
    amplitude = images.get("amplitude", abs(phasor))
    phase = np.where(lit, images.get("phase", np.angle(phasor)), np.nan)
    wrapped = np.mod(np.angle(phasor), 2 * math.pi) / (2 * math.pi) * unambiguous
    depth = np.where(lit, images.get("depth", wrapped), np.nan)
    furthest = np.max(depth, where=np.isfinite(depth), initial=unambiguous)

    # Choose the scales
    strongest = _white(np.stack([phasor.real, phasor.imag]))
    signed = {"cmap": "RdBu_r", "vmin": -strongest, "vmax": strongest}
    sizes = {"cmap": "magma", "vmin": 0, "vmax": _white(amplitude)}
    angles = {"cmap": phase_map(), "vmin": -math.pi, "vmax": math.pi}
    depths = {"cmap": "viridis", "vmin": 0, "vmax": furthest}
    path = f"half the path length\n[m], c/2f = {unambiguous:.4g} m"
    return [
        _Map("I", phasor.real, _RADIANCE, signed, "both"),
        _Map("Q", phasor.imag, _RADIANCE, signed, "both"),
        _Map("amplitude", amplitude, _RADIANCE, sizes, "max"),
        _Map("phase", phase, "[rad]", angles),
        _Map("depth", depth, path, depths),
    ]


def _white(values: np.ndarray) -> float:
    """Return the 98th percentile of magnitudes, or 1 without light."""
    size = abs(values[np.isfinite(values) & (values != 0)])
    return float(np.percentile(size, 98)) if size.size else 1.0


def _in_hertz(frequency: float) -> str:
    scale, unit = next((p for p in _PREFIXES if frequency >= p[0]), _PREFIXES[-1])
    return f"{frequency / scale:.6g} {unit}"
