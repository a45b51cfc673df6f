"""HDF5 files of synthetic NLOS data that y-tal reads besides its own: Z-NLOS and NLOS-DIRAC."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from ...nlos.captures import make_capture
from ...runtime import checks, memory
from ..hdf5 import field_of

if TYPE_CHECKING:
    import xarray as xr

DEVICES = {"sensor": "camera", "laser": "laser"}


def read_znlos(file: h5py.File) -> xr.Dataset:
    """Read a file of the Zaragoza NLOS synthetic dataset, by its C++ loader's documentation.

    `data` is (laser x, laser y, sensor x, sensor y, bounces, bins), confocal without the laser's
    axes, with or without a last axis of colours, which are added. Column-major files have reversed
    axes in all arrays, which the grids show, (3, y, x). Bounces from the third on are added; it is
    at attribute `third_bounce` of `data`, else at 1. `deltaT` and `t0` are metres of path, with
    laser to wall and wall to sensor. One laser point makes a single capture.
    """
    light = _array(file, "data")
    grids = {
        f"{device}_{kind}": _array(file, f"{name}Grid{what}")
        for device, name in DEVICES.items()
        for kind, what in (("grid", "Positions"), ("normals", "Normals"))
    }
    if all(each.ndim == 3 and each.shape[0] == 3 for each in grids.values()):
        light, grids = light.T, {name: each.T for name, each in grids.items()}
    confocal = _number(file, "isConfocal") != 0
    points = (() if confocal else grids["laser_grid"].shape[:2]) + grids["sensor_grid"].shape[:2]
    axes, bins = len(points), int(_number(file, "t"))
    fits = light.ndim - axes in (2, 3) and light.shape[:axes] == points
    fits = fits and light.shape[axes + 1] == bins
    checks.shape("data", light, fits, f"{points}, bounces, {bins} bins, as grids and t have it")
    third = int(file["data"].attrs.get("third_bounce", 1))
    checks.require("third_bounce", third, 0 <= third < light.shape[axes], "one of the bounces")
    light = light.reshape(*light.shape[: axes + 2], -1).sum(axis=-1)[..., third:, :].sum(axis=-2)
    light = light.transpose((1, 0, 2) if confocal else (1, 0, 3, 2, 4))
    mode = "confocal" if confocal else "exhaustive"
    if light.shape[:-3] == (1, 1):
        mode, light = "single", light[0, 0]
    used = {n: each.swapaxes(0, 1) for n, each in grids.items() if n[0] == "s" or not confocal}
    origins = {f"{d}_origin": _array(file, f"{n}Position").ravel() for d, n in DEVICES.items()}
    start, width = _number(file, "t0"), _number(file, "deltaT")
    return _capture(light, mode, "Z-NLOS", start, width, True, **used, **origins)


def read_dirac(file: h5py.File) -> xr.Dataset:
    """Read y-tal's older layout: `data_t` (bins, x, y), `xg`, `yg`, and `da`, the bins' starts [m].

    With `offset_laser` 0, lengths count the laser's way to the wall, whose position is missing.
    """
    light, starts = _array(file, "data_t"), _array(file, "da").ravel()
    x, y = _array(file, "xg"), _array(file, "yg")
    checks.shape(
        "data_t", light, light.shape == (starts.size, *x.shape), "as da, xg and yg have it"
    )
    steps, offset = np.diff(starts), float(np.linalg.norm(_array(file, "offset_laser")))
    even = steps.size and np.allclose(steps, steps[0], rtol=1e-3, atol=0)
    checks.require("da", starts, even, "2 or more, at equal steps")
    checks.require("offset_laser", offset, offset > 0, "above 0: lengths from wall to wall")
    grid = np.stack([x, y, np.zeros(x.shape)], axis=-1).swapaxes(0, 1)
    used = {"sensor_grid": grid, "sensor_normals": np.broadcast_to([0.0, 0.0, 1.0], grid.shape)}
    return _capture(light.T, "confocal", "NLOS-DIRAC", 0.0, float(steps[0]), False, **used)


def _capture(
    light: np.ndarray, mode: str, layout: str, start: float, width: float, legs: bool, **used: Any
) -> xr.Dataset:
    window: dict[str, Any] = {"start_opl": start, "bin_width_opl": width, "mode": mode}
    attrs = {"layout": layout}
    return make_capture(light, counts_first_and_last_legs=legs, attrs=attrs, **window, **used)


def _array(file: h5py.File, name: str) -> np.ndarray:
    item = field_of(file, name) if name in file else None
    if item is None:
        raise ValueError(f"lacks the field {name}; must have it")
    memory.require_free(name, 3 * item.nbytes)
    return checks.real_array(name, item[()])


def _number(file: h5py.File, name: str) -> float:
    value = _array(file, name)
    checks.shape(name, value, value.size == 1, "one number")
    return float(value.item())
