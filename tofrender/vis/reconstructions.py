"""Figures of a reconstructed volume, and of the errors of reconstructions."""

from typing import Annotated, Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..labels import DEPTH_ERRORS, VOLUME, read
from ..nlos.reconstruction.depths import check_volume, depth_map
from ..nlos.reconstruction.methods import METHODS
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure
from ..runtime.plots import COLUMN, HATCH, PictureGrid, few_ticks, wrap_text

_MEASURES = {"error": "median depth error [m]", "found": "fraction of depths found"}
_MARKERS = "osD^v"


@in_style()
def reconstruction_figure(
    volume: Annotated[xr.Dataset, VOLUME], *, threshold: float = 0.2, title: str | None = None
) -> Figure:
    """Draw maximum projections of a volume from the front, the side and above, and its depth.

    The front view shows the volume as seen at the wall. Rows run downwards if they run down along
    the world's axis y, otherwise upwards. All panels have the same scale in meters, and all
    projections have the same scale of intensities. The axes belong to the frame of the wall.

    Args:
        volume: A result of `reconstruct`.
        threshold: As in `depth_map`. Pixels without a depth are hatched.
        title: Title of the figure. By default the scene and the method.

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
    # Check the arguments, and compute the depth
    checks.text("title", title)
    volume = read(volume, VOLUME, "volume")
    values = check_volume(volume)
    depth = depth_map(volume, threshold).values
    edges = {axis: _edges(volume[axis].values) for axis in "xyz"}

    # Lay out the panels
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

    # Choose scales and limits
    brightest = float(values.max()) or 1.0
    known = depth[np.isfinite(depth)]
    near, far = (known.min(), known.max()) if known.size else (0, 1)
    near, far = (near, far) if far > near else (near - 0.5, near + 0.5)
    rows_run_down = "frame_axes" in volume and float(volume["frame_axes"].values[1, 1]) < 0
    half = max(high - low for low, high in edges.values()) / 2
    limits = {axis: (sum(each) / 2 - half, sum(each) / 2 + half) for axis, each in edges.items()}

    # Draw the panels
    images = []
    for k, (name, picture, across, along) in enumerate(views):
        axes = grid.axes(k // columns, k % columns, name)
        extent = (*edges[across], *edges[along])
        options: Any = {"cmap": "inferno", "vmin": 0, "vmax": brightest}
        if name == "depth":
            options = {"cmap": "viridis", "vmin": near, "vmax": far}
            left, right = edges[across]
            low, high = edges[along]
            area = Rectangle((left, low), right - left, high - low, **HATCH, linewidth=0, zorder=-1)
            axes.add_patch(area)
        image = axes.imshow(
            picture, extent=extent, origin="lower", interpolation="nearest", **options
        )
        if name != "depth":
            axes.set_facecolor(image.cmap(0.0))
        axes.set(xlabel=f"{across} [m]", ylabel=f"{along} [m]")
        axes.set(xlim=limits[across], ylim=limits[along])
        if along == "y" and rows_run_down:
            axes.invert_yaxis()
        few_ticks(axes)
        images.append(image)

    # Add color bars below
    row = 4 // columns - 1
    grid.bar(images[0], row, 0, "intensity [arbitrary]", span=columns - 1)
    grid.bar(images[3], row, columns - 1, "depth z [m]")
    return grid.figure


def _edges(centers: np.ndarray) -> tuple[float, float]:
    """Return the outer edges of voxels [m]."""
    step = (centers[-1] - centers[0]) / (len(centers) - 1) if len(centers) > 1 else 1.0
    return float(centers[0] - step / 2), float(centers[-1] + step / 2)


@in_style()
def reconstruction_errors_figure(
    errors: Annotated[xr.Dataset, DEPTH_ERRORS], *, title: str | None = None
) -> Figure:
    """Draw the depth error of each reconstruction method over the signal level.

    The left panel shows the median of the depth error over the seeds, with a band from the smallest
    to the largest error. The right panel shows the fraction of depths that were found.

    Args:
        errors: Result of `reconstruction_errors`.
        title: Title of the figure, or None.

    Raises:
        ValueError: `errors` is not a result of `reconstruction_errors`.

    Example:
        >>> axes = ("reconstruction", "photons_per_cycle", "seed")
        >>> values = {"error": (axes, np.ones((1, 2, 1))), "found": (axes, np.ones((1, 2, 1)))}
        >>> levels = {"reconstruction": ["lct"], "photons_per_cycle": [0.1, 1.0], "seed": [0]}
        >>> reconstruction_errors_figure(xr.Dataset(values, levels)).axes[0].get_xscale()
        'log'
    """
    # Check the arguments
    checks.text("title", title)
    errors = read(errors, DEPTH_ERRORS, "errors")
    levels = errors["photons_per_cycle"].values
    methods = [name for name in METHODS if name in errors["reconstruction"].values]

    # Draw both panels
    width = figure_width(7.0)
    figure = new_figure(width, 3.0, "compressed")
    for axes, (name, label) in zip(figure.subplots(1, 2), _MEASURES.items(), strict=True):
        for k, method in enumerate(methods):
            values = errors[name].sel(reconstruction=method)
            middle, low, high = (
                getattr(values, of)("seed").values for of in ("median", "min", "max")
            )
            marker = _MARKERS[k % len(_MARKERS)]
            (drawn,) = axes.plot(levels, middle, marker=marker, label=str(method))
            axes.fill_between(levels, low, high, color=drawn.get_color(), alpha=0.2)
        axes.set_xscale("log")
        axes.set_xlabel("photons per cycle and pixel")
        axes.set_ylabel(label)
    errors_panel, found_panel = figure.axes
    if np.nanmax(errors["error"].values, initial=0) > 0:
        errors_panel.set_yscale("log")
    found_panel.set_ylim(-0.02, 1.02)
    errors_panel.legend()
    if title is not None:
        figure.suptitle(wrap_text(title, width))
    return figure
