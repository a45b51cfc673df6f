"""HDF5 files of the Zaragoza NLOS synthetic dataset (Z-NLOS), rewritten in the fields of y-tal."""

import h5py
import numpy as np
import xarray as xr

from ..runtime import checks, memory
from .hdf5 import field_of, restore

DEVICES = {"sensor": "camera", "laser": "laser"}


def read_znlos(file: h5py.File) -> xr.Dataset:
    """Read a file of Z-NLOS, by the documentation of its C++ loader.

    `data` is (laser x, laser y, sensor x, sensor y, bounces, bins), confocal without the laser's
    axes, with or without a last axis of colours, which are added. Column-major files have reversed
    axes in all arrays, which the grids show, (3, y, x). Bounces from the third on are added; it is
    at attribute `third_bounce` of `data`, else at 1. `deltaT` and `t0` are metres of path, with
    laser to wall and wall to sensor. One laser point makes a single capture.
    """
    light = _array(file, "data")
    grids = {
        f"{device}_grid_{kind}": _array(file, f"{name}Grid{what}")
        for device, name in DEVICES.items()
        for kind, what in (("xyz", "Positions"), ("normals", "Normals"))
    }
    if all(each.ndim == 3 and each.shape[0] == 3 for each in grids.values()):
        light, grids = light.T, {name: each.T for name, each in grids.items()}
    points = grids["sensor_grid_xyz"].shape[:2]
    if not _array(file, "isConfocal").all():
        points = grids["laser_grid_xyz"].shape[:2] + points
    axes, bins = len(points), int(_array(file, "t").flat[0])
    fits = light.ndim - axes in (2, 3) and light.shape[:axes] == points
    fits = fits and light.shape[axes + 1] == bins
    checks.shape("data", light, fits, f"{points}, bounces, {bins} bins, as grids and t have it")
    data = field_of(file, "data")
    third = int(data.attrs.get("third_bounce", 1)) if data is not None else 1
    checks.require("third_bounce", third, 0 <= third < light.shape[axes], "one of the bounces")
    light = light.reshape(*light.shape[: axes + 2], -1).sum(axis=-1)[..., third:, :].sum(axis=-2)
    light = light[0, 0] if points[:-2] == (1, 1) else light
    formats = {f"{device}_grid_format": 2 for device in DEVICES}
    formats |= {"H_format": light.ndim // 2, "t_accounts_first_and_last_bounces": 1}
    origins = {f"{device}_xyz": _array(file, f"{n}Position") for device, n in DEVICES.items()}
    window = {"t_start": _array(file, "t0"), "delta_t": _array(file, "deltaT")}
    return restore(grids | origins | window | formats | {"H": np.moveaxis(light, -1, 0)})


def _array(file: h5py.File, name: str) -> np.ndarray:
    item = field_of(file, name)
    if item is None or not item.size:
        raise ValueError(f"has nothing in the field {name}; must have it")
    memory.require_free(name, 3 * item.nbytes)
    return checks.real_array(name, item[()])
