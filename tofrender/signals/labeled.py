"""DataArrays as arguments of functions of arrays: several of them, with axes in one order."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def of_same_axes(named: Mapping[str, Any]) -> list[Any]:
    """Return values by their parameters' names, in the order of the axes of the first DataArray.

    Axes of the first DataArray may be missing in the others. Arrays without labels are returned
    unchanged.

    Raises:
        ValueError: A DataArray has other axes or labels than the first one; one line.

    Example:
        >>> import xarray as xr
        >>> one = xr.DataArray([[1.0, 2.0]], dims=("y", "x"))
        >>> [each.dims for each in of_same_axes({"I": one, "Q": one.T})]
        [('y', 'x'), ('y', 'x')]
    """
    import xarray as xr  # Slow: rendering does not need it

    first = ""
    found = []
    for name, values in named.items():
        if not isinstance(values, xr.DataArray):
            found.append(values)
            continue
        first = first or name
        axes = named[first].dims
        if not set(values.dims) <= set(axes):
            raise ValueError(
                f"{first} has the axes {axes}, and {name} has {values.dims}. Pass arrays with the "
                "same axes"
            )

        # Compare the labels
        for axis in values.indexes.keys() & named[first].indexes.keys():
            if not values.indexes[axis].equals(named[first].indexes[axis]):
                raise ValueError(
                    f"{first} and {name} have different labels along the axis {axis}. Select the "
                    "same part of both"
                )
        found.append(values.transpose(*(axis for axis in axes if axis in values.dims)))
    return found


def frequencies_first(name: str, values: Any, frequencies: Sequence[float]) -> Any:
    """Bring the axis `frequency` of a DataArray to the front; others stay as they are."""
    import xarray as xr

    if not isinstance(values, xr.DataArray):
        return values
    if "frequency" not in values.dims:
        raise ValueError(
            f"{name} has the axes {tuple(values.dims)}, without frequency. Pass one frequency as a "
            "number, or name the axis of the frequencies: rename(...='frequency')"
        )
    given = values["frequency"].values
    if "frequency" in values.coords and not np.array_equal(given, frequencies):
        raise ValueError(
            f"{name} has the frequencies {given.tolist()} Hz, but {list(frequencies)} were passed. "
            "Pass the frequencies in the same order"
        )
    return values.transpose("frequency", ...)
