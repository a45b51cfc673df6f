"""The case `reconstruction`: times of our methods, and of y-tal if it is installed."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tofrender.io.hdf5 import save_capture
from tofrender.nlos import make_capture, reconstruct

from .timing import Row, in_turn

if TYPE_CHECKING:
    import xarray as xr

VOXELS = {False: (32, 32, 16), True: (8, 8, 4)}
X = (-1.0, 1.0)
Y = (-1.0, 1.0)
Z = (0.5, 1.5)


def _capture(size: int, bins: int) -> xr.Dataset:
    """Make a capture of noise on a wall of 2 m. The time does not depend on the content."""
    at = ((np.arange(size) + 0.5) / size - 0.5) * 2
    x, y = np.meshgrid(at, at)
    wall = np.stack([x, y, 0 * x], axis=-1)
    return make_capture(
        np.random.default_rng(0).random((size, size, bins), dtype=np.float32),
        mode="confocal",
        start_opl=0.9,
        bin_width_opl=0.006,
        sensor_grid=wall,
        sensor_normals=np.broadcast_to([0, 0, 1], wall.shape),
    )


def _ours(capture: xr.Dataset, method: str, **options: Any) -> Callable[[], object]:
    """Return a function that reconstructs a capture."""
    return partial(reconstruct, capture, method, progress=False, **options)


def _theirs(capture: xr.Dataset, voxels: tuple[int, int, int]) -> dict[str, float]:
    """Measure y-tal's backprojection and f-k migration [s]; {} if y-tal is not installed."""
    try:
        import tal
        from tal.reconstruct import bp, fk
    except ImportError:
        return {}
    with tempfile.TemporaryDirectory() as folder:
        data = tal.io.read_capture(str(save_capture(capture, Path(folder) / "noise.h5")))

    # Reconstruct at the same points
    axes = [
        low + (np.arange(count) + 0.5) * (high - low) / count
        for (low, high), count in zip((X, Y, Z), voxels, strict=True)
    ]
    volume = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)
    functions = {
        "bp": lambda: bp.solve(data, volume, tal.enums.VolumeFormat.X_Y_Z_3, progress=False),
        "fk": lambda: fk.solve(data),
    }
    seconds = {}
    for name, function in functions.items():
        start = time.perf_counter()
        function()
        seconds[name] = time.perf_counter() - start
    return seconds


_MEMORY = """
import sys
from pathlib import Path
from benchmarks.case_reconstruction import X, Y, Z, _capture, _ours
size, bins, side = map(int, sys.argv[1:])
volume = ((*X, side), (*Y, side), (*Z, side))
_ours(_capture(size, bins), "bp", volume=volume)()
lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(int(lines["VmHWM"].split()[0]) / 2**10)
"""


def reconstruction(runs: int, quick: bool) -> list[Row]:
    """Measure the times of all methods, and compare them with y-tal."""
    # Prepare captures
    size, bins, long = (16, 60, 64) if quick else (64, 300, 512)
    voxels = VOXELS[quick]
    axes = tuple((*edges, count) for edges, count in zip((X, Y, Z), voxels, strict=True))
    short = _capture(size, bins)
    full = _capture(size, long)

    # Measure the times
    functions = {
        "bp": _ours(short, "bp", volume=axes),
        "lct": _ours(full, "lct"),
        "fk": _ours(full, "fk"),
        "fk short": _ours(short, "fk"),
        "phasor": _ours(short, "phasor", volume=axes),
    }
    times = {name: float(np.median(t.wall)) for name, t in in_turn(functions, runs).items()}
    target = (None, None) if quick else (0.6, 1.5)
    many = "x".join(map(str, voxels))
    rows: list[Row] = [
        (f"bp, {size}x{size} x {bins} into {many} [s]", times["bp"], target[0]),
        (f"lct, {size}x{size} x {long} [s]", times["lct"], target[1]),
        (f"fk, {size}x{size} x {long} [s]", times["fk"], target[1]),
        (f"phasor, {size}x{size} x {bins} into {many} [s]", times["phasor"], None),
    ]

    # Compare with y-tal
    theirs = _theirs(short, voxels)
    if theirs:
        what = f"{size}x{size} x {bins}: y-tal's time over ours"
        rows.append((f"bp, {what}", theirs["bp"] / times["bp"], 20.0))
        rows.append((f"fk, {what}", theirs["fk"] / times["fk short"], 5.0))

    # Measure the memory in a separate process
    if Path("/proc/self/status").exists():
        command = [sys.executable, "-c", _MEMORY, str(size), str(bins), str(size)]
        peak = float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        rows.append((f"bp into {size}^3: peak of the process [MiB]", peak, 1024.0))
    return rows
