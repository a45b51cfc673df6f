"""`load_capture`: captures in many layouts, which are recognized by the content of files."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import h5py
import xarray as xr

from ..rendering.dataset import require_finite
from ..runtime import checks
from ..runtime.progress import status
from . import measured_captures, synthetic
from .files import reading
from .hdf5 import read_ytal

LAYOUTS: tuple[tuple[str, str, Callable[..., xr.Dataset]], ...] = (
    # container, variables, reader
    ("HDF5", "H", read_ytal),
    ("HDF5", "data deltaT", synthetic.read_znlos),
    ("MATLAB", "rect_data width", measured_captures.read_lct),
    ("MATLAB", "meas", measured_captures.read_fk),
    ("MATLAB", "cells", measured_captures.read_cells),
    ("NPZ", "counts", measured_captures.read_npz),
    ("CSV", "", measured_captures.read_csv),
    ("PTU", "", measured_captures.read_ptu),
    ("SDT", "", measured_captures.read_sdt),
)
"""Formats of `load_capture`: the first one whose variables a file has is read."""


@status("Reading a capture")
def load_capture(
    path: str | os.PathLike,
    *,
    wall_size: float | tuple[float, float] | None = None,
    bin_width_s: float | None = None,
    start_s: float | None = None,
) -> xr.Dataset:
    """Read a capture that `save_capture` wrote, or one of other programs and measurements.

    The layout is recognized by the content of the file, not by its name. No file can run code. All
    layouts except the first two contain photon counts of confocal scans. Their wall is at z = 0,
    the hidden scene is at z > 0, and seen from the wall, rows run downwards and columns to the
    right. See also `save_capture`.

    | layout | content |
    |---|---|
    | HDF5 of y-tal | `H`; integers are photon counts |
    | HDF5 of Z-NLOS | `data`, `deltaT`; bounces from the third on are added |
    | MATLAB, light-cone transform | `rect_data` (x, y, bins), `width`: half the wall's; 4 ps |
    | MATLAB, f-k migration | `meas` (rows, columns, bins), `tofgrid` there or in tof.mat; 32 ps |
    | MATLAB, photon times | cells (rows, columns) with numbers of bins |
    | NPZ | `counts` (rows, columns, bins), and parameters of this function |
    | CSV | a line "y,x,0,4e-12,..." with the bins' starts [s], a line of counts for each pixel |
    | PTU, SDT | PicoQuant, Becker & Hickl; needs `pip install 'tofrender[data]'` |

    Args:
        path: A file.
        wall_size: Side of the scanned wall [m], or (width, height), from the first to the last
            point. By default the size in the file or of its layout, 2 m for f-k migration.
        bin_width_s: Width of a bin [s]. By default the width in the file or of its layout.
        start_s: Start of the first bin [s] after light has met the wall. By default the start in
            the file, otherwise 0.

    Returns:
        A capture, as described at `make_capture`. It has one channel, except in files of
        `save_capture` with three channels.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file has another layout or is cut short, fields are missing, have wrong
            shapes or are not finite, or a parameter is missing or not for this layout.
        ImportError: The package that reads the file is missing.
        MemoryError: The capture does not fit into memory.

    Example:
        >>> import numpy as np, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     np.savez(folder + "/a.npz", counts=np.ones((4, 4, 8)), bin_width_s=4e-12)
        ...     load_capture(folder + "/a.npz", wall_size=0.7).attrs["quantity"]
        'photon counts per bin'
    """
    options = {"wall_size": wall_size, "bin_width_s": bin_width_s, "start_s": start_s}
    given = {name: value for name, value in options.items() if value is not None}
    with reading(path, "a file of a capture") as found:
        container, read = _layout_of(found)
        if container == "HDF5":
            for name, value in given.items():
                checks.require(name, value, False, "None, as the file states it")
            with h5py.File(found) as opened:
                capture = read(opened)
        else:
            capture = read(found, given)
        require_finite(capture)
    return capture


def _layout_of(file: Path) -> tuple[str, Callable[..., Any]]:
    """Recognize container and reader by the first bytes of a file and names of its variables."""
    names = set()
    held = ["HDF5"]
    with file.open("rb") as opened:
        head = opened.read(1024)
    if head.startswith(b"MATLAB"):
        # Version 7.3 of MATLAB files is HDF5
        held = ["MATLAB", "HDF5"]
        names = measured_captures.matlab_names(file)
    elif h5py.is_hdf5(file):
        with h5py.File(file) as opened:
            names = set(opened)
    elif head.startswith(b"PK\x03\x04"):
        with ZipFile(file) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
        held = ["NPZ"]
    else:
        marks = {"PTU": b"PQTTTR", "SDT": b"*IDENTIFICATION", "CSV": b"y,x,"}
        held = [
            name for name, mark in marks.items() if mark in head[: 1024 if name == "SDT" else 8]
        ]

    # Choose the first layout with these variables
    known = [row for row in LAYOUTS if row[0] in held]
    for container, variables, read in known:
        if names.issuperset(variables.split()):
            return container, read
    allowed = " or ".join(f"{each} {kind}".strip() for kind, each, _ in known or LAYOUTS)
    raise ValueError(f"the layout of the file is not supported; the file must contain {allowed}")
