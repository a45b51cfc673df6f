"""Pictures of polarized light in false colors."""

import math
from typing import Annotated, Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.figure import Figure

from ..analysis.degrees_of_polarization import (
    angle_of_linear_polarization,
    degree_of_circular_polarization,
    degree_of_linear_polarization,
    degree_of_polarization,
)
from ..labels import IMAGE, read_array, require_whole_stokes
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style
from ..runtime.plots import COLUMN, PictureGrid
from .color_maps import from_srgb, hue_map, phase_map
from .tone import auto_exposure, tonemap
from .transient_figures import map_axes, picture_aspect

MIN_DEGREE = 0.01  # Least degree of linear polarization of pixels with an angle

ANGLE = "angle [°] from right to top"
"""Label of the color bar of the angle."""

SHOWN = ("intensity", "degree", "angle", "circular", "colors")


def polarization_picture(
    stokes: Annotated[Any, IMAGE], shown: str = "colors", *, exposure: float | None = None
) -> np.ndarray:
    """Draw polarized light in false colors.

    Args:
        stokes: As for `polarization_figure`.
        shown: "intensity" shows S0. "degree" shows the degree of polarization, from dark to yellow.
            "angle" shows the angle of linear polarization as a cyclic color. "circular" shows
            left-handed light in blue and right-handed light in red. "colors" shows S0 with the hue
            of the angle, saturated by the degree of linear polarization. Pixels without light, or
            without an angle, are black.
        exposure: Gain of the brightness. The product 1 is white. By default `auto_exposure` of S0
            without its brightest 2 %, since a lamp can be visible.

    Returns:
        uint8 (height, width, 3), sRGB.

    Raises:
        ValueError: Another shape, or an argument out of range.

    Example:
        >>> light = np.ones((4, 6, 4, 1)) * np.array([1.0, 0.5, 0.0, 0.0])[:, None]
        >>> polarization_picture(light, "degree").shape
        (4, 6, 3)
    """
    values, light, gain = _checked(stokes, exposure)
    checks.one_of("shown", shown, SHOWN)
    if shown == "intensity":
        colors = values[:, :, 0] if values.shape[3] == 3 else light[:, :, 0]
        return tonemap(colors, exposure=gain)

    # Linear polarization as hue and saturation
    linear = np.nan_to_num(degree_of_linear_polarization(light, axis=2))
    angle = np.nan_to_num(angle_of_linear_polarization(light, axis=2)) / np.pi
    if shown == "colors":
        saturation = np.clip(linear, 0, 1)[..., None]
        hue = from_srgb(hue_map()(angle)[..., :3])
        return tonemap(light[:, :, :1] * (saturation * hue + 1 - saturation), exposure=gain)

    # Numbers in the colors of a map
    lit = light[:, :, 0] > 0
    if shown == "degree":
        degree = np.nan_to_num(degree_of_polarization(light, axis=2))
        picture = colormaps["viridis"](degree)
    elif shown == "angle":
        picture = phase_map()(angle)
        lit = linear >= MIN_DEGREE
    else:
        degree = np.nan_to_num(degree_of_circular_polarization(light, axis=2))
        picture = colormaps["coolwarm"](degree / 2 + 0.5)
    return np.rint(255 * picture[..., :3] * lit[..., None]).astype(np.uint8)


def _checked(stokes: Any, exposure: float | None) -> tuple[np.ndarray, np.ndarray, float]:
    """Return Stokes vectors (height, width, 4, channels), their mean over channels and the gain."""
    if isinstance(stokes, xr.DataArray):
        stokes = read_array(stokes, IMAGE, "stokes")
        require_whole_stokes(stokes, "stokes")
    values = checks.real_array("stokes", stokes, np.float64)
    valid = values.ndim == 4 and values.shape[2] == 4 and values.size > 0
    checks.shape("stokes", values, valid, "(y, x, stokes, channel), with 4 components")
    light = values.mean(axis=3)
    gain = auto_exposure(light[:, :, 0], percentile=98) if exposure is None else exposure
    return values, light, checks.number("exposure", gain, positive=True)


@in_style()
def polarization_figure(
    stokes: Annotated[Any, IMAGE], *, exposure: float | None = None, title: str | None = None
) -> Figure:
    """Draw intensity, degree and angle of linear polarization, and circular polarization.

    Channels are averaged first. The angle has a cyclic color, from the right of the picture to the
    top. It is hatched if less than 1 % of the light is linearly polarized. Pixels without light are
    hatched in all pictures.

    Args:
        stokes: Stokes vectors: a DataArray (y, x, stokes, channel), like `steady` of a polarized
            render or a bin of its `transient`, or an array (height, width, 4, channels).
        exposure: Gain of the brightness. The product 1 is white. By default the 98th percentile of
            the light is white, so that the surroundings of a lamp are not black.
        title: Title of the figure, or None.

    Raises:
        ValueError: Another shape, or a number out of range.

    Example:
        >>> light = np.ones((4, 6, 4, 1)) * np.array([1.0, 0.5, 0.0, 0.0])[:, None]
        >>> [each.get_title().split()[0] for each in polarization_figure(light).axes[::2]]
        ['intensity', 'linear', 'linear', 'circular']
    """
    # Compute the pictures
    checks.text("title", title)
    _, light, gain = _checked(stokes, exposure)
    linear = degree_of_linear_polarization(light, axis=2)
    angle = np.where(linear >= MIN_DEGREE, angle_of_linear_polarization(light, axis=2), np.nan)
    circular = degree_of_circular_polarization(light, axis=2)
    panels = (
        ("intensity S0", light[:, :, 0], "gray", 0, 1 / gain, "radiance [W m⁻² sr⁻¹]"),
        ("linear degree", linear, "viridis", 0, 1, "degree of linear polarization"),
        ("linear angle", np.degrees(angle), phase_map(), 0, 180, ANGLE),
        (
            "circular degree",
            circular,
            "coolwarm",
            -1,
            1,
            "degree, from left to right",
        ),
    )

    # Lay them out
    width = figure_width(7.0)
    columns = 4 if width >= COLUMN else 2
    hatched = any(np.isnan(values).any() for _, values, *_ in panels)
    grid = PictureGrid(
        width,
        math.ceil(4 / columns),
        columns,
        picture_aspect(light.shape[0], light.shape[1], 0.4, 2.0),
        title=title or "",
        hatch="no light, or hardly polarized" if hatched else "",
    )

    # Draw each with its color bar
    for k, (name, picture, colors, low, high, label) in enumerate(panels):
        row, column = divmod(k, columns)
        axes = grid.axes(row, column, name)
        shown = map_axes(axes, picture, cmap=colors, vmin=low, vmax=high)
        bar = grid.bar(shown, row, column, label, extend="neither" if k else "max")
        if label == ANGLE:
            bar.set_ticks([0, 90, 180])
        grid.trim(axes, row, column)
    return grid.figure
