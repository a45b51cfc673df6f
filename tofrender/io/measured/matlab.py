"""MATLAB files: confocal captures of the light-cone transform and of f-k migration, photon times.

SciPy reads files of versions 5 to 7, h5py those of 7.3, which are HDF5. Neither runs a file's code.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from scipy.io import loadmat, whosmat

from ...runtime import checks, memory
from ..hdf5 import field_of
from .photons import scan

if TYPE_CHECKING:
    import xarray as xr


def names_of(file: Path) -> set[str]:
    """Names of all variables, and "{}" if one is an array of cells."""
    if h5py.is_hdf5(file):
        with h5py.File(file) as opened:
            return set(opened)
    found = whosmat(str(file))
    return {str(name) for name, *_ in found} | {"{}" for *_, kind in found if kind == "cell"}


def variable(file: Path, name: str, axes: int) -> np.ndarray:
    """Read real numbers with a number of axes, in MATLAB's order."""
    if h5py.is_hdf5(file):
        with h5py.File(file) as opened:
            item = field_of(opened, name)
            memory.require_free(name, 2 * (item.nbytes if item else 0))
            values = np.asarray(item[()] if item else 0.0).T
    else:
        shape = next(shape for found, shape, _ in whosmat(str(file)) if found == name)
        memory.require_free(name, 16 * math.prod(shape))
        values = loadmat(str(file), variable_names=[name])[name]
    checks.shape(name, values, values.ndim == axes and values.size, f"of {axes} axes")
    return checks.real_array(name, values)


def read_lct(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read `rect_data` (x, y, bins), x mirrored, and `width`, half the side of the wall [m].

    Bins are of 4 ps from when light meets the wall, says cnlos_reconstruction.m of M. O'Toole et
    al., Confocal non-line-of-sight imaging based on the light-cone transform, Nature 555 (2018).
    """
    counts = variable(file, "rect_data", 3).transpose(1, 0, 2)[:, ::-1]
    half = variable(file, "width", 2)
    checks.shape("width", half, half.size == 1, "one number")
    return scan(counts, "LCT", given, wall_size=2 * half.item(), bin_width_s=4e-12)


def read_fk(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read `meas` (rows, columns, bins), and `tofgrid`, when light meets the wall [ps].

    `tofgrid` is in the same file or in tof.mat beside it; with `start_s`, none is used. Pixels move
    by whole bins, as in cnlos_reconstruction.m of D. Lindell et al., Wave-based non-line-of-sight
    imaging using fast f-k migration, ACM ToG 38 (2019), but bins that one lacks are left out.
    Its README has 32 ps and a wall of 2 m x 2 m.
    """
    counts = variable(file, "meas", 3)
    known = {"wall_size": 2.0, "bin_width_s": 32e-12}
    if "start_s" in given:
        return scan(counts, "f-k", given, **known)
    files = [each for each in (file, file.with_name("tof.mat")) if each.is_file()]
    beside = next((each for each in files if "tofgrid" in names_of(each)), None)
    if beside is None:
        raise ValueError("lacks tofgrid; must be here or in tof.mat beside it, or start_s be given")
    delay = checks.finite("tofgrid", variable(beside, "tofgrid", 2))
    checks.shape("tofgrid", delay, delay.shape == counts.shape[:2], f"{counts.shape[:2]}")
    width = checks.number("bin_width_s", (known | given)["bin_width_s"], unit="s", positive=True)
    first = np.floor(delay * 1e-12 / width).astype(np.int64)
    bins = counts.shape[2] - first.max()
    checks.require("tofgrid", delay, first.min() >= 0 and bins > 0, "within the bins, in ps")
    moved = np.take_along_axis(counts, first[..., None] + np.arange(bins), axis=2)
    return scan(moved, "f-k", given, **known)


def read_cells(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read cells (rows, columns), each with the bins of a pixel's photons: D if there are several.

    As in data of D. Shin et al., Photon-efficient imaging with a single-photon camera, Nature
    Communications 7 (2016), and of their other papers.
    """
    cells = [str(name) for name, _, kind in whosmat(str(file)) if kind == "cell"]
    name = "D" if "D" in cells else cells[0]
    checks.require("cells", cells, name == "D" or len(cells) == 1, "one array, or one called D")
    held = loadmat(str(file), variable_names=[name])[name]
    checks.shape(name, held, held.ndim == 2 and held.size, "(rows, columns)")
    times = [checks.real_array(f"{name}: a cell", each).ravel() for each in held.ravel()]
    at, pixel = np.concatenate(times), np.repeat(np.arange(held.size), [t.size for t in times])
    valid = at.size and at.min() >= 0 and at.max() < checks.MAX_BINS and (at % 1 == 0).all()
    checks.require(name, at, valid, f"numbers of bins, integers below {checks.MAX_BINS}")
    bins = int(at.max()) + 1
    memory.require_free(name, 12 * held.size * bins)
    counts = np.bincount(pixel * bins + at.astype(np.int64), minlength=held.size * bins)
    return scan(counts.reshape(*held.shape, bins), "photon times", given)
