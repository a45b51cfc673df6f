"""A reconstructed volume from three sides, and its depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..nlos.reconstruction.depths import check_volume, depth_map
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style
from ..runtime.plots import COLUMN, PictureGrid, few_ticks
from .figures import hatch_area

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@in_style
def reconstruction_figure(
    volume: xr.Dataset, *, threshold: float = 0.2, title: str | None = None
) -> Figure:
    """Draw the brightest voxels of a volume from the front, the side and above, and its depth.

    The front view is what the wall sees. Its rows run down as in a picture where they run down in
    the world, whose up is y; else up. All panels have one scale in metres, and three of
    them one of intensities.

    Args:
        volume: A result of `reconstruct`.
        threshold: As in `depth_map`; where there is nothing, the depth is hatched.
        title: Above everything; by default the scene and the method.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot; all axes in metres, in the wall's
        frame.

    Raises:
        ValueError: Not a result of `reconstruct`, or a threshold out of range.

    Example:
        >>> import xarray as xr
        >>> axes = {"z": [0.9, 1.0, 1.1], "y": [-0.5, 0.5], "x": [-0.5, 0.5]}
        >>> values = np.ones((3, 2, 2), np.float32)
        >>> volume = xr.Dataset({"intensity": (("z", "y", "x"), values)}, axes)
        >>> [each.get_title() for each in reconstruction_figure(volume).axes[:4]]
        ['front', 'side', 'top', 'depth']
    """
    checks.text("title", title)
    values = check_volume(volume)
    depth = depth_map(volume, threshold).values
    edges = {axis: _edges(volume[axis].values) for axis in "xyz"}
    width = figure_width(7.0)
    columns = 4 if width >= COLUMN else 2
    named = ", ".join(filter(None, (volume.attrs.get("scene"), volume.attrs.get("method"))))
    grid = PictureGrid(
        width,
        4 // columns,
        columns,
        1.0,
        title=named if title is None else title,
        own_y=True,
        with_bars={4 // columns - 1},
        hatch="nothing found" if np.isnan(depth).any() else "",
    )
    views = (
        ("front", values.max(axis=0), "x", "y"),
        ("side", values.max(axis=2).T, "z", "y"),
        ("top", values.max(axis=1), "x", "z"),
        ("depth", depth, "x", "y"),
    )
    brightest = float(values.max()) or 1.0
    drawn = []
    for k, (name, picture, across, along) in enumerate(views):
        axes = grid.axes(k // columns, k % columns, name)
        extent = (*edges[across], *edges[along])
        options: Any = {"cmap": "inferno", "vmin": 0, "vmax": brightest}
        if name == "depth":
            options = {"cmap": "viridis"}
            hatch_area(axes, extent)
        shown = axes.imshow(
            picture, extent=extent, origin="lower", interpolation="nearest", **options
        )
        if name != "depth":
            axes.set_facecolor(shown.cmap(0.0))
        axes.set(xlabel=f"{across} [m]", ylabel=f"{along} [m]")
        _square(axes, edges, across, along)
        if along == "y" and _rows_run_down(volume):
            axes.invert_yaxis()
        few_ticks(axes)
        drawn.append(shown)
    depths = drawn[3].get_array().compressed()
    drawn[3].set_clim(*(_apart(depths.min(), depths.max()) if depths.size else (0, 1)))
    if columns == 4:
        grid.bar(drawn[0], 0, 0, "intensity [arbitrary]", span=3)
        grid.bar(drawn[3], 0, 3, "depth z [m]")
    else:
        grid.bar(drawn[0], 1, 0, "intensity [arbitrary]")
        grid.bar(drawn[3], 1, 1, "depth z [m]")
    return grid.figure


def _apart(low: float, high: float) -> tuple[float, float]:
    """Ends of a scale, apart also where there is a single value."""
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _square(axes: Axes, edges: dict[str, tuple[float, float]], across: str, along: str) -> None:
    """Limits as long on both axes as the longest side of the volume: all panels to one scale."""
    half = max(high - low for low, high in edges.values()) / 2
    for axis, limit in ((across, axes.set_xlim), (along, axes.set_ylim)):
        middle = sum(edges[axis]) / 2
        limit(middle - half, middle + half)


def _edges(centres: np.ndarray) -> tuple[float, float]:
    """Outer edges of voxels [m]."""
    step = (centres[-1] - centres[0]) / (len(centres) - 1) if len(centres) > 1 else 1.0
    return float(centres[0] - step / 2), float(centres[-1] + step / 2)


def _rows_run_down(volume: xr.Dataset) -> bool:
    return "frame_axes" in volume and float(volume["frame_axes"].values[1, 1]) < 0
