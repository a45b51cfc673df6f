"""Photon counts of confocal scans of a plane wall: MATLAB files, NumPy archives, CSV, PTU, SDT.

The module `matlab` reads files of MATLAB 5 to 7. h5py reads files of MATLAB 7.3, which are HDF5.
No reader runs code of a file. The sizes in a file are checked before memory is allocated.
"""

import importlib
import math
import struct
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import ZipFile

import h5py
import numpy as np
import xarray as xr

from ..nlos.captures import COUNTS, make_capture
from ..runtime import checks, memory
from ..runtime.archives import read_array
from ..signals.units import SPEED_OF_LIGHT
from . import matlab
from .hdf5 import field_of
from .matlab import ZLIB_RATIO

LONGEST_BIN_S = 1e-7
"""Largest width of a bin [s], 30 m of path. A larger number is in picoseconds or nanoseconds."""

GIVEN = ("wall_size", "bin_width_s", "start_s")

PTU_MARKERS = ("ImgHdr_LineStart", "ImgHdr_LineStop", "ImgHdr_Frame")
MOST_MARKERS = 32
RECORD_BYTES = 4  # Bytes of a photon in a PTU file
COUNT_COPIES = 12  # Bytes of a bin while a PTU file is read: uint32, and float32 twice
BYTES_PER_PIXEL = 200  # Bytes of the wall for each pixel while a capture is made

SDT_HEAD = "<hihiHihIihhHIHH"  # bhfile_header
SDT_BLOCK = "<BBIIHhII"  # BHFileBlockHeader
SDT_OLD_BLOCK = "<hiiHhII"
SDT_NEW_BLOCKS = 15  # First revision with blocks of SDT_BLOCK
SDT_MANY_BLOCKS = 0x7FFF  # Then another field contains the number of blocks
SDT_COMPRESSED = 0x1000
SDT_COPIES = 12  # Bytes in memory for a byte of a block: its values, and sums as float64


def scan(counts: Any, given: dict[str, Any], **known: Any) -> xr.Dataset:
    """Make a confocal capture of counts (rows, columns, bins) on a plane wall.

    Seen from the wall, rows run down and columns to the right. The wall is at z = 0, and the hidden
    scene is at z > 0, so that columns run along -x and rows along -y. The parameters `given` by the
    user of `load_capture` replace the parameters `known` from the file or its documentation.
    """
    # Check the size of the wall and the bins
    known = {"start_s": 0.0} | known | given
    for name in GIVEN:
        allowed = f"given by `{name}`, as the file does not state it"
        checks.require(name, known.get(name), name in known, allowed)
    size = known["wall_size"]
    sides = size if isinstance(size, tuple | list | np.ndarray) else (size, size)
    sides = checks.items("wall_size", sides, 2, "a number of meters, or two: width and height")
    width, height = (checks.meters("wall_size", side, positive=True) for side in sides)
    bin_width = checks.number("bin_width_s", known["bin_width_s"], unit="s", positive=True)
    if bin_width > LONGEST_BIN_S:
        raise ValueError(
            f"bin_width_s = {bin_width:g}: a bin of {bin_width * SPEED_OF_LIGHT:.3g} m is too wide "
            "for a capture; give the width in seconds, for example 4e-12"
        )
    start = checks.number("start_s", known["start_s"], unit="s")

    # Check the counts
    values = checks.real_array("counts", counts, np.float32)
    checks.shape("counts", values, values.ndim == 3 and values.size, "(rows, columns, bins)")
    checks.require("counts", float(values.min()), values.min() >= 0, "0 or more")

    # Place the points on the wall
    y, x = (np.linspace(0.5, -0.5, n) if n > 1 else np.zeros(1) for n in values.shape[:2])
    points = np.stack([*np.meshgrid(width * x, height * y), np.zeros(values.shape[:2])], axis=-1)
    wall: Any = {"sensor_normals": np.broadcast_to([0.0, 0.0, 1.0], points.shape)}
    window = {"start_opl": start * SPEED_OF_LIGHT, "bin_width_opl": bin_width * SPEED_OF_LIGHT}
    wall |= window | {"sensor_grid": points, "quantity": COUNTS}
    return make_capture(values, mode="confocal", **wall)


