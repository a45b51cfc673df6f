"""The capture Dataset: time-resolved light of a relay wall, with all geometry in world space.

`transient` contains radiance per bin, or the photon counts of a measurement. A single or confocal
capture has the axes `(y, x, opl, channel)`, and an exhaustive capture has the axes
`(laser_y, laser_x, y, x, opl, channel)`. Further variables contain the points of the wall at which
sensor and laser are aimed, and the normals of the wall at these points. If some pixels do not look
at the wall, the mask `on_wall (y, x)` is false there, and these pixels are dark.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..labels import CAPTURE, COUNTS as COUNTED, Kind, bins_of, read, require_axes_only
from ..rendering.cubes import Cube
from ..rendering.dataset import plain_attributes, require_plain_attributes
from ..rendering.labels import TIME, labeled, with_time
from ..runtime import checks, memory
from .modes import MODES

if TYPE_CHECKING:
    import xarray as xr

COUNTS = "photon counts per bin"
QUANTITIES = {"radiance per bin": "W m^-2 sr^-1", COUNTS: "1"}
"""Quantities of captures, with their units."""

COUNTED_ATTRIBUTES = ("quantity", "units", "capture_mode", "start_opl", "bin_width_opl")
"""Attributes of a result of `sense` that a capture of its counts replaces."""

DEVICES = ("laser", "sensor")
ON_WALL = "on_wall"
_PIXELS = ("y", "x")
_LASERS = ("laser_y", "laser_x")


def make_capture(
    transient: Any,
    *,
    mode: str,
    start_opl: float,
    bin_width_opl: float,
    sensor_grid: Any,
    sensor_normals: Any,
    laser_grid: Any = None,
    laser_normals: Any = None,
    sensor_origin: Any = None,
    laser_origin: Any = None,
    counts_first_and_last_legs: bool = False,
    on_wall: Any = None,
    quantity: str = "radiance per bin",
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Create and check the Dataset of a capture.

    Args:
        transient: Radiance per bin [W m^-2 sr^-1] or photon counts, with the shape (rows, columns,
            bins). An exhaustive capture has the shape (laser rows, laser columns, rows, columns,
            bins). A last axis of 1 or 3 channels is optional.
        mode: "single", "confocal" or "exhaustive".
        start_opl: Path length where the first bin starts [m].
        bin_width_opl: Width of a bin [m].
        sensor_grid: Points of the wall at which the sensor looks [m], (rows, columns, 3).
        sensor_normals: Unit normals of the wall at these points, towards the hidden scene.
        laser_grid: Laser spots on the wall [m]: (3,) or (1, 1, 3) in a single capture, (laser rows,
            laser columns, 3) in an exhaustive capture, None in a confocal capture.
        laser_normals: Unit normals of the wall at the laser spots, None in a confocal capture.
        sensor_origin: Position of the sensor [m], None if unknown.
        laser_origin: Position of the laser [m], None if unknown.
        counts_first_and_last_legs: Whether lengths include laser to wall and wall to sensor.
        on_wall: Mask of the pixels that look at the wall, bool (rows, columns). None if all do.
        quantity: "radiance per bin" or "photon counts per bin".
        attrs: Further attributes: text, ints and floats.

    Returns:
        A Dataset of `transient`, grids, normals and origins, float32. If some pixels do not look
        at the wall, the Dataset also contains the bool variable `on_wall`.

    Raises:
        ValueError: An argument is invalid, or arguments contradict each other.

    Example:
        >>> x, y = np.meshgrid(np.linspace(-1, 1, 8), np.linspace(-1, 1, 8))
        >>> wall = np.stack([x, y, 0 * x], axis=-1)
        >>> points = {"sensor_grid": wall, "sensor_normals": np.broadcast_to([0, 0, 1], wall.shape)}
        >>> bins = {"start_opl": 1.0, "bin_width_opl": 0.01}
        >>> make_capture(np.zeros((8, 8, 100)), mode="confocal", **bins, **points)["transient"].dims
        ('y', 'x', 'opl', 'channel')
    """
    import xarray as xr

    # Check mode, quantity and bins
    checks.one_of("mode", mode, MODES)
    checks.one_of("quantity", quantity, QUANTITIES)
    start = checks.meters("start_opl", start_opl)
    width = checks.meters("bin_width_opl", bin_width_opl, positive=True)

    # Read the light
    dims = dimensions(mode)["transient"]
    labels: dict[str, Any] = {}
    _require_bins(transient, start, width)
    transient = _in_axis_order("transient", transient, dims, labels)
    values = checks.real_array("transient", transient, np.float32)

    # Read further attributes. Files store this boolean as an integer
    more = checks.mapping("attrs", attrs)
    legs = counts_first_and_last_legs
    legs = bool(legs) if isinstance(legs, int) and legs in (0, 1) else legs
    legs = checks.boolean("counts_first_and_last_legs", legs)

    # Add a missing axis of channels
    light = values[..., None] if values.ndim == len(dims) - 1 else values
    valid = light.ndim == len(dims) and light.shape[-1] in (1, 3) and 0 not in light.shape
    allowed = f"{dims} of a {mode} capture, with 1 or 3 channels"
    checks.shape("transient", values, valid, allowed)

    # Confocal captures have their laser spots at the points of the sensor
    if mode == "confocal":
        for name, given in (("laser_grid", laser_grid), ("laser_normals", laser_normals)):
            allowed = "None, as a confocal capture has the sensor's"
            checks.require(name, given, given is None, allowed)
        laser_grid = sensor_grid
        laser_normals = sensor_normals

    # Single captures have one laser spot
    elif mode == "single" and np.shape(laser_grid) == (3,):
        laser_grid = np.reshape(laser_grid, (1, 1, -1))
        laser_normals = np.reshape(laser_normals, (1, 1, -1))

    # Check all variables
    unknown = np.full(3, np.nan, np.float32)
    arrays = {
        "transient": light,
        "sensor_grid": sensor_grid,
        "sensor_normals": sensor_normals,
        "laser_grid": laser_grid,
        "laser_normals": laser_normals,
        "sensor_origin": unknown if sensor_origin is None else sensor_origin,
        "laser_origin": unknown if laser_origin is None else laser_origin,
    }
    variables = {}
    for name, axes in dimensions(mode).items():
        array = checks.real_array(
            name, _in_axis_order(name, arrays[name], axes, labels), np.float32
        )
        valid = array.ndim == len(axes) and (axes[-1] != "xyz" or array.shape[-1] == 3)
        checks.shape(name, array, valid, f"{axes}, xyz of size 3")
        variables[name] = (axes, array if name == "transient" else array.copy())

    # Check the mask; a mask without a dark pixel is omitted
    if on_wall is not None:
        try:
            mask = np.asarray(_in_axis_order("on_wall", on_wall, _PIXELS, labels))
        except (TypeError, ValueError):
            mask = np.array(None)
        valid = mask.dtype == bool and mask.ndim == 2
        checks.require("on_wall", on_wall, valid, "bool (rows, columns)")
        if not mask.all():
            variables[ON_WALL] = (_PIXELS, mask.copy())

    # All variables must have the same size on shared axes
    sizes: dict[str, int] = {}
    for name, (axes, array) in variables.items():
        for axis, size in zip(axes, array.shape, strict=True):
            valid = sizes.setdefault(axis, size) == size
            same = f"of size {sizes[axis]} on the axis {axis}, as other variables are"
            checks.shape(name, array, valid, same)

    # Add coordinates and attributes
    coords: dict[str, Any] = {a: np.arange(n) for a, n in sizes.items() if a[-1] in "xy"}
    coords |= {
        "opl": start + (np.arange(sizes["opl"]) + 0.5) * width,
        "channel": np.array(["L"] if sizes["channel"] == 1 else ["R", "G", "B"]),
        "xyz": np.array(["x", "y", "z"]),
    }
    standard = {
        "quantity": quantity,
        "units": QUANTITIES[quantity],
        "capture_mode": mode,
        "start_opl": start,
        "bin_width_opl": width,
        "counts_first_and_last_legs": int(legs),
    }
    capture = labeled(xr.Dataset(variables, coords=coords, attrs=more | standard))
    check_capture(capture)
    return capture


