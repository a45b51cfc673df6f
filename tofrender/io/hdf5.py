"""Captures in HDF5, in the layout of y-tal and related tools.

The field `H` has the axes (T, Sx, Sy) or (T, Lx, Ly, Sx, Sy): time first, x before y, one value per
bin. Lengths are path lengths in meters. Coordinates of the wall are in world space. Some of these
tools expect the wall at z = 0 and the hidden scene at z > 0.
"""

import json
import math
import os
from pathlib import Path
from typing import Annotated, Any

import h5py
import numpy as np
import xarray as xr

from ..labels import CAPTURE, bins_of
from ..nlos.captures import COUNTS, DEVICES, ON_WALL, as_capture, make_capture, read_capture
from ..nlos.modes import MODES
from ..rendering.cubes import Cube
from ..rendering.dataset import plain_attributes
from ..rendering.labels import TIME, labeled, labels_of
from ..runtime import checks, memory
from ..runtime.atomic import check_file, replacing
from ..runtime.progress import status
from ..signals.color import luminance
from .description import warn_not_finite
from .files import seal_file

_GRIDS = ("grid_xyz", "grid_normals", "grid_format")
_GRID_AXES = {1: "N_3", 2: "X_Y_3"}
_H_AXES = {1: "T_Sx_Sy", 2: "T_Lx_Ly_Sx_Sy", 3: "T_Si", 4: "T_Li_Si"}
_FIELDS = (
    "H",
    "H_format",
    "delta_t",
    "t_start",
    "t_accounts_first_and_last_bounces",
    "scene_info",
)
_NAMES = (
    *_FIELDS,
    *(f"{d}_{what}" for d in DEVICES for what in ("xyz", *_GRIDS)),
)
KINDS = (np.dtype(np.float32), np.dtype(bool))  # Types of a file's arrays
MOST_LINKS = 16  # Largest number of links in a path
_COPIES = 3  # Largest number of copies of H in memory
_OURS = "tofrender"  # Our part of scene_info
_COLORS = "tofrender_colors_"  # Attributes of H by their first bin, (bins, ..., channels)
_IN_FIELDS = ("capture_mode", "start_opl", "bin_width_opl", "counts_first_and_last_legs")


@status("Writing HDF5")
def save_capture(
    capture: Annotated[xr.Dataset, CAPTURE], path: str | os.PathLike, *, overwrite: bool = False
) -> Path:
    """Write a capture as HDF5 in the layout of y-tal, which can read it.

    This layout does not support color. For a capture with three channels, `H` is the luminance
    (ITU-R BT.709). Attributes of `H` contain the channels of all bins in which the channels differ,
    so that `load_capture` restores the Dataset bit by bit. The field `scene_info` contains all
    other attributes. Unknown positions of devices are NaN. The file has a checksum after its end.
    An incomplete file never appears at `path`. See also `load_capture`.

    Args:
        capture: Result of `make_capture` or `capture`, or counts that `sense` measured of it.
        path: A file name that ends in .h5 or .hdf5.
        overwrite: Replace an existing file.

    Raises:
        ValueError: Not a capture of float32 values and whole pixels, or another suffix.
        OSError: `path` may not be replaced or is not writable, or the disk is full.

    Warns:
        UserWarning: A value is NaN or infinite, so that the file cannot be read again.

    Example:
        >>> import tempfile
        >>> wall = np.zeros((4, 4, 3))
        >>> wall[..., 0], wall[..., 1] = np.meshgrid(range(4), range(4))
        >>> grid = {"sensor_grid": wall, "sensor_normals": np.broadcast_to([0, 0, 1], wall.shape)}
        >>> window = {"start_opl": 1.0, "bin_width_opl": 0.01}
        >>> capture = make_capture(np.ones((4, 4, 10)), mode="confocal", **window, **grid)
        >>> from tofrender import load_capture
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     load_capture(save_capture(capture, folder + "/wall.h5")).identical(capture)
        True
    """
    capture = read_capture(as_capture(capture), "capture")
    for name, variable in capture.data_vars.items():
        allowed = "float32, the type in the file; see astype"
        checks.require(f"capture: type of {name}", variable.dtype, variable.dtype in KINDS, allowed)
    fields = _fields(capture)
    cube = Cube(capture["transient"])

    # Is there enough space on the disk?
    needed = sum(np.asarray(value).nbytes for value in fields.values()) + (1 << 16)
    colored = cube.shape[-1] > 1
    needed += 4 * math.prod(cube.shape[:-1]) * (4 if colored else 1)
    target = check_file(path, ".h5", ".hdf5", overwrite=overwrite, needed_bytes=needed)
    warn_not_finite(capture, stacklevel=4)
    with replacing(path, needed_bytes=needed) as temporary:
        # Large attributes need the format of HDF5 1.8
        with h5py.File(temporary, "w", libver="v108" if colored else None) as file:
            _write_light(file, cube)
            for name, value in fields.items():
                file[name] = h5py.Empty("f8") if value is None else value
        seal_file(temporary)
    return target


