"""The Dataset's shape, and everything of it besides its numbers as one JSON object."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import checks

if TYPE_CHECKING:
    import xarray as xr

DIMS = {"transient": ("y", "x", "opl", "channel"), "steady": ("y", "x", "channel")}


def check_dataset(dataset: Any) -> None:
    """Refuse anything but a Dataset like the ones that `render` returns."""
    import xarray as xr

    if not isinstance(dataset, xr.Dataset):
        raise ValueError(f"dataset = {type(dataset).__name__}: must be an xarray.Dataset")
    found = {str(name): variable.dims for name, variable in dataset.data_vars.items()}
    if found != DIMS or any(v.dtype != np.float32 for v in dataset.data_vars.values()):
        raise ValueError(f"dataset with {found}: must hold the float32 variables {DIMS}, no other")
    if set(dataset.coords) != set(DIMS["transient"]) or not all(dataset.sizes.values()):
        raise ValueError(f"dataset with {dict(dataset.sizes)}: must have coordinates on all axes")
    for axis in ("y", "x"):
        values = dataset[axis].values
        if values.dtype.kind not in "iu" or (np.diff(values) != 1).any():
            raise ValueError(f"coordinate {axis}: must be consecutive pixel indices")
    checks.metres("start_opl", dataset.attrs.get("start_opl"))
    checks.metres("bin_width_opl", dataset.attrs.get("bin_width_opl"), positive=True)
    for name, value in plain(dataset.attrs).items():
        if not isinstance(value, str | int | float):
            raise ValueError(f"attribute {name} = {value!r}: must be text, an int or a float")


def describe(dataset: xr.Dataset) -> dict[str, Any]:
    """Sizes, channels, and the attributes of the Dataset, its variables and coordinates."""
    variables = {str(name): plain(variable.attrs) for name, variable in dataset.variables.items()}
    return {
        "sizes": {str(axis): size for axis, size in dataset.sizes.items()},
        "channel": dataset["channel"].values.tolist(),
        "attrs": plain(dataset.attrs),
        "variables": variables,
    }


def restore(about: dict[str, Any], arrays: dict[str, np.ndarray]) -> xr.Dataset:
    """The Dataset from its description and the arrays of its variables and coordinates."""
    import xarray as xr

    arrays = {**arrays, "channel": np.array(about["channel"])}
    dims = {axis: (axis,) for axis in DIMS["transient"]} | DIMS
    variables = {
        name: (dims[name], array, about["variables"][name]) for name, array in arrays.items()
    }
    return xr.Dataset(
        {name: variables[name] for name in DIMS},
        coords={name: variables[name] for name in DIMS["transient"]},
        attrs=about["attrs"],
    )


def plain(attributes: dict[Any, Any]) -> dict[str, Any]:
    """Attributes with NumPy scalars turned into Python's."""
    return {str(k): v.item() if isinstance(v, np.generic) else v for k, v in attributes.items()}