def _require_bins(transient: Any, start: float, width: float) -> None:
    """Refuse labeled light whose coordinate `opl` has other bins than the given numbers."""
    import xarray as xr

    if not isinstance(transient, xr.DataArray) or "opl" not in transient.indexes:
        return
    centers = np.sort(transient["opl"].values.astype(np.float64))
    expected = start + (np.arange(centers.size) + 0.5) * width
    if not np.allclose(centers, expected, rtol=0, atol=1e-3 * width):
        raise ValueError(
            f"transient: the bins in the coordinate opl begin at {centers[0]:g} m, but start_opl "
            f"and bin_width_opl give {expected[0]:g} to {expected[-1]:g} m. Pass the start and the "
            "width of these bins"
        )


def _in_axis_order(name: str, values: Any, axes: tuple[str, ...], labels: dict[str, Any]) -> Any:
    """Return the values of a DataArray with its axes, and the labels of each axis, in order.

    Arrays without labels are returned unchanged. The axis of channels is optional. `labels`
    collects the labels of pixels and laser spots, which must be the same in all arrays.
    """
    import xarray as xr

    if not isinstance(values, xr.DataArray):
        return values
    axes = tuple(axis for axis in axes if axis != "channel" or axis in values.dims)
    kind = Kind(f"an array with the axes {', '.join(axes)}", {name: axes})
    found = read(xr.Dataset({name: values}), kind, "make_capture")[name]
    if "opl" in found.coords and found["opl"].dims == ("opl",):
        found = found.sortby("opl")

    # Do the arrays have the same pixels?
    for axis in {*_PIXELS, *_LASERS} & found.indexes.keys():
        own = found[axis].values
        if not np.array_equal(labels.setdefault(axis, own), own):
            raise ValueError(
                f"{name}: the axis {axis} has other labels than in arrays before it. Select the "
                "same part of all arrays"
            )
    return found.values