def _write_light(file: h5py.File, cube: Cube) -> None:
    """Write `H`, some bins at a time, and the channels of colored bins as its attributes."""
    order = (4, 1, 0, 3, 2) if len(cube.shape) == 6 else (2, 1, 0)
    light = file.create_dataset("H", [cube.shape[axis] for axis in order], np.float32)
    for bins, values in cube.frames():
        gray = (values == values[..., :1]).all()
        light[bins] = (values[..., 0] if gray else luminance(values)).transpose(order)
        if not gray:
            light.attrs[f"{_COLORS}{bins.start}"] = values.transpose(*order, -1)


def _fields(capture: xr.Dataset) -> dict[str, Any]:
    exhaustive = capture.attrs["capture_mode"] == "exhaustive"
    bins = bins_of(capture, "capture")
    fields: dict[str, Any] = {
        "H_format": np.array([2 if exhaustive else 1], np.int32),
        "delta_t": bins.bin_width_opl,
        "t_start": bins.start_opl,
        "t_accounts_first_and_last_bounces": bool(capture.attrs["counts_first_and_last_legs"]),
        "volume_format": None,
        "scene_info": _yaml({_OURS: _about(capture)}),
    }
    for device in DEVICES:
        grid, normals, origin = (
            capture[f"{device}_{what}"].values.astype(np.float32)
            for what in ("grid", "normals", "origin")
        )
        fields[f"{device}_xyz"] = origin
        fields[f"{device}_grid_xyz"] = grid.swapaxes(0, 1)
        fields[f"{device}_grid_normals"] = normals.swapaxes(0, 1)
        fields[f"{device}_grid_format"] = np.array([2], np.int32)
    return fields


def _about(capture: xr.Dataset) -> dict[str, Any]:
    """Return the content of a capture that does not fit into a field of the layout."""
    # Attributes, labels of the pixels and names of the channels
    attrs = {k: v for k, v in plain_attributes(capture).items() if k not in _IN_FIELDS}
    pixels = {str(a): capture[a].values.tolist() for a in capture.dims if str(a)[-1] in "xy"}
    _pixels(pixels, capture)
    about = {"mode": capture.attrs["capture_mode"], "attrs": attrs, "pixels": pixels}
    about["channel"] = [str(name) for name in capture["channel"].values]

    # Labels of variables, except the default labels of captures
    about["labels"] = {}
    for name, variable in capture.drop_vars(TIME, errors="ignore").variables.items():
        known = labels_of(str(name), capture.attrs)
        attrs = plain_attributes(variable)
        own = {
            k: v for k, v in attrs.items() if isinstance(v, str | int | float) and known.get(k) != v
        }
        about["labels"] |= {str(name): own} if own else {}

    # Pixels on the wall, as lengths of runs in reading order: off, on, off, ...
    if ON_WALL in capture:
        row = np.concatenate([[False], capture[ON_WALL].values.ravel()])
        changes = np.flatnonzero(np.diff(row))
        about[ON_WALL] = np.diff(changes, prepend=0, append=len(row) - 1).tolist()
    return about


