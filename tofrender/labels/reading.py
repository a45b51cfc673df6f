"""Read labeled data: find axes by name, bring them to one order, and check the time bins."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..runtime import checks
from ..signals.units import opl_to_ns
from .axes import CHANNELS, PARTS, STOKES, WEIGHTINGS, XYZ, Bins
from .dataset_kinds import Kind

SAME_WIDTH = 1e-3  # Relative error of the distance of bins that rounding explains
SAME_START = 1e-5  # Error of the start of bins that rounding explains [bins]
SAME_PLACE = 0.01  # Distance of a single bin from the places of the original bins [bins]
ORDERED = {
    "channel": CHANNELS,
    "stokes": STOKES,
    "xyz": XYZ,
    "axis": XYZ,
    "part": PARTS,
    "weighting": WEIGHTINGS,
}
"""Names along an axis in their order. Unknown names keep their order."""
WHOLE = ("xyz", "axis", "part", "weighting")
"""Axes whose names must all be there: no function is defined on a choice of them."""
MAY_BE_EMPTY = ("point", "path")
"""Axes without entries that have a meaning: a scan without echoes, a pixel without paths."""
RISING = ("y", "x", "laser_y", "laser_x", "shot", "tap")
"""Axes of indices that rise."""
OF_A_FRAME: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "frame": ("time_s", float),
    "fingerprint": ("fingerprint", str),
}
"""Coordinates along `frame`, with the name and the type of the attribute of a single frame."""


def read(data: Any, kind: Kind | tuple[Kind, ...], parameter: str) -> xr.Dataset:
    """Return a Dataset with the axes, channels and bins of a kind in their order.

    A Dataset in the right order is returned unchanged. Parts of the window, crops, and choices of
    channels are accepted. The attributes `start_opl` and `bin_width_opl` of the result
    follow the coordinate `opl`. Coordinates without an axis, which remain after `isel(frame=2)`,
    are dropped. Time and fingerprint of the frame become attributes.

    Args:
        data: Argument of the user.
        kind: Kind of Dataset that the function supports. If there are several, the kind with the
            most variables and axes of the Dataset is chosen.
        parameter: Name of the function's parameter, for messages.

    Raises:
        ValueError: Another object, a missing variable or axis, an axis without labels or with equal
            labels, or bins that do not follow each other.

    Example:
        >>> x = np.arange(3)
        >>> opl = 1.0 + 0.5 * (np.arange(4) + 0.5)
        >>> counts = xr.Dataset(
        ...     {"counts": (("y", "x", "bin"), np.zeros((2, 3, 4)))},
        ...     {"y": np.arange(2), "x": x, "opl": ("bin", opl)},
        ...     {"start_opl": 1.0, "bin_width_opl": 0.5},
        ... )
        >>> from tofrender.labels import COUNTS
        >>> part = counts.isel(bin=slice(2, None), x=[2, 0]).transpose("bin", "x", "y")
        >>> found = read(part, COUNTS, "counts")
        >>> found["counts"].dims, found["x"].values.tolist(), found.attrs["start_opl"]
        (('y', 'x', 'bin'), [0, 2], 2.0)
    """
    # Which kind of Dataset is this?
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if not isinstance(data, xr.Dataset):
        names = " or ".join(dict.fromkeys(each.name for each in kinds))
        raise ValueError(f"{parameter}: expected {names}, found {_description(data)}")
    kind = _fitting(data, kinds)

    # Check variables and axes, and sort the labels
    data = _without_choices(data)
    _require_variables(data, kind, parameter)
    data = _in_order(data, kind, parameter)

    # Compute start and width of the bins from their coordinate
    if kind.bins in data.dims:
        bins = bins_of(data, parameter, kind.bins)
        data = _with_bins(data, bins)
    return data


def read_array(values: xr.DataArray, kind: Kind, parameter: str) -> xr.DataArray:
    """Return a DataArray with its axes, and the labels along them, in the order of a kind.

    Example:
        >>> from tofrender.labels import PIXELS
        >>> picture = xr.DataArray([[1, 2, 3]], {"x": [5], "y": [2, 1, 0]}, ("x", "y"))
        >>> read_array(picture, PIXELS, "picture").values.tolist()
        [[3], [2], [1]]
    """
    (name,) = kind.variables
    found = read(values.to_dataset(name=name), kind, parameter)[name]
    return found.sortby("opl") if "opl" in found.indexes else found


def bins_of(data: xr.Dataset | xr.DataArray, parameter: str, axis: str = "opl") -> Bins:
    """Return the time bins of labeled data, from the coordinate `opl`.

    Args:
        data: Dataset or DataArray with the centers of the bins as the coordinate `opl` [m].
        parameter: Name of the function's parameter, for messages.
        axis: Axis of the bins.

    Raises:
        ValueError: The coordinate is missing, or the bins are not consecutive and equally wide.
    """
    # Find the centers of the bins
    if "opl" not in data.coords or data["opl"].dims != (axis,):
        raise ValueError(
            f"{parameter}: the coordinate opl along the axis {axis} is missing. It contains the "
            "centers of the bins in m; select bins with a slice or a list"
        )
    centers = np.asarray(data["opl"].values, np.float64)
    if "time" in data.coords:
        _require_times(data["time"].values, centers, parameter)

    # Is the width of the bins their distance?
    stated: Any = data.attrs.get("bin_width_opl")
    is_stated = isinstance(stated, float | int | np.number) and np.isfinite(stated) and stated > 0
    if not is_stated and (isinstance(data, xr.Dataset) or len(centers) == 1):
        raise ValueError(
            f"{parameter}: the attribute bin_width_opl is missing. It is the width of a bin in m. "
            "Keep attributes with xarray.set_options(keep_attrs=True)"
        )
    if len(centers) == 1:
        width = float(stated)
    else:
        steps = np.diff(centers)
        width = float((centers[-1] - centers[0]) / len(steps))
        _require_even_steps(steps, width, "opl", parameter)
        if is_stated and not np.isclose(width, stated, rtol=SAME_WIDTH, atol=0):
            raise ValueError(
                f"{parameter}: the bins are {width:g} m apart, but {float(stated):g} m wide. To "
                "make wider bins, use tofrender.rebin instead of coarsen; do not skip bins"
            )
        width = float(stated) if is_stated else width

    # Keep the stated start if only rounding differs
    start = float(centers[0] - width / 2)
    stated_start: Any = data.attrs.get("start_opl")
    if isinstance(stated_start, float | int | np.number):
        skipped = (start - float(stated_start)) / width
        if abs(skipped) <= SAME_START:
            start = float(stated_start)
        elif len(centers) == 1 and abs(skipped - round(skipped)) > SAME_PLACE:
            raise ValueError(
                f"{parameter}: the bin at opl = {centers[0]:g} m is not one of the bins of "
                f"{width:g} m from {float(stated_start):g} m, as after coarsen. To make wider "
                "bins, use tofrender.rebin; drop the attribute start_opl if opl was moved"
            )
    return Bins(start, width, len(centers))


def even_axis(
    data: xr.Dataset,
    axis: str,
    parameter: str,
    *,
    stated: str = "",
    overlap: bool = False,
    width: float | None = None,
) -> tuple[float, float]:
    """Return the start of the first bin, and the width of the bins, along an axis of numbers.

    Args:
        data: A Dataset.
        axis: Name of the coordinate with the centers of the bins.
        parameter: Name of the function's parameter, for messages.
        stated: Name of the attribute with the width of a bin, "" without one.
        overlap: Whether the distance of bins may differ from their width, as for gates.
        width: Width of a single bin without a stated width. None if two bins or more are needed.

    Raises:
        ValueError: The centers are not finite, or they do not rise in steps of the width.
    """
    # Read the stated width
    number: Any = data.attrs.get(stated)
    known = float(number) if isinstance(number, float | int | np.number) else None

    # A single bin has the stated width
    centers = np.asarray(data[axis].values, np.float64)
    if len(centers) == 1:
        single = width if known is None else known
        if single is None:
            raise ValueError(f"{parameter}: the axis {axis} has one entry only. Select two or more")
        return float(centers[0]) - single / 2, single

    # Other bins must be as wide as their distance
    width = float(centers[-1] - centers[0]) / (len(centers) - 1)
    _require_even_steps(np.diff(centers), width, axis, parameter)
    if known is not None and not overlap and not np.isclose(width, known, SAME_WIDTH, atol=0):
        raise ValueError(
            f"{parameter}: the bins of {axis} are {width:g} apart, but {known:g} wide. Use fewer "
            "bins in the simulation instead of coarsen; do not skip bins"
        )
    return float(centers[0]) - width / 2, width


def intensity(data: xr.Dataset | xr.DataArray, parameter: str) -> Any:
    """Return the component S0 of polarized data, and other data unchanged.

    `parameter` is the name of the data in error messages.
    """
    if "stokes" not in data.dims:
        return data
    if "S0" not in data["stokes"].values:
        raise ValueError(f"{parameter}: the axis stokes does not contain S0, the intensity")
    return data.sel(stokes="S0", drop=True)


def require_whole_stokes(data: xr.Dataset | xr.DataArray, parameter: str) -> None:
    """Raise a ValueError if polarized data lack one of the four Stokes components."""
    found = [str(name) for name in data["stokes"].values] if "stokes" in data.dims else [*STOKES]
    if found != [*STOKES]:
        raise ValueError(
            f"{parameter}: the axis stokes contains {', '.join(found)} only. Pass all of "
            "S0, S1, S2 and S3, or one of them without its axis: sel(stokes='S0', drop=True)"
        )


def pixel_steps(data: xr.Dataset | xr.DataArray, parameter: str) -> dict[str, int]:
    """Return the distance of neighboring pixels along y and x, which must be constant.

    A sensor with larger pixels labels them with the index of their first pixel on the film.
    """
    steps = {}
    for axis in ("y", "x"):
        distances = np.diff(data[axis].values)
        steps[axis] = int(distances[0]) if distances.size else 1
        _require_no_gaps(distances, steps[axis], axis, parameter)
    return steps


def require_axes_only(data: xr.Dataset, parameter: str) -> None:
    """Raise a ValueError for further coordinates along an axis, since files do not contain them.

    Supported are the labels of each axis, and `opl` and `time` of the bins.
    """
    for name, coordinate in data.coords.items():
        if coordinate.dims and name not in (*data.dims, "opl", "time"):
            raise ValueError(
                f"{parameter}: the coordinate {name} along {coordinate.dims[0]} is not supported "
                f"in files. Drop the coordinate: drop_vars('{name}')"
            )


def require_consecutive(data: xr.Dataset | xr.DataArray, parameter: str) -> None:
    """Raise a ValueError if the pixels are not a rectangle of a film without gaps."""
    for axis in ("y", "x"):
        _require_no_gaps(np.diff(data[axis].values), 1, axis, parameter)


def require_same_labels(
    data: xr.Dataset | xr.DataArray, expected: Mapping[str, Any], parameter: str, other: str
) -> None:
    """Refuse data with other labels along an axis.

    Args:
        data: A Dataset or DataArray in the order of `read`.
        expected: Labels by the name of the axis.
        parameter: Name of the function's parameter, for messages.
        other: What has the expected labels, for messages.
    """
    for axis, labels in expected.items():
        found = data[axis].values
        if not np.array_equal(found, labels):
            raise ValueError(
                f"{parameter}: the axis {axis} has the labels {checks.quote(found.tolist())}, but "
                f"{other} has {checks.quote(np.asarray(labels).tolist())}. Pass data with the same "
                "labels"
            )


def by_pixel(values: Any, data: Any, parameter: str) -> Any:
    """Return values of pixels (y, x) in the order in which `read` returns a Dataset.

    Args:
        values: An array (y, x) in the order of the rows and columns of the Dataset, or a DataArray.
            The labels of a DataArray must be the labels of the Dataset.
        data: The Dataset in the order of the user.
        parameter: Name of the parameter of the values, for messages.

    Raises:
        ValueError: A DataArray with other pixels or axes.
    """
    axes = ("y", "x")
    if not isinstance(data, xr.Dataset) or not set(axes) <= set(data.dims):
        return values  # `read` refuses the Dataset
    labels = [data[axis].values for axis in axes]

    # Sort an array as the rows and columns of the Dataset are sorted
    if not isinstance(values, xr.DataArray):
        order = [np.argsort(each, kind="stable") for each in labels]
        array = checks.real_array(parameter, values)
        fits = array.shape == tuple(each.size for each in order)
        return array[np.ix_(*order)] if fits else array

    # Sort a DataArray by its labels, and compare them
    missing = {
        axis: own
        for axis, own in zip(axes, labels, strict=True)
        if axis not in values.coords and values.sizes.get(axis) == own.size
    }
    values = values.assign_coords(missing)
    kind = Kind("an array with the axes y and x", {"values": axes}, real=axes)
    found = read(xr.Dataset({"values": values}), kind, parameter)["values"]
    for axis, own in zip(axes, labels, strict=True):
        same = found.sizes[axis] == own.size and np.allclose(found[axis].values, np.sort(own))
        if not same:
            raise ValueError(
                f"{parameter}: the axis {axis} has other labels than the Dataset. Make the same "
                "selection from both"
            )
    return found.values


def _fitting(data: xr.Dataset, kinds: tuple[Kind, ...]) -> Kind:
    """Return the kind with the most variables and axes of a Dataset."""
    found = {*map(str, data.data_vars), *map(str, data.dims)}

    def common(kind: Kind) -> int:
        axes = {axis for each in kind.variables.values() for axis in each}
        return len(found & (axes | {*kind.variables}))

    return max(kinds, key=common)


def _description(data: Any) -> str:
    if isinstance(data, xr.DataArray):
        return f"a DataArray{f' named {data.name}' if data.name else ''}; pass the whole Dataset"
    return type(data).__name__


def _without_choices(data: xr.Dataset) -> xr.Dataset:
    """Drop coordinates without an axis. Time and fingerprint of a frame become attributes."""
    names = [name for name, each in data.coords.items() if not each.dims]
    if not names:
        return data
    attrs = {
        attribute: type_of(data[name].item())
        for name, (attribute, type_of) in OF_A_FRAME.items()
        if name in names
    }
    return data.drop_vars(names).assign_attrs(attrs)


def _require_variables(data: xr.Dataset, kind: Kind, parameter: str) -> None:
    """Raise a ValueError if variables or axes are missing or unknown."""
    # Check the variables of the kind
    for name, axes in kind.all_variables.items():
        if name not in data.data_vars:
            if name in kind.variables:
                raise ValueError(
                    f"{parameter}: expected {kind.name}, but the variable {name} is missing"
                )
            continue
        if data[name].dtype.kind not in "biuf":
            raise ValueError(
                f"{parameter}: the variable {name} has the type {data[name].dtype}; it must "
                "contain real numbers"
            )

        # Check its axes
        found = set(data[name].dims) - {"stokes"}
        for axis, size in data[name].sizes.items():
            if size == 0 and axis not in MAY_BE_EMPTY:
                raise ValueError(
                    f"{parameter}: the axis {axis} is empty. Select one entry of it or more"
                )
        for axis in axes:
            if axis not in found:
                raise ValueError(
                    f"{parameter}: the axis {axis} of the variable {name} is missing. To choose "
                    f"along the axis, keep it: isel({axis}=[0]) instead of isel({axis}=0)"
                )
        for axis in sorted(map(str, found - set(axes))):
            raise ValueError(
                f"{parameter}: the variable {name} has the additional axis {axis}. Choose along "
                f"the axis: isel({axis}=0)"
            )

    # Are there other variables?
    unknown = sorted(str(name) for name in set(data.data_vars) - set(kind.all_variables))
    if kind.closed and unknown:
        raise ValueError(
            f"{parameter}: the variable {unknown[0]} is not supported in {kind.name}. Drop the "
            f"variable: drop_vars('{unknown[0]}')"
        )


def _in_order(data: xr.Dataset, kind: Kind, parameter: str) -> xr.Dataset:
    """Sort the axes, and the labels along the axes."""
    # Sort the labels along each axis that the kind contains
    known = {axis for axes in kind.all_variables.values() for axis in axes} | {"stokes"}
    for axis in map(str, data.dims):
        if axis not in known:
            continue  # No function reads the variables along this axis
        order = _order_along(data, axis, kind, parameter)
        if order is not None and (np.diff(order) < 0).any():
            data = data.isel({axis: order})

    # Transpose the variables; Stokes components precede the channels
    changes = {}
    for name, axes in kind.all_variables.items():
        if name in data.data_vars:
            wanted = list(axes)
            if "stokes" in data[name].dims:
                wanted.insert(wanted.index("channel"), "stokes")
            if data[name].dims != tuple(wanted):
                changes[name] = data[name].transpose(*wanted)
    return data.assign(changes) if changes else data


def _order_along(data: xr.Dataset, axis: str, kind: Kind, parameter: str) -> np.ndarray | None:
    """Return the indices that bring the labels along an axis to their order."""
    if axis in ORDERED:
        return _order_of_names(data, axis, parameter)
    if axis == kind.bins:
        centers = data["opl"].values if "opl" in data.coords else np.arange(data.sizes[axis])
        return np.argsort(centers, kind="stable")
    if axis in kind.real and axis not in data.coords:
        raise ValueError(f"{parameter}: the coordinate {axis} is missing. Add it (assign_coords)")
    if axis not in (*RISING, *kind.real) or axis not in data.coords:
        return None
    labels = data[axis].values
    if axis in kind.real:
        if labels.dtype.kind not in "iuf" or not np.isfinite(labels).all():
            raise ValueError(f"{parameter}: the coordinate {axis} must contain finite numbers")
    elif axis != "shot" and labels.dtype.kind not in "iu":
        raise ValueError(
            f"{parameter}: the labels along the axis {axis} must be integers; coarsen makes "
            "fractions. For coarser pixels, use tofrender.rebin(..., pixels=(columns, rows))"
        )
    _require_different(labels, axis, parameter)
    return np.argsort(labels, kind="stable")


def _order_of_names(data: xr.Dataset, axis: str, parameter: str) -> np.ndarray:
    """Return the indices that bring channels or Stokes components to their order."""
    known = ORDERED[axis]
    if axis not in data.coords and axis == "channel" and data.sizes[axis] == 1:
        return np.arange(1)
    if axis not in data.coords:
        raise ValueError(
            f"{parameter}: the labels of the axis {axis} are missing. Assign labels, for example "
            f"assign_coords({axis}={list(known[: data.sizes[axis]])})"
        )

    # Sort known names; others keep their order
    names = [str(name) for name in data[axis].values]
    _require_different(np.array(names), axis, parameter)
    if axis in WHOLE and set(names) != set(known):
        raise ValueError(
            f"{parameter}: the axis {axis} contains {', '.join(names)} only. Pass all of "
            f"{', '.join(known)}"
        )
    if not set(names) <= set(known):
        return np.arange(len(names))
    return np.argsort([known.index(name) for name in names], kind="stable")


def _require_different(labels: np.ndarray, axis: str, parameter: str) -> None:
    values, counts = np.unique(labels, return_counts=True)
    if (counts > 1).any():
        raise ValueError(
            f"{parameter}: the label {values[counts > 1][0]} occurs {counts.max()} times along "
            f"the axis {axis}. Each label must occur once"
        )


def _require_no_gaps(distances: np.ndarray, step: int, axis: str, parameter: str) -> None:
    if (distances != step).any():
        raise ValueError(f"{parameter}: the axis {axis} skips pixels. Select pixels with a slice")


def _require_even_steps(steps: np.ndarray, width: float, axis: str, parameter: str) -> None:
    if not width > 0 or not np.allclose(steps, width, rtol=SAME_WIDTH, atol=0):
        raise ValueError(
            f"{parameter}: the bins are not consecutive: the distances of the centers in the "
            f"coordinate {axis} are {steps.min():g} to {steps.max():g}. Select bins with a slice"
        )


def _require_times(time_ns: np.ndarray, opl: np.ndarray, parameter: str) -> None:
    """Raise a ValueError if times differ from the path lengths divided by c."""
    expected = opl_to_ns(opl)
    same_shape = time_ns.shape == expected.shape
    if not same_shape or not np.allclose(time_ns, expected, rtol=1e-9, atol=1e-9):
        raise ValueError(
            f"{parameter}: the coordinate time is not opl / c in ns. Drop it where opl is changed: "
            "drop_vars('time')"
        )


def _with_bins(data: xr.Dataset, bins: Bins) -> xr.Dataset:
    """Let the attributes of the time bins follow the coordinate."""
    stated = {"start_opl": bins.start_opl, "bin_width_opl": bins.bin_width_opl}
    if all(data.attrs.get(name) == value for name, value in stated.items()):
        return data
    return data.assign_attrs(stated)
