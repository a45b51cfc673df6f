"""Change of time bins and pixels of renders and captures."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import (
    FILM,
    bins_of,
    energy_outside_window,
    intensity,
    read,
    require_consecutive,
)
from ..nlos.captures import read_capture
from ..rendering.dataset import DIMS, QUANTITIES
from ..rendering.labels import labeled
from ..runtime import checks
from ..runtime.progress import status

# Largest distance of an edge from an old edge that counts as equal, in bins
ROUNDING = 1e-6


@status("Rebinning")
def rebin(
    dataset: Annotated[xr.Dataset, FILM],
    bins: int | None = None,
    window: Sequence[float] | None = None,
    *,
    pixels: Sequence[int] | None = None,
) -> xr.Dataset:
    """Sum the bins of a Dataset to fewer bins or to another window, and average its pixels.

    If an edge of a new bin cuts an old bin, the light of the old bin is divided in proportion to
    the lengths of the pieces. Standard errors are removed, because the
    errors of neighboring bins are not independent. Variables that only `denoise` needs are removed
    as well.

    Args:
        dataset: A result of `render` or `capture`, in memory or on disk.
        bins: Number of new bins. Each must be at least as wide as an old bin. None keeps the bins.
        window: Start and stop of the new bins [m], within the window of the Dataset; by default the
            whole window.
        pixels: Number of new pixels (columns, rows) of a film. They must divide the pixels of the
            film. Each is the mean of the pixels that it covers. None keeps the pixels.

    Returns:
        The Dataset with its new bins and pixels. An attribute contains the energy outside the bins.

    Raises:
        ValueError: The Dataset is not supported, new bins are narrower than old bins or outside the
            window, or new pixels do not divide the film.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=8, height=6, temporal_bins=60, bin_width_opl=0.2)
        >>> dataset = tofrender.render(scene, spp=4)
        >>> coarse = rebin(dataset, 15, pixels=(4, 2))
        >>> coarse["transient"].shape, round(coarse.attrs["bin_width_opl"], 9)
        ((2, 4, 15, 3), 0.8)
    """
    # Read a film or a capture
    is_capture = "capture_mode" in getattr(dataset, "attrs", ())
    if is_capture:
        dataset = read_capture(dataset, "dataset")
        if pixels is not None:
            raise ValueError(
                "pixels: each pixel of a capture is a point of the wall. Choose points by isel, or "
                "capture with a smaller grid"
            )
    else:
        dataset = read(dataset, FILM, "dataset")[list(DIMS)]

    # Change pixels and bins
    checks.require("bins", bins, bins is not None or pixels is not None, "given, or pixels")
    if bins is None:
        checks.require("window", window, window is None, "None without bins")
    if pixels is not None:
        dataset = with_pixels(dataset, pixels, "pixels")
    if bins is not None:
        dataset = _with_bins(dataset, bins, window)
    return dataset


def with_pixels(film: xr.Dataset, pixels: Sequence[int], parameter: str) -> xr.Dataset:
    """Return a film with fewer pixels, each the mean of the pixels that it covers.

    Args:
        film: The film, in the order of `read`.
        pixels: Numbers of columns and rows.
        parameter: Name of the parameter, for messages.
    """
    # Check the numbers
    require_consecutive(film, "dataset")
    sides = checks.items(parameter, pixels, 2, "[width, height]")
    columns, rows = (checks.integer(parameter, side, 1, checks.MAX_SIZE) for side in sides)
    width = film.sizes["x"]
    height = film.sizes["y"]
    steps = {"x": width // columns, "y": height // rows}
    whole = width == steps["x"] * columns and height == steps["y"] * rows
    allowed = f"numbers that divide the film of {width} x {height} pixels"
    checks.require(parameter, pixels, whole, allowed)
    begun = [int(film[axis][0]) % step for axis, step in steps.items()]
    allowed = "left out: the crop window starts within one of these pixels"
    checks.require(parameter, pixels, begun == [0, 0], allowed)

    # Average pixels, and number them
    light: Any = film.coarsen(steps, coord_func="min")  # type: ignore[arg-type]
    found = light.mean(keep_attrs=True)
    for axis, step in steps.items():
        numbers = found[axis].values // step
        found = found.assign_coords({axis: (axis, numbers, film[axis].attrs)})

    # Update the size of the film, which may end within a pixel
    for name, axis in (("film_width", "x"), ("film_height", "y")):
        if name in film.attrs:
            size = film.attrs[name] / steps[axis]
            found.attrs[name] = int(size) if size == int(size) else size
    return found


def _with_bins(dataset: xr.Dataset, bins: int, window: Sequence[float] | None) -> xr.Dataset:
    """Sum the bins of a film or a capture to new bins."""
    # Check the new bins
    bins = checks.integer("bins", bins, 1, checks.MAX_BINS)
    old = bins_of(dataset, "dataset")
    start = old.start_opl
    width = old.bin_width_opl
    end = old.stop_opl
    first, last = (start, end) if window is None else checks.interval("window", window)
    slack = ROUNDING * width
    inside = start - slack <= first and last <= end + slack
    checks.require("window", window, inside, f"within the bins, from {start:g} to {end:g} m")
    wide = (last - first) / bins
    most = int((last - first) / width + ROUNDING)
    allowed = f"at most {most} in this window, whose bins are {width:g} m wide"
    checks.require("bins", bins, bins <= most, allowed)

    # Edges of the new bins, in old bins
    edges = np.clip((first - start + wide * np.arange(bins + 1)) / width, 0, dataset.sizes["opl"])
    whole = np.round(edges)
    edges = np.where(np.abs(edges - whole) < ROUNDING, whole, edges)

    # Sum the light
    light = dataset["transient"]
    per_meter = dataset.attrs.get("quantity") == QUANTITIES[1]
    scale = width / wide if per_meter else 1.0
    values = _summed(light.data, light.dims.index("opl"), edges, scale)

    # Label the result
    kept: dict[Any, Any] = {name: dataset.variables[name] for name in dataset.data_vars}
    kept["transient"] = light.dims, values, light.attrs
    coordinates = {k: dataset.variables[k] for k in dataset.coords if k not in ("opl", "time")}
    opl = ("opl", first + (np.arange(bins) + 0.5) * wide, dataset["opl"].attrs)
    attrs = dataset.attrs | {"start_opl": float(first), "bin_width_opl": wide}
    made = labeled(xr.Dataset(kept, coordinates | {"opl": opl}, attrs))

    # Update the energy outside the bins
    outside = energy_outside_window(dataset, "dataset")
    if outside is not None:
        films = (intensity(each["transient"], "dataset") for each in (made, dataset))
        after, before = (float(each.sum(dtype=np.float64)) for each in films)
        outside = 1 - (1 - outside) * after / scale / (before or 1.0)
        made.attrs["energy_outside_window"] = min(max(outside, 0.0), 1.0)
    return made


def _summed(light: Any, axis: int, edges: np.ndarray, scale: float) -> Any:
    """Sum the bins between edges along an axis, row by row, or lazily.

    Args:
        light: The light, an array of NumPy or Dask.
        axis: Axis of the bins.
        edges: Edges of the new bins, in old bins.
        scale: Factor of the sums.
    """

    def of_block(values: np.ndarray) -> np.ndarray:
        found = sums_between(np.moveaxis(values, axis, -1), edges) * scale
        return np.moveaxis(found, -1, axis).astype(np.float32)

    # Lazy arrays
    shape = (*light.shape[:axis], len(edges) - 1, *light.shape[axis + 1 :])
    if hasattr(light, "dask"):
        whole = light.rechunk({axis: -1})
        sizes = [shape[k : k + 1] if k == axis else each for k, each in enumerate(whole.chunks)]
        return whole.map_blocks(of_block, dtype=np.float32, chunks=sizes)

    # Arrays in memory
    made = np.empty(shape, np.float32)
    for row in range(len(light)):
        made[row : row + 1] = of_block(light[row : row + 1])
    return made


def sums_between(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sum values (..., bin) between edges [bins]. Values are spread evenly over their bins.

    Example:
        >>> values = np.array([1.0, 2.0, 4.0])
        >>> [sums_between(values, np.array(e)).tolist() for e in ([0.5, 2, 3], [1.0, 2, 3])]
        [[2.5, 4.0], [2.0, 4.0]]
    """
    # Whole bins are summed without cancellation
    low = np.floor(edges).astype(int)
    if np.array_equal(edges, low):
        return np.add.reduceat(values[..., : low[-1]], low[:-1], axis=-1, dtype=np.float64)

    # Otherwise, interpolate the cumulative sum
    sums = np.zeros((*values.shape[:-1], values.shape[-1] + 1))
    np.cumsum(values, axis=-1, out=sums[..., 1:])
    high = np.minimum(low + 1, values.shape[-1])
    return np.diff(sums[..., low] + (edges - low) * (sums[..., high] - sums[..., low]), axis=-1)