def _yaml(value: Any) -> str:
    """Write JSON with the same meaning in YAML 1.1, where 1e-05 is text and 1.0e-05 a number."""
    if isinstance(value, dict):
        items = (f"{json.dumps(str(k), ensure_ascii=False)}: {_yaml(v)}" for k, v in value.items())
        return "{" + ",\n".join(items) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_yaml, value)) + "]"
    text = json.dumps(value, ensure_ascii=False)
    return text.replace("e", ".0e") if isinstance(value, float) and "." not in text else text


def read_ytal(file: h5py.File) -> xr.Dataset:
    """Read a capture in the layout of the package y-tal, which `save_capture` also writes.

    Lists of points (the formats T_Si, T_Li_Si, N_3) become one row. Missing normals are +z, the
    normal of y-tal's wall, if all points have the same z. The `scene_info` of other programs
    becomes the attribute `scene_info`, as text. Integers in `H` are photon counts.
    """
    return restore(_read(file))


def _read(file: h5py.File) -> dict[str, Any]:
    """Read the fields. Empty fields are None."""
    names = set(file)
    items = {name: field_of(file, name) for name in _NAMES if name in names}
    light = items.get("H")
    attrs = {} if light is None else light.attrs
    colored = [name for name in attrs if name.startswith(_COLORS)]

    # Does the content fit into memory?
    full = [item for item in items.values() if item is not None]
    if full:
        largest = max(full, key=lambda item: item.nbytes)
        size = sum(item.nbytes for item in full)
        what = f"{str(largest.name).strip('/')} with shape {largest.shape}"
        memory.require_free(what, _COPIES * size * (4 if colored else 1))

    # Read it
    found = {name: None if item is None else item[()] for name, item in items.items()}
    colors = {name.removeprefix(_COLORS): attrs[name] for name in colored}
    return found | {_COLORS: colors}


def field_of(file: h5py.File, name: str) -> h5py.Dataset | None:
    """Open a field. Return None for a missing or empty field.

    HDF5 would follow links to other files, also in the middle of a path, and wait for pipes.
    Therefore each step of a path is resolved here, and only links within the file are followed. A
    field in another file is a ValueError.
    """
    item: Any = file
    steps = [name]
    followed = 0
    while steps:
        step = steps.pop(0)
        if not isinstance(item, h5py.Group):
            return None
        try:
            link = item.get(step, getlink=True)
        except (TypeError, RuntimeError):  # A type of link that h5py does not know
            raise ValueError(f"{name}: has an unknown link; must be in this file") from None

        # Follow a link within the file, or open the field
        if isinstance(link, h5py.SoftLink):
            followed += 1
            if followed > MOST_LINKS:
                raise ValueError(f"{name}: is a loop of links; must be a field")
            if link.path.startswith("/"):
                item = file
            steps = [part for part in link.path.split("/") if part not in ("", ".")] + steps
        elif isinstance(link, h5py.ExternalLink):
            raise ValueError(f"{name}: is in another file; must be in this one")
        elif link is None:
            return None
        else:
            item = _opened(item, step, name)
    if not isinstance(item, h5py.Dataset) or item.shape is None:
        return None
    return item


def _opened(group: h5py.Group, step: str, name: str) -> Any:
    """Open the target of a hard link. Its values must be in the same file."""
    try:
        item = group[step]
        is_elsewhere = isinstance(item, h5py.Dataset) and (item.external or item.is_virtual)
    except Exception as error:
        raise ValueError(f"{name}: cannot be read ({error}); must be a field") from None
    if is_elsewhere:
        raise ValueError(f"{name}: is in another file; must be in this one")
    return item


