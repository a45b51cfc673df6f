"""Photon counts of confocal scans of a plane wall, in NumPy archives, CSV, PTU and SDT files."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

import numpy as np

from ...nlos.captures import COUNTS, make_capture
from ...runtime import checks
from ...runtime.archives import read_array
from ...signals.units import SPEED_OF_LIGHT

if TYPE_CHECKING:
    import xarray as xr

GIVEN = ("wall_size", "bin_width_s", "start_s")


def scan(counts: Any, layout: str, given: dict[str, Any], **known: Any) -> xr.Dataset:
    """Make a confocal capture of counts (rows, columns, bins) on a plane wall.

    Rows run down and columns to the right as one looks from the wall at the hidden scene. The wall
    is at z = 0 with the scene at z > 0, so that columns run along -x and rows along -y. Parameters
    of `load_capture` that are `given` replace those `known` from the file or its documentation.
    """
    known = {"start_s": 0.0} | known | given
    for name in GIVEN:
        checks.require(name, known.get(name), name in known, f"given, as {layout} files lack it")
    size = known["wall_size"]
    sides = size if isinstance(size, tuple | list | np.ndarray) else (size, size)
    sides = checks.items("wall_size", sides, 2, "a number of metres, or two: width and height")
    width, height = (checks.metres("wall_size", side, positive=True) for side in sides)
    bin_width = checks.number("bin_width_s", known["bin_width_s"], unit="s", positive=True)
    start = checks.number("start_s", known["start_s"], unit="s")
    values = checks.real_array("counts", counts, np.float32)
    checks.shape("counts", values, values.ndim == 3 and values.size, "(rows, columns, bins)")
    checks.require("counts", float(values.min()), values.min() >= 0, "0 or more")
    rows, columns = values.shape[:2]
    y, x = (np.linspace(0.5, -0.5, n) if n > 1 else np.zeros(1) for n in (rows, columns))
    points = np.stack([*np.meshgrid(width * x, height * y), np.zeros((rows, columns))], axis=-1)
    return make_capture(
        values,
        mode="confocal",
        start_opl=start * SPEED_OF_LIGHT,
        bin_width_opl=bin_width * SPEED_OF_LIGHT,
        sensor_grid=points,
        sensor_normals=np.broadcast_to([0.0, 0.0, 1.0], points.shape),
        quantity=COUNTS,
        attrs={"layout": layout},
    )


def read_npz(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read `counts` (rows, columns, bins), and parameters of `load_capture` by their names."""
    with ZipFile(file) as archive:
        names = [name for name in GIVEN if f"{name}.npy" in archive.namelist()]
        arrays = {name: read_array(archive, name) for name in ("counts", *names)}
    return scan(arrays.pop("counts"), "NPZ", given, **{k: v.tolist() for k, v in arrays.items()})


def read_csv(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read lines of row, column and counts, below a line "y,x,..." with the bins' starts [s]."""
    first, *lines = file.read_text("utf-8").splitlines(keepends=True)
    if not lines or not lines[-1].endswith("\n"):
        raise ValueError("is cut short; must have lines of counts, and end with a line")
    try:
        starts = np.array(first.split(",")[2:], float)
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
    except ValueError:
        raise ValueError("y,x,...: must head lines of numbers, equally many in each") from None
    steps = np.diff(starts)
    even = steps.size and steps[0] > 0 and np.allclose(steps, steps[0], rtol=1e-3, atol=0)
    checks.require("starts of bins", starts, even, "2 or more, at equal steps [s]")
    checks.shape("counts", table, table.shape[1] == len(starts) + 2, f"{len(starts)} of each pixel")
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    rows, columns = (int(number) for number in table[-1, :2] + 1)
    grid = np.indices((rows, columns)).reshape(2, -1).T
    whole = np.array_equal(table[:, :2], grid)
    checks.require("y,x", table[:, :2], whole, "each pixel of a grid once, from 0,0")
    counts, width = table[:, 2:].reshape(rows, columns, -1), float(steps.mean())
    return scan(counts, "CSV", given, bin_width_s=width, start_s=float(starts[0]))


def read_ptu(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read the histograms of an image in T3 mode, or of one point, of all channels and frames."""
    with file.open("rb") as opened, _package("ptufile").PtuFile(opened) as ptu:
        checks.require("mode", "T2", ptu.is_t3, "T3, with times since the laser's pulse")
        whole = len(ptu.read_records()) == ptu.number_records
        checks.require("records", ptu.number_records, whole, "in the file, which is cut short")
        if ptu.is_image:
            counts = ptu.decode_image(frame=-1, channel=-1, dtype=np.uint32)[0, :, :, 0]
        else:
            counts = ptu.decode_histogram().sum(axis=0)[None, None]
        return scan(counts, "PTU", given, bin_width_s=float(ptu.tcspc_resolution))


def read_sdt(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read the histograms of an image or of one point, the sum of all blocks of one shape."""
    with file.open("rb") as opened, _package("sdtfile").SdtFile(opened) as sdt:
        blocks, times, heads = sdt.data, sdt.times, sdt.block_headers
    ends = [int(h.data_offs) + int(h.block_length) for h in heads if not h.block_type & 0x1000]
    checks.require("blocks", ends, max(ends, default=0) <= file.stat().st_size, "in the file")
    shapes = sorted({block.shape for block in blocks})
    fits = len(shapes) == 1 and 1 <= len(shapes[0]) <= 3 and shapes[0][-1] == len(times[0]) > 1
    checks.require("blocks", shapes, fits, "of one shape, (rows, columns, bins) or (bins,)")
    counts = np.sum(blocks, axis=0, dtype=np.float64)
    counts = counts.reshape(*(1,) * (3 - counts.ndim), *counts.shape)
    return scan(counts, "SDT", given, bin_width_s=float(np.diff(times[0]).mean()))


def _package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ImportError(f"this file needs {name}: pip install 'tofrender[data]'") from None
