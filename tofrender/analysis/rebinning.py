"""Other time bins and coarser pixels for what was rendered or captured."""

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
from ..rendering.labels import labelled
from ..runtime import checks
from ..runtime.progress import status

ROUNDING = 1e-6  # Parts of a bin by which an edge may miss that of another


@status("Rebinning")
def rebin(
    dataset: Annotated[xr.Dataset, FILM],
    bins: int | None = None,
    window: Sequence[float] | None = None,
    *,
    pixels: Sequence[int] | None = None,
) -> xr.Dataset:
    """Add up the bins of a Dataset to fewer ones, or to those of another; average its pixels.

    Light is spread evenly over each old bin that a new one cuts. Standard errors are left out, as
    those of neighbouring bins are not independent, and so is what only `denoise` needs.

    Args:
        dataset: Of `render` or `capture`, in memory or on disk.
        bins: Number of new bins, each at least as wide as the old ones; None for the old ones.
        window: Start and stop of the new bins [m], within those of the Dataset; by default these.
        pixels: Number of new pixels (columns, rows), of films only. They divide the pixels of the
            film, and each is the mean of the pixels that it covers. None for the old ones.

    Returns:
        The Dataset with its new bins and pixels, and with the energy outside of them as an
        attribute.

    Raises:
        ValueError: Another Dataset, narrower bins, a window that reaches beyond them, or pixels
            that do not divide the film.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=8, height=6, temporal_bins=60, bin_width_opl=0.2)
        >>> dataset = tofrender.render(scene, spp=4)
        >>> coarse = rebin(dataset, 15, pixels=(4, 2))
        >>> coarse["transient"].shape, round(coarse.attrs["bin_width_opl"], 9)
        ((2, 4, 15, 3), 0.8)
    """
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
    checks.require("bins", bins, bins is not None or pixels is not None, "given, or pixels")
    if bins is None:
        checks.require("window", window, window is None, "None without bins")
    if pixels is not None:
        dataset = with_pixels(dataset, pixels, "pixels")
    if bins is not None:
        dataset = _with_bins(dataset, bins, window)
    return dataset


def with_pixels(film: xr.Dataset, pixels: Sequence[int], parameter: str) -> xr.Dataset:
    """Return a film with fewer pixels (columns, rows), each the mean of those that it covers.

    The film is in the order of `read`. Messages name the parameter.
    """
    require_consecutive(film, "dataset")
    sides = checks.items(parameter, pixels, 2, "[width, height]")
    columns, rows = (checks.integer(parameter, side, 1, checks.MAX_SIZE) for side in sides)
    width, height = film.sizes["x"], film.sizes["y"]
    steps = {"x": width // columns, "y": height // rows}
    whole = width == steps["x"] * columns and height == steps["y"] * rows
    allowed = f"numbers that divide the film of {width} x {height} pixels"
    checks.require(parameter, pixels, whole, allowed)
    begun = [int(film[axis][0]) % step for axis, step in steps.items()]
    allowed = "left out: the crop window starts within one of these pixels"
    checks.require(parameter, pixels, begun == [0, 0], allowed)

    light: Any = film.coarsen(steps, coord_func="min")  # type: ignore[arg-type]
    found = light.mean(keep_attrs=True)
    for axis, step in steps.items():
        numbers = found[axis].values // step
        found = found.assign_coords({axis: (axis, numbers, film[axis].attrs)})
    for name, axis in (("film_width", "x"), ("film_height", "y")):
        if name in film.attrs:
            size = film.attrs[name] / steps[axis]  # The film may end within a pixel
            found.attrs[name] = int(size) if size == int(size) else size
    return found


def _with_bins(dataset: xr.Dataset, bins: int, window: Sequence[float] | None) -> xr.Dataset:
    """Add up the bins of a film or a capture."""
    bins = checks.integer("bins", bins, 1, checks.MAX_BINS)
    old = bins_of(dataset, "dataset")
    start, width, end = old.start_opl, old.bin_width_opl, old.stop_opl
    first, last = (start, end) if window is None else checks.interval("window", window)
    slack = ROUNDING * width
    inside = start - slack <= first and last <= end + slack
    checks.require("window", window, inside, f"within the bins, from {start:g} to {end:g} m")
    wide, most = (last - first) / bins, int((last - first) / width + ROUNDING)
    allowed = f"at most {most} in this window, whose bins are {width:g} m wide"
    checks.require("bins", bins, bins <= most, allowed)

    edges = np.clip((first - start + wide * np.arange(bins + 1)) / width, 0, dataset.sizes["opl"])
    whole = np.round(edges)
    edges = np.where(np.abs(edges - whole) < ROUNDING, whole, edges)
    light = dataset["transient"]
    per_metre = dataset.attrs.get("quantity") == QUANTITIES[1]
    scale = width / wide if per_metre else 1.0
    values = _summed(light.data, light.dims.index("opl"), edges, scale)

    kept: dict[Any, Any] = {name: dataset.variables[name] for name in dataset.data_vars}
    kept["transient"] = light.dims, values, light.attrs
    coordinates = {k: dataset.variables[k] for k in dataset.coords if k not in ("opl", "time")}
    opl = ("opl", first + (np.arange(bins) + 0.5) * wide, dataset["opl"].attrs)
    attrs = dataset.attrs | {"start_opl": float(first), "bin_width_opl": wide}
    made = labelled(xr.Dataset(kept, coordinates | {"opl": opl}, attrs))
    outside = energy_outside_window(dataset, "dataset")
    if outside is not None:
        films = (intensity(each["transient"], "dataset") for each in (made, dataset))
        after, before = (float(each.sum(dtype=np.float64)) for each in films)
        outside = 1 - (1 - outside) * after / scale / (before or 1.0)
        made.attrs["energy_outside_window"] = min(max(outside, 0.0), 1.0)
    return made


def _summed(light: Any, axis: int, edges: np.ndarray, scale: float) -> Any:
    """Sums of the bins between edges along an axis, row by row, or lazily."""

    def of_block(values: np.ndarray) -> np.ndarray:
        found = sums_between(np.moveaxis(values, axis, -1), edges) * scale
        return np.moveaxis(found, -1, axis).astype(np.float32)

    shape = (*light.shape[:axis], len(edges) - 1, *light.shape[axis + 1 :])
    if hasattr(light, "dask"):
        whole = light.rechunk({axis: -1})
        sizes = [shape[k : k + 1] if k == axis else each for k, each in enumerate(whole.chunks)]
        return whole.map_blocks(of_block, dtype=np.float32, chunks=sizes)
    made = np.empty(shape, np.float32)
    for row in range(len(light)):
        made[row : row + 1] = of_block(light[row : row + 1])
    return made


def sums_between(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Sums of (..., bin) between edges in bins, each bin being spread evenly over its width.

    Example:
        >>> values = np.array([1.0, 2.0, 4.0])
        >>> [sums_between(values, np.array(e)).tolist() for e in ([0.5, 2, 3], [1.0, 2, 3])]
        [[2.5, 4.0], [2.0, 4.0]]
    """
    low = np.floor(edges).astype(int)
    if np.array_equal(edges, low):  # Sums of whole bins, without cancellation
        return np.add.reduceat(values[..., : low[-1]], low[:-1], axis=-1, dtype=np.float64)
    sums = np.zeros((*values.shape[:-1], values.shape[-1] + 1))
    np.cumsum(values, axis=-1, out=sums[..., 1:])
    high = np.minimum(low + 1, values.shape[-1])
    return np.diff(sums[..., low] + (edges - low) * (sums[..., high] - sums[..., low]), axis=-1)