def restore(fields: dict[str, Any]) -> xr.Dataset:
    """Make a capture of the fields of y-tal."""
    # Bring H to the axes T, Lx, Ly, Sx, Sy
    axes = _code(fields, "H_format", _H_AXES)
    transient = _array(fields, "H")
    valid = transient.ndim == len(axes.split("_"))
    checks.shape("H", transient, valid, f"{axes}, as in H_format")
    if axes == "T_Si":
        transient = transient[:, :, None]
    elif axes == "T_Li_Si":
        transient = transient[:, :, None, :, None]

    # Which mode is it, and which attributes does it have?
    about, foreign = _scene_info(fields.get("scene_info"))
    grids = {name: _grid(fields, name) for name in DEVICES}
    mode = "exhaustive" if transient.ndim == 5 else _mode(grids, about.get("mode"))
    channels = about.get("channel") or ["L"]
    counts = {} if fields["H"].dtype.kind == "f" else {"quantity": COUNTS}
    attrs = foreign | counts | about.get("attrs", {})
    are_names = isinstance(channels, list) and all(isinstance(name, str) for name in channels)
    checks.require("channel", channels, are_names, "a list of names")

    # Make the capture
    given = {"sensor_grid": grids["sensor"][0], "sensor_normals": grids["sensor"][1]}
    if mode != "confocal":
        given |= {"laser_grid": grids["laser"][0], "laser_normals": grids["laser"][1]}
    capture = make_capture(
        _in_color(transient, fields.get(_COLORS, {}), channels),
        mode=mode,
        start_opl=_number(fields, "t_start"),
        bin_width_opl=_number(fields, "delta_t"),
        sensor_origin=_origin(fields, "sensor_xyz"),
        laser_origin=_origin(fields, "laser_xyz"),
        counts_first_and_last_legs=_truth(fields, "t_accounts_first_and_last_bounces"),
        on_wall=_runs(about.get(ON_WALL), given["sensor_grid"].shape[:2]),
        quantity=str(attrs.get("quantity", "radiance per bin")),
        attrs=attrs,
        **given,
    )

    # Restore the labels of the pixels, channels and variables
    capture = capture.assign_coords(_pixels(about.get("pixels", {}), capture))
    capture = labeled(capture.assign_coords(channel=channels))
    for name, attrs in about.get("labels", {}).items():
        if name in capture.variables:
            capture[name].attrs.update(checks.mapping(f"labels: {name}", attrs))
    return capture


def _in_color(light: np.ndarray, colors: dict[str, Any], channels: list[str]) -> np.ndarray:
    """Return light (..., bins, channels), from `H` and from the channels of colored bins."""
    order = (2, 1, 4, 3, 0) if light.ndim == 5 else (2, 1, 0)
    values = np.repeat(light.transpose(order)[..., None], len(channels), axis=-1)
    for first, part in colors.items():
        bins = values[..., int(first) : int(first) + len(part), :]
        fits = np.ndim(part) == values.ndim and part.transpose(*order, -1).shape == bins.shape
        checks.shape("H: colors", part, fits, str(bins.shape))
        bins[...] = part.transpose(*order, -1)
    return values


def _pixels(given: Any, capture: xr.Dataset) -> dict[str, list[int]]:
    """Check the labels of the pixels: an integer for each entry of an axis."""
    for axis, numbers in given.items():
        size = capture.sizes.get(axis, 0) if axis[-1] in "xy" else 0
        valid = isinstance(numbers, list) and len(numbers) == size > 0
        valid = valid and all(type(each) is int and abs(each) < 1 << 31 for each in numbers)
        checks.require(f"pixels: {axis}", numbers, valid, f"{size} integers")
    return given