def matlab_names(file: Path) -> set[str]:
    """Return the names of all variables, and "cells" if a variable is an array of cells."""
    if h5py.is_hdf5(file):
        with h5py.File(file) as opened:
            return set(opened)
    heads = matlab.list_arrays(file)
    return {head.name for head in heads} | {"cells" for head in heads if head.kind == "cell"}


def _variable(file: Path, name: str, axes: int) -> np.ndarray:
    """Read real numbers with a number of axes, in MATLAB's order."""
    # HDF5 files of MATLAB have reversed axes
    if h5py.is_hdf5(file):
        with h5py.File(file) as opened:
            item = field_of(opened, name)
            memory.require_free(name, 2 * (item.nbytes if item else 0))
            values = np.asarray(item[()] if item else 0.0).T
    else:
        values = matlab.read_array(file, name)
    checks.shape(name, values, values.ndim == axes and values.size, f"of {axes} axes")
    return checks.real_array(name, values)


def _number(file: Path, name: str) -> float:
    """Read an array of one number."""
    value = _variable(file, name, 2)
    checks.shape(name, value, value.size == 1, "one number")
    return float(value.item())


def _stated(file: Path) -> dict[str, float]:
    """Read the parameters that files of `save_matlab_capture` contain."""
    names = matlab_names(file)
    return {name: _number(file, name) for name in ("wall_size", "bin_width_s") if name in names}


