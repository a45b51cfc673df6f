"""Datasets of renders that xarray has reduced: coarsened, cut in time, or summed over channels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .dataset import DIMS, QUANTITIES, components_of
from .labels import TIME

if TYPE_CHECKING:
    import xarray as xr


def relabelled(dataset: Any) -> Any:
    """A Dataset with the coordinates and attributes that `render` would give it.

    One channel is "L"; coarser pixels are numbered in a row; `start_opl` and `bin_width_opl` follow
    the coordinate `opl`. Anything else is returned as it is.

    Raises:
        ValueError: Bins that may be means instead of sums, or standard errors of coarser values.
    """
    if not set(DIMS) <= set(getattr(dataset, "data_vars", ())) or "opl" not in dataset.coords:
        return dataset
    before = dataset
    if "channel" not in dataset.dims:
        dataset = dataset.drop_vars(["channel", TIME], errors="ignore")
        dataset = dataset.expand_dims("channel", axis=-1)
    if "channel" not in dataset.coords and dataset.sizes["channel"] == 1:
        dataset = dataset.assign_coords(channel=np.array(["L"]))
    for axis, side in (("y", "height"), ("x", "width")):
        step = _step(dataset, axis)
        if step > 1 and dataset[axis].dtype.kind == "f":  # Integers are those of single pixels
            numbers = np.floor(dataset[axis].values / step).astype(int)
            dataset = dataset.assign_coords({axis: (axis, numbers, dataset[axis].attrs)})
            size = dataset.attrs.get(f"film_{side}", 0)
            dataset = dataset.assign_attrs({f"film_{side}": int(size // step)} if size else {})
    dataset = _in_time(dataset)
    wider = dataset.attrs.get("bin_width_opl") != before.attrs.get("bin_width_opl")
    wider |= not dataset.coords.equals(before.coords)
    if wider and len(dataset.data_vars) > len(DIMS):
        more = [name for name in dataset.data_vars if name not in DIMS]
        rule = f"must be left out, dataset.drop_vars({more}), as they do not add"
        raise ValueError(f"dataset with {', '.join(map(str, more))}, coarsened: {rule}")
    return dataset


def _step(dataset: xr.Dataset, axis: str) -> float:
    """Distance of the coordinates along an axis if it is the same everywhere, else 0."""
    values = np.asarray(dataset[axis].values, np.float64)
    steps = np.diff(values) if axis in dataset.coords else values[:0]
    return float(steps.mean()) if steps.size and np.allclose(steps, steps[0], rtol=1e-6) else 0.0


def _in_time(dataset: xr.Dataset) -> xr.Dataset:
    """A Dataset whose attributes of the time axis follow its coordinate `opl`."""
    attrs, step = dataset.attrs, _step(dataset, "opl")
    start, width = attrs.get("start_opl"), attrs.get("bin_width_opl")
    if not (isinstance(start, float | int) and isinstance(width, float | int) and width and step):
        return dataset
    first, count = float(dataset["opl"].values[0]) - step / 2, round(step / width)
    if count < 1 or abs(step / width - count) > 1e-3 * count:
        return dataset
    if count == 1 and abs(first - start) <= 1e-3 * width:
        return dataset
    intensity = components_of(dataset)[0]
    light, steady = (float(intensity[name].sum(dtype=np.float64)) for name in DIMS)
    if count > 1 and (attrs.get("quantity") == QUANTITIES[1] or light * count <= steady * 1.0001):
        rule = "must be sums of bins, as `tofrender.rebin` makes them"
        raise ValueError(f"transient: may hold means of {count} bins; {rule}")
    fresh = {"start_opl": first, "bin_width_opl": float(step if count > 1 else width)}
    if "energy_outside_window" in attrs and steady:
        fresh["energy_outside_window"] = min(max(1 - light / steady, 0.0), 1.0)
    return dataset.assign_attrs(fresh)