def dimensions(mode: str) -> dict[str, tuple[str, ...]]:
    """Return the axes of each variable of a capture in a mode."""
    laser = _PIXELS if mode == "confocal" else _LASERS
    return {
        "transient": (*(_LASERS if mode == "exhaustive" else ()), *_PIXELS, "opl", "channel"),
        "sensor_grid": (*_PIXELS, "xyz"),
        "sensor_normals": (*_PIXELS, "xyz"),
        "laser_grid": (*laser, "xyz"),
        "laser_normals": (*laser, "xyz"),
        "sensor_origin": ("xyz",),
        "laser_origin": ("xyz",),
    }


def as_capture(dataset: Any) -> Any:
    """Convert photon counts that `sense` simulated from a capture to a capture.

    Args:
        dataset: A capture, or a result of `sense` with the geometry of a capture.

    Returns:
        A capture of photon counts. Other objects than a result of `sense` are returned unchanged.
    """
    # Is this a result of `sense` for a capture?
    variables = set(getattr(dataset, "data_vars", ()))
    if "transient" in variables or not {"counts", "sensor_grid"} <= variables:
        return dataset

    # Read its variables
    mode = dataset.attrs["capture_mode"]
    axes = dimensions(mode)
    axes.pop("transient")
    if mode == "confocal":
        del axes["laser_grid"], axes["laser_normals"]
    optional = {ON_WALL: _PIXELS}
    kind = Kind("a result of sense", COUNTED.variables | axes, optional, bins="bin")
    dataset = read(dataset, kind, "capture")
    bins = bins_of(dataset, "capture", "bin")

    # Convert its attributes
    attrs = plain_attributes(dataset)
    legs = attrs["counts_first_and_last_legs"]
    about = {name: value for name, value in attrs.items() if name not in COUNTED_ATTRIBUTES}
    if "cycles" in variables:
        about["cycles"] = int(dataset["cycles"].max())
    return make_capture(
        dataset["counts"].values,
        mode=mode,
        start_opl=bins.start_opl,
        bin_width_opl=bins.bin_width_opl,
        counts_first_and_last_legs=legs,
        on_wall=dataset[ON_WALL].values if ON_WALL in variables else None,
        quantity=COUNTS,
        attrs=about,
        **{name: dataset[name].values for name in axes},
    )


