"""Other time bins for what was rendered or captured."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..nlos.captures import check_capture
from ..rendering.dataset import DIMS, QUANTITIES, check_dataset, components_of
from ..rendering.labels import labelled
from ..runtime import checks
from ..runtime.progress import status

if TYPE_CHECKING:
    import xarray as xr

ROUNDING = 1e-6  # Parts of a bin by which an edge may miss that of another


@status("Rebinning")
def rebin(dataset: "xr.Dataset", bins: int, window: Sequence[float] | None = None) -> "xr.Dataset":
    """Add up the bins of a Dataset to fewer ones, or to those of another Dataset.

    Light is spread evenly over each old bin that a new one cuts. Standard errors are left out, as
    those of neighbouring bins are not independent, and so is what only `denoise` needs.

    Args:
        dataset: Of `render` or `capture`, in memory or on disk.
        bins: Number of new bins, each at least as wide as the old ones.
        window: Start and stop of the new bins [m], within those of the Dataset; by default these.

    Returns:
        The Dataset with its new bins, and with the energy outside of them as an attribute.

    Raises:
        ValueError: Another Dataset, narrower bins, or a window that reaches beyond them.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=60, bin_width_opl=0.2)
        >>> dataset = tofrender.render(scene, spp=4)
        >>> coarse = rebin(dataset, 15)
        >>> coarse.sizes["opl"], round(coarse.attrs["bin_width_opl"], 9)
        (15, 0.8)
    """
    is_capture = "mode" in getattr(dataset, "attrs", ())
    if is_capture:
        check_capture(dataset)
    else:
        check_dataset(components_of(dataset)[0])
    bins = checks.integer("bins", bins, 1, checks.MAX_BINS)
    start, width = (float(dataset.attrs[name]) for name in ("start_opl", "bin_width_opl"))
    end = start + dataset.sizes["opl"] * width
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

    kept: dict[Any, Any] = {
        name: dataset.variables[name] for name in dataset.data_vars if is_capture or name in DIMS
    }
    kept["transient"] = light.dims, values, light.attrs
    coordinates = {k: dataset.variables[k] for k in dataset.coords if k not in ("opl", "time")}
    opl = ("opl", first + (np.arange(bins) + 0.5) * wide, dataset["opl"].attrs)
    attrs = dataset.attrs | {"start_opl": float(first), "bin_width_opl": wide}
    made = labelled(type(dataset)(kept, coordinates | {"opl": opl}, attrs))
    if "energy_outside_window" in attrs:
        films = (components_of(each)[0]["transient"] for each in (made, dataset))
        after, before = (float(each.sum(dtype=np.float64)) for each in films)
        outside = 1 - (1 - attrs["energy_outside_window"]) * after / scale / (before or 1.0)
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