def _runs(runs: list[int] | None, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return the mask of the pixels on the wall. The runs are alternately off and on the wall."""
    if runs is None:
        return None
    are_counts = isinstance(runs, list) and all(isinstance(n, int) and n >= 0 for n in runs)
    size = math.prod(shape)
    checks.require(ON_WALL, runs, are_counts and sum(runs) == size, f"runs of {size} pixels")
    return np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(shape)


def _mode(grids: dict[str, tuple[np.ndarray, np.ndarray]], stated: Any) -> str:
    """Return the mode of a capture with these grids, "single" or "confocal".

    A grid of one point fits both modes. Then the stated mode is returned.
    """
    laser = grids["laser"][0]
    sensor = grids["sensor"][0]
    modes = ["confocal"] * (laser.shape == sensor.shape and np.allclose(laser, sensor))
    modes += ["single"] * (laser.shape[:2] == (1, 1))
    checks.shape("laser_grid_xyz", laser, modes, "one point or equal sensor_grid_xyz")
    return stated if stated in modes and stated in MODES else modes[0]


def _scene_info(text: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return our part of `scene_info`, and an attribute with the text of another program."""
    text = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text or "")
    try:
        ours = json.loads(text)[_OURS]
    except (KeyError, TypeError, ValueError, RecursionError):
        return {}, {"scene_info": text} if text else {}
    ours = checks.mapping("scene_info", ours)
    about = {
        name: checks.mapping(f"scene_info: {name}", ours.get(name))
        for name in ("attrs", "pixels", "labels")
    }
    return about | {name: ours.get(name) for name in ("mode", "channel", ON_WALL)}, {}


def _code(fields: dict[str, Any], name: str, known: dict[int, str]) -> str:
    """Look up a field that must be a known code."""
    found = _number(fields, name)
    if found not in known:
        allowed = ", ".join(f"{key} ({axes})" for key, axes in known.items())
        raise ValueError(f"{name} = {found:g}: must be one of {allowed}")
    return known[int(found)]


def _field(fields: dict[str, Any], name: str) -> Any:
    if fields.get(name) is None:
        problem = "missing" if name not in fields else "empty"
        raise ValueError(f"the field {name} is {problem}; files of y-tal must contain it")
    return fields[name]


def _array(fields: dict[str, Any], name: str) -> np.ndarray:
    """Return a field as float32. The field must contain real numbers."""
    return checks.real_array(name, _field(fields, name), np.float32)


def _number(fields: dict[str, Any], name: str) -> float:
    """Return a field with one number."""
    value = np.asarray(_field(fields, name))
    checks.shape(name, value, value.size == 1 and value.dtype.kind in "fiub", "one number")
    return float(value.reshape(-1)[0])


def _truth(fields: dict[str, Any], name: str) -> bool:
    """Return a field with 0 or 1 as a bool."""
    value = _number(fields, name)
    return checks.require(name, value, value in (0, 1), "0 or 1") == 1


def _origin(fields: dict[str, Any], name: str) -> np.ndarray | None:
    """Return a field with a point (3,) [m], or None if the field is missing."""
    if fields.get(name) is None:
        return None
    values = _array(fields, name)
    checks.shape(name, values, values.size == 3, "(3,)")
    return values.reshape(3)


def _grid(fields: dict[str, Any], device: str) -> tuple[np.ndarray, np.ndarray]:
    """Return points and normals, (rows, columns, 3), of the sensor or the laser."""
    axes = _code(fields, f"{device}_grid_format", _GRID_AXES)
    name = f"{device}_grid_normals"
    points = _array(fields, f"{device}_grid_xyz")
    normals = _array(fields, name) if fields.get(name) is not None else _default_normals(points)
    for what, values in ((f"{device}_grid_xyz", points), (name, normals)):
        valid = values.ndim == len(axes.split("_")) and values.shape[-1] == 3
        checks.shape(what, values, valid, axes)
        if not np.isfinite(values).all():
            raise ValueError(f"{what}: must contain finite numbers only")

    # A list of points is a column in this layout
    if axes == "N_3":
        points = points[:, None]
        normals = normals[:, None]
    return points.swapaxes(0, 1), normals.swapaxes(0, 1)


def _default_normals(points: np.ndarray) -> np.ndarray:
    depth = points[..., 2]
    if np.ptp(depth) > 1e-4:
        raise ValueError("normals are missing; they must exist if the points have several z")
    return np.broadcast_to(np.array([0, 0, 1], np.float32), points.shape)