def read_capture(dataset: Any, parameter: str) -> xr.Dataset:
    """Return a capture with its axes, channels and bins in order.

    A part of the window, a crop, or a selection of channels of a capture is accepted.

    Raises:
        ValueError: The dataset is not a capture or a part of a capture.
    """
    import xarray as xr

    kind = CAPTURE
    if isinstance(dataset, xr.Dataset):
        mode = MODES[0]
        if "sensor_grid" in dataset:
            name = f"{parameter}: attribute capture_mode"
            mode = checks.one_of(name, dataset.attrs.get("capture_mode"), MODES)
        kind = Kind(
            "a capture",
            variables=dimensions(mode),
            optional={ON_WALL: _PIXELS},
            bins="opl",
            closed=True,
        )
    dataset = read(dataset, kind, parameter)
    _require_geometry(dataset)
    require_axes_only(dataset, parameter)
    require_plain_attributes(dataset)
    return dataset


def check_capture(dataset: Any) -> None:
    """Raise a ValueError if a dataset is not a capture or a part of a capture.

    Raises:
        ValueError: Variables, axes or attributes are missing or contradict each other.
    """
    read_capture(dataset, "capture")


def _require_geometry(dataset: xr.Dataset) -> None:
    """Raise a ValueError for impossible points or normals, and for unknown origins of segments."""
    mode = dataset.attrs["capture_mode"]
    if dataset.sizes["channel"] not in (1, 3):
        raise ValueError(f"capture with {dataset.sizes['channel']} channels: must be 1 or 3")
    for name, variable in dataset.data_vars.items():
        kind, allowed = ("b", "booleans") if name == ON_WALL else ("f", "floats")
        if variable.dtype.kind != kind:
            raise ValueError(
                f"capture: the variable {name} has the type {variable.dtype}; it must contain "
                f"{allowed}"
            )
    if mode == "single" and dataset["laser_grid"].shape != (1, 1, 3):
        raise ValueError("capture: laser_grid: a single capture must have one laser spot")

    # Points and normals
    for kind in ("grid", "normals"):
        vectors = {name: dataset[name].values for name in (f"sensor_{kind}", f"laser_{kind}")}
        for name, values in vectors.items():
            if not np.isfinite(values).all():
                raise ValueError(f"capture: {name}: must contain finite numbers only")
            lengths = np.linalg.norm(values, axis=-1)
            if kind == "normals" and not np.allclose(lengths, 1, atol=1e-3):
                raise ValueError(f"capture: {name}: must contain vectors of length 1")
        if mode == "confocal" and not np.array_equal(*vectors.values()):
            raise ValueError(
                f"capture: laser_{kind} of a confocal capture must be equal to sensor_{kind}"
            )

    # Origins of the legs that path lengths include
    legs = plain_attributes(dataset).get("counts_first_and_last_legs")
    name = "capture: attribute counts_first_and_last_legs"
    checks.require(name, legs, legs in (0, 1), "0, 1")
    if legs and not all(np.isfinite(dataset[f"{d}_origin"].values).all() for d in DEVICES):
        raise ValueError(
            "capture: sensor_origin, laser_origin: must be finite if counts_first_and_last_legs = "
            "1, because path lengths include the legs from both"
        )


