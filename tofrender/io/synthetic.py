"""HDF5 files of the Zaragoza NLOS synthetic dataset (Z-NLOS), converted to fields of y-tal."""

import h5py
import numpy as np
import xarray as xr

from ..runtime import checks, memory
from .hdf5 import field_of, restore

DEVICES = {"sensor": "camera", "laser": "laser"}


def read_znlos(file: h5py.File) -> xr.Dataset:
    """Read a file of the data set Z-NLOS, as the documentation of its C++ loader describes.

    `data` has the axes (laser x, laser y, sensor x, sensor y, bounces, bins). Confocal data do not
    have the axes of the laser. A last axis of colors is optional, and colors are added.
    Column-major files have reversed axes in all arrays. They are recognized by the shape (3, y, x)
    of the grids. All bounces from the third are added. The attribute `third_bounce` of `data` is
    the index of the third bounce, by default 1. `deltaT` and `t0` are path lengths in meters, which
    include the distances from laser to wall and from wall to sensor. One laser point makes a single
    capture.
    """
    # Read light and grids, in the order of rows
    light = _array(file, "data")
    grids = {
        f"{device}_grid_{kind}": _array(file, f"{name}Grid{what}")
        for device, name in DEVICES.items()
        for kind, what in (("xyz", "Positions"), ("normals", "Normals"))
    }
    if all(each.ndim == 3 and each.shape[0] == 3 for each in grids.values()):
        light = light.T
        grids = {name: each.T for name, each in grids.items()}

    # Do their shapes fit?
    points = grids["sensor_grid_xyz"].shape[:2]
    if not _array(file, "isConfocal").all():
        points = grids["laser_grid_xyz"].shape[:2] + points
    axes = len(points)
    bins = int(_array(file, "t").flat[0])
    fits = light.ndim - axes in (2, 3) and light.shape[:axes] == points
    fits = fits and light.shape[axes + 1] == bins
    checks.shape("data", light, fits, f"{points}, bounces, {bins} bins, as in grids and t")

    # Add colors, and the bounces from the third
    data = field_of(file, "data")
    third = int(data.attrs.get("third_bounce", 1)) if data is not None else 1
    checks.require("third_bounce", third, 0 <= third < light.shape[axes], "one of the bounces")
    light = light.reshape(*light.shape[: axes + 2], -1).sum(axis=-1)[..., third:, :].sum(axis=-2)
    light = light[0, 0] if points[:-2] == (1, 1) else light

    # Convert the fields to fields of y-tal
    formats = {f"{device}_grid_format": 2 for device in DEVICES}
    formats |= {"H_format": light.ndim // 2, "t_accounts_first_and_last_bounces": 1}
    origins = {f"{device}_xyz": _array(file, f"{n}Position") for device, n in DEVICES.items()}
    window = {"t_start": _array(file, "t0"), "delta_t": _array(file, "deltaT")}
    return restore(grids | origins | window | formats | {"H": np.moveaxis(light, -1, 0)})


def _array(file: h5py.File, name: str) -> np.ndarray:
    item = field_of(file, name)
    if item is None or not item.size:
        raise ValueError(f"the field {name} is missing or empty; it must contain numbers")
    memory.require_free(name, 3 * item.nbytes)
    return checks.real_array(name, item[()])
