"""Pictures of polarised light in false colours."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis.polarisation import (
    angle_of_linear_polarisation,
    degree_of_circular_polarisation,
    degree_of_linear_polarisation,
    degree_of_polarisation,
)
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style
from ..runtime.plots import COLUMN, PictureGrid
from .colours import hue_map, phase_map
from .figures import map_axes, picture_aspect
from .tone import auto_exposure, tonemap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST = 0.01
"""Degree of linear polarisation from which on light has an angle that is shown."""

SHOWN = ("intensity", "degree", "angle", "circular", "colours")
"""What a picture of polarised light may show."""


def polarisation_picture(
    stokes: Any, shown: str = "colours", *, exposure: float | None = None
) -> np.ndarray:
    """Draw one picture of polarised light, in false colours.

    Args:
        stokes: As for `polarisation_figure`.
        shown: "intensity", S0 as it looks; "degree" of polarisation, from dark to yellow; "angle"
            of linear polarisation, a cyclic colour; "circular", blue to the left and red to the
            right; "colours", the brightness of S0 in the colour of the angle, the paler the less
            of it is polarised. Where there is no light, or no angle, it is black.
        exposure: Gain of the brightness; `1` is shown as white after it. None takes
            `auto_exposure` of S0.

    Returns:
        uint8 (height, width, 3), sRGB.

    Raises:
        ValueError: Another shape, or an argument out of range; one line.

    Example:
        >>> light = np.ones((4, 6, 4, 1)) * np.array([1.0, 0.5, 0.0, 0.0])[:, None]
        >>> polarisation_picture(light, "degree").shape
        (4, 6, 3)
    """
    from matplotlib import colormaps

    values = _stokes(stokes)
    checks.one_of("shown", shown, SHOWN)
    if exposure is not None:
        exposure = checks.number("exposure", exposure, positive=True)
    light = values.mean(axis=3)
    gain = exposure or auto_exposure(light[:, :, 0])
    if shown == "intensity":
        colours = values[:, :, 0] if values.shape[3] == 3 else light[:, :, 0]
        return tonemap(colours, exposure=gain)
    linear = np.nan_to_num(degree_of_linear_polarisation(light, axis=2))
    angle = np.nan_to_num(angle_of_linear_polarisation(light, axis=2)) / np.pi
    if shown == "colours":
        pale = np.clip(linear, 0, 1)[..., None]
        hue = _linear(hue_map()(angle)[..., :3])
        return tonemap(light[:, :, :1] * (pale * hue + 1 - pale), exposure=gain)
    if shown == "degree":
        found, there = degree_of_polarisation(light, axis=2), light[:, :, 0] > 0
        picture = colormaps["viridis"](np.nan_to_num(found))
    elif shown == "angle":
        picture, there = phase_map()(angle), linear >= LEAST
    else:
        found, there = degree_of_circular_polarisation(light, axis=2), light[:, :, 0] > 0
        picture = colormaps["coolwarm"](np.nan_to_num(found) / 2 + 0.5)
    return np.rint(255 * picture[..., :3] * there[..., None]).astype(np.uint8)


def _linear(srgb: np.ndarray) -> np.ndarray:
    """Linear values of sRGB."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _stokes(stokes: Any) -> np.ndarray:
    """Stokes vectors as an array (height, width, 4, channels)."""
    import xarray as xr

    dims = stokes.dims if isinstance(stokes, xr.DataArray) else None
    values = checks.real_array("stokes", stokes, np.float64)
    named = dims in (None, ("y", "x", "stokes", "channel"))
    if not named or values.ndim != 4 or values.shape[2] != 4 or not values.size:
        found = f"dimensions {dims}" if dims else f"shape {values.shape}"
        raise ValueError(f"stokes with {found}: must be (y, x, stokes, channel), with 4 components")
    return values


@in_style
def polarisation_figure(
    stokes: Any, *, exposure: float | None = None, title: str | None = None
) -> Figure:
    """Draw how bright light is, how much of it is polarised, at which angle, and which way round.

    Colours are summed before. The angle has a cyclic colour, from the picture's right towards its
    top; it is hatched where less than 1 % is polarised linearly, as all is where there is no light.

    Args:
        stokes: Stokes vectors: a DataArray (y, x, stokes, channel), like `steady` of a polarised
            render or a bin of its `transient`, or an array (height, width, 4, channels).
        exposure: Gain of the brightness; `1` is shown as white after it. None shows the 99.5th
            percentile of the light as white.
        title: Above everything; None for nothing.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot.

    Raises:
        ValueError: Another shape, or a number out of range; one line.

    Example:
        >>> light = np.ones((4, 6, 4, 1)) * np.array([1.0, 0.5, 0.0, 0.0])[:, None]
        >>> [each.get_title() for each in polarisation_figure(light).axes[::2]]
        ['intensity', 'linear polarisation', 'angle', 'circular polarisation']
    """
    checks.text("title", title)
    values = _stokes(stokes)
    if exposure is not None:
        exposure = checks.number("exposure", exposure, positive=True)
    light = values.mean(axis=3)
    linear = degree_of_linear_polarisation(light, axis=2)
    angle = np.where(linear >= LEAST, angle_of_linear_polarisation(light, axis=2), np.nan)
    white = 1 / (exposure or auto_exposure(light[:, :, 0]))
    panels = (
        ("intensity", light[:, :, 0], "gray", 0, white, "radiance [W m⁻² sr⁻¹]"),
        ("linear polarisation", linear, "viridis", 0, 1, "degree"),
        ("angle", np.degrees(angle), phase_map(), 0, 180, "degrees from right to top"),
        (
            *("circular polarisation", degree_of_circular_polarisation(light, axis=2), "coolwarm"),
            *(-1, 1, "left to right, degree"),
        ),
    )
    width = figure_width(7.0)
    columns = 4 if width >= COLUMN else 2
    hatched = any(np.isnan(values).any() for _, values, *_ in panels)
    grid = PictureGrid(
        width,
        math.ceil(4 / columns),
        columns,
        picture_aspect(light.shape[0], light.shape[1], 0.4, 2.0),
        title=title or "",
        hatch="no light, or hardly polarised" if hatched else "",
    )
    for k, (name, picture, colours, low, high, label) in enumerate(panels):
        row, column = divmod(k, columns)
        axes = grid.axes(row, column, name)
        shown = map_axes(axes, picture, cmap=colours, vmin=low, vmax=high)
        grid.bar(shown, row, column, label)
        grid.trim(axes, row, column)
    return grid.figure
