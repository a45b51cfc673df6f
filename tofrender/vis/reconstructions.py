"""A reconstructed volume from three sides, and its depth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..nlos.reconstruction.depths import check_volume, depth_map
from ..runtime import checks
from ..runtime.canvas import new_figure
from .figures import map_axes

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

_LONGEST, _SHORTEST = 4.2, 1.6  # of a picture's sides [inches]


def reconstruction_figure(
    volume: xr.Dataset, *, threshold: float = 0.2, title: str | None = None
) -> Figure:
    """Draw the brightest voxels of a volume from the front, the side and above, and its depth.

    The front view is what the wall sees. Its rows run down as in a picture where they run down in
    the world, whose up is y; else up.

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
    sides = {axis: high - low for axis, (low, high) in edges.items()}
    inches = {a: max(_LONGEST * s / max(sides.values()), _SHORTEST) for a, s in sides.items()}
    widths = [inches["x"], max(inches["x"], inches["z"])]
    heights = [inches["y"], max(inches["y"], inches["z"])]
    figure = new_figure(sum(widths) + 3.6, sum(heights) + 1.8, "compressed")
    grid: Any = figure.subplots(
        2, 2, gridspec_kw={"width_ratios": widths, "height_ratios": heights}
    )
    views = (
        ("front", values.max(axis=0), "x", "y"),
        ("side", values.max(axis=2).T, "z", "y"),
        ("top", values.max(axis=1), "x", "z"),
        ("depth", depth, "x", "y"),
    )
    brightest = float(values.max()) or 1.0
    for axes, (name, picture, across, along) in zip(grid.flat, views, strict=True):
        shown = map_axes(
            axes,
            picture,
            extent=(*edges[across], *edges[along]),
            origin="lower",
            cmap="viridis" if name == "depth" else "magma",
            vmin=None if name == "depth" else 0,
            vmax=None if name == "depth" else brightest,
        )
        label = "z [m]" if name == "depth" else "intensity [arbitrary]"
        axes.set(title=name, xlabel=f"{across} [m]", ylabel=f"{along} [m]")
        axes.locator_params(integer=False)
        if along == "y" and _rows_run_down(volume):
            axes.invert_yaxis()
        axes.figure.colorbar(shown, ax=axes, label=label)
    named = ", ".join(filter(None, (volume.attrs.get("scene"), volume.attrs.get("method"))))
    figure.suptitle(named if title is None else title)
    return figure


def _edges(centres: np.ndarray) -> tuple[float, float]:
    """Outer edges of voxels [m]."""
    step = (centres[-1] - centres[0]) / (len(centres) - 1) if len(centres) > 1 else 1.0
    return float(centres[0] - step / 2), float(centres[-1] + step / 2)


def _rows_run_down(volume: xr.Dataset) -> bool:
    return "frame_axes" in volume and float(volume["frame_axes"].values[1, 1]) < 0
