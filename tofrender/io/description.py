"""What files hold of a Dataset: all but its numbers as one JSON object, and finite numbers."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..rendering.dataset import (
    DIMS,
    ERRORS,
    check_dataset,
    in_components,
    plain_attributes,
    require_finite,
)
from ..rendering.labels import labelled
from ..runtime import checks

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


def parse(text: Any) -> dict[str, Any]:
    """The description that a file holds as JSON.

    Raises:
        ValueError: It is of another form; one line.
    """
    try:
        about = json.loads(str(text))
    except (ValueError, RecursionError):
        raise ValueError("its description is no JSON; must be as it was saved") from None
    _require("its description", about, ("sizes", "channel", "attrs", "variables"))
    axes = DIMS["transient"]
    sizes = _require("sizes", about["sizes"], axes)
    for axis in axes:
        checks.integer(f"sizes: {axis}", sizes[axis], 1, 1 << 40)
    names = about["channel"]
    if names not in (["L"], ["R", "G", "B"]) and not _are_texts(names, sizes["channel"]):
        raise ValueError(f"channel = {checks.shown(names)}: must be {sizes['channel']} names")
    variables = _require("variables", about["variables"], (*DIMS, *axes))
    for what, attrs in (("attrs", about["attrs"]), *variables.items()):
        for name, value in _require(what, attrs, ()).items():
            if not isinstance(value, str | int | float):
                given = checks.shown(value)
                raise ValueError(f"{what}: {name} = {given}: must be text, an int or a float")
    return about


def _require(what: str, value: Any, names: Sequence[str]) -> dict[str, Any]:
    """A dict that has these names."""
    if not isinstance(value, dict):
        raise ValueError(f"{what} = {checks.shown(value)}: must be a dict of names and values")
    for name in names:
        if name not in value:
            raise ValueError(f"{what}: has no {name}; must be as it was saved")
    return value


def _are_texts(names: Any, count: int) -> bool:
    return (
        isinstance(names, list) and len(names) == count and all(isinstance(n, str) for n in names)
    )


def shapes_of(about: dict[str, Any]) -> dict[str, tuple[int, ...]]:
    """Shapes of all variables and coordinates, by name."""
    dims = {axis: (axis,) for axis in DIMS["transient"]} | DIMS | ERRORS
    return {name: tuple(about["sizes"][axis] for axis in axes) for name, axes in dims.items()}


def restore(about: dict[str, Any], arrays: dict[str, np.ndarray]) -> xr.Dataset:
    """The Dataset from its description and the arrays of its variables and coordinates.

    Raises:
        ValueError: They do not fit together; one line.
    """
    import xarray as xr

    arrays = {**arrays, "channel": np.array(about["channel"])}
    dims = {axis: (axis,) for axis in DIMS["transient"]} | DIMS | ERRORS
    variables = {
        name: (dims[name], array, about["variables"][name]) for name, array in arrays.items()
    }
    for name, shape in shapes_of(about).items():
        if name in arrays and arrays[name].shape != shape:
            its = arrays[name].shape
            raise ValueError(f"{name} with shape {its}: must be {shape}, as sizes says")
    dataset = xr.Dataset(
        {name: variables[name] for name in DIMS | ERRORS if name in variables},
        coords={name: variables[name] for name in DIMS["transient"]},
        attrs=about["attrs"],
    )
    check_dataset(dataset)
    return in_components(labelled(dataset))


def refuse_not_finite(path: str | os.PathLike, dataset: xr.Dataset) -> None:
    """Refuse a file whose light is not finite in all bins and pixels.

    Raises:
        ValueError: One line that says how many values are not, and where the first is.
    """
    try:
        require_finite(dataset)
    except ValueError as error:
        raise ValueError(f"path = {path}: {error}") from None


def warn_of_not_finite(dataset: xr.Dataset, stacklevel: int = 3) -> None:
    """Say that a file will not be readable, rather than lose what it took hours to render."""
    try:
        require_finite(dataset)
    except ValueError as error:
        warnings.warn(f"{error}; what is written now cannot be read again", stacklevel=stacklevel)
