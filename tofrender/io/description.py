"""Description of a Dataset in files: everything except its arrays, as a JSON object."""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..labels import FILM, read
from ..rendering import dataset as datasets
from ..rendering.dataset import DIMS, ERRORS, HALVES, plain_attributes
from ..rendering.labels import labeled
from ..runtime import checks

if TYPE_CHECKING:
    import xarray as xr

_AXES = DIMS["transient"]
_DIMS = {axis: (axis,) for axis in _AXES} | DIMS | ERRORS | HALVES  # Axes of each array of a file


def describe(dataset: xr.Dataset) -> dict[str, Any]:
    """Describe sizes, channels, and attributes of the Dataset, its variables and coordinates."""
    return {
        "sizes": {str(axis): size for axis, size in dataset.sizes.items()},
        "channel": dataset["channel"].values.tolist(),
        "attrs": plain_attributes(dataset),
        "variables": {str(k): plain_attributes(each) for k, each in dataset.variables.items()},
    }


def parse(text: Any) -> dict[str, Any]:
    """Parse and check a description, as JSON."""
    try:
        description = json.loads(str(text))
    except (ValueError, RecursionError):
        raise ValueError(
            "the description in the file is not JSON. Save the Dataset again"
        ) from None

    # Check the sizes of the axes and the names of the channels
    _require("its description", description, ("sizes", "channel", "attrs", "variables"))
    sizes = _require("sizes", description["sizes"], _AXES)
    for axis in _AXES:
        checks.integer(f"sizes: {axis}", sizes[axis], 1, 1 << 40)
    names = description["channel"]
    count = sizes["channel"]
    are_texts = isinstance(names, list) and all(isinstance(name, str) for name in names)
    valid = names in (["L"], ["R", "G", "B"]) or (are_texts and len(names) == count)
    checks.require("channel", names, valid, f"{count} names")

    # Check all attributes
    variables = _require("variables", description["variables"], (*DIMS, *_AXES))
    for owner, attrs in (("attrs", description["attrs"]), *variables.items()):
        for name, value in _require(owner, attrs).items():
            allowed = "text, an int or a float"
            checks.instance(f"{owner}: {name}", value, str | int | float, allowed)
    return description


def _require(what: str, value: Any, keys: Sequence[str] = ()) -> dict[str, Any]:
    """Require a dict with these keys."""
    checks.instance(what, value, dict, "a dict of names and values")
    for key in keys:
        if key not in value:
            raise ValueError(f"{what}: {key} is missing in the file. Save the Dataset again")
    return value


def shapes_of(description: dict[str, Any]) -> dict[str, tuple[int, ...]]:
    """Return the shapes of all variables and coordinates, by name."""
    sizes = {"feature": 0} | description["sizes"]
    return {name: tuple(sizes[axis] for axis in axes) for name, axes in _DIMS.items()}


def restore(description: dict[str, Any], arrays: dict[str, np.ndarray]) -> xr.Dataset:
    """Make a Dataset from its description and the arrays of its variables and coordinates."""
    import xarray as xr

    for name, shape in shapes_of(description).items():
        if name in arrays:
            valid = arrays[name].shape == shape
            checks.shape(name, arrays[name], valid, f"{shape}, as in sizes")
    arrays = {**arrays, "channel": np.array(description["channel"])}
    attrs = description["variables"]
    variables = {name: (_DIMS[name], array, attrs[name]) for name, array in arrays.items()}
    dataset = xr.Dataset(
        {name: variables[name] for name in DIMS | ERRORS | HALVES if name in variables},
        coords={name: variables[name] for name in _AXES},
        attrs=description["attrs"],
    )

    # Do the labels agree with the attributes?
    found = read(dataset, FILM, "dataset")
    if found is not dataset:
        raise ValueError(
            "pixels, channels or time bins in the file contradict the attributes. Save the Dataset "
            "again"
        )
    datasets.require_storable(dataset)
    return datasets.in_components(labeled(dataset))


def warn_not_finite(dataset: xr.Dataset, stacklevel: int = 3) -> None:
    """Warn that a file will not be readable. An error would lose a render of hours."""
    try:
        datasets.require_finite(dataset)
    except ValueError as error:
        warnings.warn(f"{error}; the written file cannot be read again", stacklevel=stacklevel)