def read_lct(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read `rect_data` (x, y, bins), x mirrored, and `width`, half the side of the wall [m].

    Bins of 4 ps start when light meets the wall, as in cnlos_reconstruction.m of M. O'Toole et al.,
    Confocal non-line-of-sight imaging based on the light-cone transform, Nature 555 (2018).
    """
    counts = _variable(file, "rect_data", 3).transpose(1, 0, 2)[:, ::-1]
    known = {"bin_width_s": 4e-12} | _stated(file)
    return scan(counts, given, **known | {"wall_size": 2 * _number(file, "width")})


def read_fk(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read `meas` (rows, columns, bins), and `tofgrid`, when light meets the wall [ps].

    `tofgrid` is in the same file, or in tof.mat in the same folder. With `start_s`, `tofgrid` is
    ignored. Pixels move by whole bins, as in cnlos_reconstruction.m of D. Lindell et al.,
    Wave-based non-line-of-sight imaging using fast f-k migration, ACM ToG 38 (2019). Its README
    states bins of 32 ps and a wall of 2 m.
    """
    counts = _variable(file, "meas", 3)
    known = {"wall_size": 2.0, "bin_width_s": 32e-12} | _stated(file)
    if "start_s" in given:
        return scan(counts, given, **known)

    # Read the delays of the pixels, in picoseconds
    files = [each for each in (file, file.with_name("tof.mat")) if each.is_file()]
    source = next((each for each in files if "tofgrid" in matlab_names(each)), None)
    if source is None:
        raise ValueError(
            "tofgrid is missing; it must be in the file, or in tof.mat in the same folder. "
            "Otherwise pass start_s"
        )
    delay = checks.finite("tofgrid", _variable(source, "tofgrid", 2))
    checks.shape("tofgrid", delay, delay.shape == counts.shape[:2], f"{counts.shape[:2]}")
    width = checks.number("bin_width_s", (known | given)["bin_width_s"], unit="s", positive=True)
    if 0 < delay.max() < width * 1e12:
        raise ValueError(
            f"tofgrid: its delays are at most {delay.max():g} ps, less than a bin of "
            f"{width * 1e12:g} ps. Convert tofgrid to picoseconds, or give start_s"
        )

    # Move the bins of each pixel
    first = np.floor(delay / (width * 1e12)).astype(np.int64)
    bins = counts.shape[2] - first.max()
    checks.require("tofgrid", delay, first.min() >= 0 and bins > 0, "within the bins, in ps")
    moved = np.take_along_axis(counts, first[..., None] + np.arange(bins), axis=2)
    return scan(moved, given, **known)


def read_cells(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read cells (rows, columns), each with the bins of a pixel's photons.

    If there are several arrays of cells, the array D is read, as in D. Shin et al.,
    Photon-efficient imaging with a single-photon camera, Nat Commun 7 (2016).
    """
    # Read the photons of each pixel
    cells = [head.name for head in matlab.list_arrays(file) if head.kind == "cell"]
    name = "D" if "D" in cells else cells[0]
    checks.require("cells", cells, name == "D" or len(cells) == 1, "one array, or one called D")
    held = matlab.read_array(file, name)
    checks.shape(name, held, held.ndim == 2 and held.size, "(rows, columns)")
    times = [checks.real_array(f"{name}: a cell", each).ravel() for each in held.ravel()]
    at = np.concatenate(times)
    pixel = np.repeat(np.arange(held.size), [each.size for each in times])
    valid = at.size and at.min() >= 0 and at.max() < checks.MAX_BINS and (at % 1 == 0).all()
    checks.require(name, at, valid, f"numbers of bins, integers below {checks.MAX_BINS}")

    # Count them
    bins = int(at.max()) + 1
    memory.require_free(name, 12 * held.size * bins)
    counts = np.bincount(pixel * bins + at.astype(np.int64), minlength=held.size * bins)
    return scan(counts.reshape(*held.shape, bins), given)


def read_npz(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read `counts` (rows, columns, bins), and parameters of `load_capture` by their names."""
    with ZipFile(file) as archive:
        names = [name for name in GIVEN if f"{name}.npy" in archive.namelist()]
        arrays = {name: read_array(archive, name) for name in ("counts", *names)}
    return scan(arrays.pop("counts"), given, **{k: v.tolist() for k, v in arrays.items()})


def read_csv(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read lines of row, column and counts, below a line "y,x,..." with the bins' starts [s]."""
    first, *lines = file.read_text("utf-8").splitlines(keepends=True)
    if not lines or not lines[-1].endswith("\n"):
        raise ValueError("is cut short; must have lines of counts, and end with a line")

    # Parse the numbers
    try:
        starts = np.array(first.split(",")[2:], float)
        table = np.loadtxt(lines, delimiter=",", ndmin=2)
    except ValueError:
        raise ValueError("y,x,...: must head lines of numbers, equally many in each") from None

    # Are the bins equally wide?
    steps = np.diff(starts)
    even = steps.size and steps[0] > 0 and np.allclose(steps, steps[0], rtol=1e-3, atol=0)
    checks.require("starts of bins", starts, even, "2 or more, at equal steps [s]")
    checks.shape("counts", table, table.shape[1] == len(starts) + 2, f"{len(starts)} of each pixel")

    # Sort the pixels, and check that none is missing
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    shape = tuple(int(number) for number in table[-1, :2] + 1)
    whole = len(table) == math.prod(shape) and (table[:, :2] == [*np.ndindex(shape)]).all()
    checks.require("y,x", table[:, :2], whole, "each pixel of a grid once, from 0,0")
    known = {"bin_width_s": float(steps.mean()), "start_s": float(starts[0])}
    return scan(table[:, 2:].reshape(*shape, -1), given, **known)


def read_ptu(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read histograms of an image, a line or a point in T3 mode, of all channels and frames."""
    with file.open("rb") as opened, _package("ptufile").PtuFile(opened) as ptu:
        checks.require("mode", "T2", ptu.is_t3, "T3, with times since the laser's pulse")

        # Markers are numbers of bits
        for name in PTU_MARKERS:
            marker = int(ptu.tags.get(name, 0))
            checks.require(name, marker, 0 <= marker <= MOST_MARKERS, f"from 0 to {MOST_MARKERS}")

        # Compare the sizes that the header states with the file and the free memory
        records = ptu.number_records
        whole = RECORD_BYTES * records <= file.stat().st_size
        checks.require("records", records, whole, "in the file, which is cut short")
        _, *sides, _, bins = ptu.shape
        for side in sides:
            checks.require(
                "pixels of a side", side, side <= checks.MAX_SIZE, f"at most {checks.MAX_SIZE}"
            )
        pixels = math.prod(sides)
        memory.require_free("counts", pixels * (COUNT_COPIES * bins + BYTES_PER_PIXEL))
        if ptu.is_sinusoidal:
            memory.require_free("a line's time steps", 16 * int(ptu.global_line_time))

        whole = len(ptu.read_records()) == records
        checks.require("records", records, whole, "in the file, which is cut short")
        counts = ptu.decode_image(frame=-1, channel=-1, dtype=np.uint32)[0, ..., 0, :]
        width = float(ptu.tcspc_resolution)
    return scan(counts[(None,) * (3 - counts.ndim)], given, bin_width_s=width)


def read_sdt(file: Path, given: dict[str, Any]) -> xr.Dataset:
    """Read histograms of an image, a line or a point. All blocks, such as detectors, are added."""
    package = _package("sdtfile")
    _require_sdt_sizes(file)
    with file.open("rb") as opened, package.SdtFile(opened) as sdt:
        blocks = sdt.data
        times = sdt.times
    shapes = sorted({block.shape for block in blocks})
    fits = len(shapes) == 1 and 1 <= len(shapes[0]) <= 3 and shapes[0][-1] == len(times[0]) > 1
    checks.require("blocks", shapes, fits, "of one shape, (rows, columns, bins) or (bins,)")
    counts = np.asarray(np.sum(blocks, axis=0, dtype=np.float64))
    width = float(np.diff(times[0]).mean())
    return scan(counts[(None,) * (3 - counts.ndim)], given, bin_width_s=width)


def _require_sdt_sizes(file: Path) -> None:
    """Compare the sizes in the headers of an SDT file with the file and the free memory."""
    length = file.stat().st_size
    total = 0
    with file.open("rb") as opened:
        head = _unpacked(opened, 0, SDT_HEAD)
        revision = head[0]
        offset = head[5]
        count = head[6]
        if count == SDT_MANY_BLOCKS:
            count = head[12]
        block_head = SDT_BLOCK if revision & 0xF >= SDT_NEW_BLOCKS else SDT_OLD_BLOCK
        for block in range(count):
            start, following, kind, _, _, size = _unpacked(opened, offset, block_head)[-6:]
            if block == count - 1 and following <= start:
                following = length

            # The block must be inside the file, and so must its values
            inside = offset < start <= following <= length
            checks.require("blocks", (start, following), inside, "in the file, one after another")
            if kind & SDT_COMPRESSED:
                opened.seek(start)
                with ZipFile(BytesIO(opened.read(following - start))) as archive:
                    size = max(size, *(entry.file_size for entry in archive.filelist))
                most = ZLIB_RATIO * (following - start)
                checks.require("bytes of a block", size, size <= most, f"at most {most}")
            else:
                checks.require("blocks", start + size, start + size <= length, "in the file")
            total += size
            offset = following
    memory.require_free("blocks", SDT_COPIES * total)


def _unpacked(opened: BinaryIO, offset: int, form: str) -> tuple[int, ...]:
    """Read numbers of a header at an offset of a file."""
    opened.seek(max(offset, 0))
    content = opened.read(struct.calcsize(form))
    if offset < 0 or len(content) < struct.calcsize(form):
        raise ValueError("is cut short; must have all blocks")
    return struct.unpack(form, content)


def _package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ImportError(f"this file needs {name}: pip install 'tofrender[data]'") from None