def first_and_last_legs(capture: xr.Dataset, devices: Collection[str] = DEVICES) -> np.ndarray:
    """Return the lengths of the legs from laser to wall and from wall to sensor [m].

    Args:
        capture: The capture. If its `opl` does not count the legs, the result is 0.
        devices: The legs that are added: "laser", "sensor" or both.

    Returns:
        float64, (rows, columns). The shape is (laser rows, laser columns, rows, columns) for an
        exhaustive capture.
    """

    def leg(device: str) -> np.ndarray:
        points = capture[f"{device}_grid"].values
        origin = capture[f"{device}_origin"].values
        offset = points.astype(np.float64) - origin.astype(np.float64)
        return np.linalg.norm(offset, axis=-1) * (device in devices)

    laser, sensor = (leg(device) for device in DEVICES)
    if capture.attrs["capture_mode"] == "exhaustive":
        laser = laser[:, :, None, None]
    # In a single capture, the laser's legs have the shape (1, 1)
    legs = laser + sensor
    return legs if capture.attrs["counts_first_and_last_legs"] else np.zeros(legs.shape)


def without_first_and_last_legs(capture: Annotated[xr.Dataset, CAPTURE]) -> xr.Dataset:
    """Subtract the first and last legs, so that path lengths are from wall to wall.

    The bins of each pixel are shifted by the legs of this pixel. Light that falls between two new
    bins is divided between both, so that energy and mean path length are preserved. The bin width
    remains. The time axis starts as early as the pixel with the longest legs requires, and bins are
    added for the differences between pixels. A capture that does not count the legs is returned
    unchanged.

    Raises:
        ValueError: The argument is not a capture.

    Example:
        >>> wall = np.array([[[0.0, 0, 0], [1, 0, 0]]])
        >>> points = {"sensor_grid": wall, "sensor_normals": np.broadcast_to([0, 0, 1], wall.shape)}
        >>> bins = {"start_opl": 3, "bin_width_opl": 1, "counts_first_and_last_legs": True}
        >>> origins = {"sensor_origin": (0, 0, 1), "laser_origin": (0, 0, 1)}
        >>> light = [[[1, 0], [0, 2]]]
        >>> capture = make_capture(light, mode="confocal", **bins, **points, **origins)
        >>> bare = without_first_and_last_legs(capture)
        >>> round(bare.attrs["start_opl"], 3), bare["transient"].values[0, 0, :, 0].round(3)
        (0.172, array([0.172, 0.828, 0.   ], dtype=float32))
    """
    capture = read_capture(capture, "capture")
    if not capture.attrs["counts_first_and_last_legs"]:
        return capture
    return subtract_legs(capture, first_and_last_legs(capture))


def subtract_legs(capture: xr.Dataset, legs: np.ndarray) -> xr.Dataset:
    """Shift the bins of each pixel to earlier lengths by its `legs` [m].

    The result no longer counts these legs.
    """
    width = bins_of(capture, "capture").bin_width_opl
    start = float(capture["opl"].values[0] - width / 2)

    # Shift of each pixel relative to the pixel with the longest legs, towards later bins [bins]
    shift = (legs.max() - legs) / width
    extra = math.ceil(shift.max())
    whole = np.minimum(np.floor(shift), max(extra - 1, 0)).astype(np.int64)
    fraction = (shift - whole).astype(np.float32)[..., None, None]

    # Divide each bin between two new bins
    cube = Cube(capture["transient"])
    *pixels, bins, channels = cube.shape
    memory.require_free("capture", 4 * math.prod(pixels) * (bins + extra) * channels)
    moved = np.zeros((*pixels, bins + extra, channels), np.float32)
    for row, old in cube.rows():
        new = moved[row]
        late = fraction[row]
        for steps in np.unique(whole[row]):
            here = whole[row] == steps
            new[here, steps : steps + bins] += old[here] * (1 - late[here])
            if extra:
                new[here, steps + 1 : steps + 1 + bins] += old[here] * late[here]

    # Replace light and time axis
    start -= float(legs.max())
    attrs = capture.attrs | {"start_opl": start, "counts_first_and_last_legs": 0}
    result = capture.drop_vars(["transient", "opl", TIME], errors="ignore").assign_attrs(attrs)
    result["transient"] = (capture["transient"].dims, moved, capture["transient"].attrs)
    result = result.assign_coords(opl=start + (np.arange(bins + extra) + 0.5) * width)
    result["opl"].attrs.update(capture["opl"].attrs)
    return with_time(result[list(capture.data_vars)])
