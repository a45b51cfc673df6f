"""What files hold of a Dataset: all but its numbers as one JSON object, and finite numbers."""

from __future__ import annotations

import os
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from ..rendering.dataset import DIMS, plain_attributes, require_finite

if TYPE_CHECKING:
    import xarray as xr


def describe(dataset: xr.Dataset) -> dict[str, Any]:
    """Sizes, channels, and the attributes of the Dataset, its variables and coordinates."""
    variables = {
        str(name): plain_attributes(variable) for name, variable in dataset.variables.items()
    }
    return {
        "sizes": {str(axis): size for axis, size in dataset.sizes.items()},
        "channel": dataset["channel"].values.tolist(),
        "attrs": plain_attributes(dataset),
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


def refuse_not_finite(path: str | os.PathLike, dataset: xr.Dataset) -> None:
    """Refuse a file whose light is not finite in all bins and pixels.

    Raises:
        ValueError: One line that says how many values are not, and where the first is.
    """
    try:
        require_finite(dataset)
    except ValueError as error:
        raise ValueError(f"path = {path}: {error}") from None


def warn_of_not_finite(dataset: xr.Dataset) -> None:
    """Say that a file will not be readable, rather than lose what it took hours to render."""
    try:
        require_finite(dataset)
    except ValueError as error:
        warnings.warn(f"{error}; what is written now cannot be read again", stacklevel=3)
