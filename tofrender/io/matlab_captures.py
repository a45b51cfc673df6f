"""Writer of confocal captures as MATLAB files, for the published code of two reconstructions."""

import math
import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import xarray as xr
from scipy.io import savemat

from ..labels import CAPTURE
from ..nlos.captures import ON_WALL, as_capture, read_capture, without_first_and_last_legs
from ..nlos.reconstruction.wall_capture import Measured
from ..runtime import checks
from ..runtime.atomic import check_file, replacing
from ..runtime.progress import status
from ..signals.units import SPEED_OF_LIGHT

LAYOUTS = ("fk", "lct")
MAX_BYTES = (1 << 31) - 1  # Largest array of a MATLAB 5 file
FRACTION = 1e-3  # Allowed error of bins and sides, as a fraction of a bin and of a side


@status("Writing MATLAB")
def save_matlab_capture(
    capture: Annotated[xr.Dataset, CAPTURE],
    path: str | os.PathLike,
    *,
    layout: str,
    overwrite: bool = False,
) -> Path:
    """Write a confocal capture for the MATLAB code of f-k migration or the light-cone transform.

    Both layouts contain the luminance in float32. Seen from the wall, rows run downwards and
    columns to the right; columns of a mirrored grid are reversed. The first bin starts when light
    leaves the wall: first and last legs are subtracted, empty bins are added at the start, and
    earlier bins are dropped. Light that falls between two of these bins is divided between both.

    | layout | arrays |
    |---|---|
    | `"fk"` | `meas` (rows, columns, bins); `tofgrid` (rows, columns) of zeros [ps] |
    | `"lct"` | `rect_data` (x, y, bins), x reversed; `width`, half the side of the wall [m] |

    The published scripts have constants for the width of a bin (32 ps and 4 ps), and for the side
    of the wall of f-k migration (2 m). Set them to `bin_width_s` and `wall_size`, which the file
    contains as well. `load_capture` reads both.

    Args:
        capture: Result of `make_capture` or `capture`, or counts that `sense` measured of it. Its
            points form a regular grid on a plane and square wall, with 2 x 2 points or more.
        path: A file name that ends in .mat.
        layout: "fk" or "lct".
        overwrite: Replace an existing file.

    Raises:
        ValueError: The capture does not fit the layout; one line.
        OSError: `path` may not be replaced or is not writable, or the disk is full.

    References:
        Lindell, Wetzstein, O'Toole, Wave-based non-line-of-sight imaging using fast f-k migration,
        ACM ToG 38 (2019). O'Toole, Lindell, Wetzstein, Confocal non-line-of-sight imaging based on
        the light-cone transform, Nature 555 (2018).

    Example:
        >>> import tempfile
        >>> from tofrender import load_capture, make_capture
        >>> x, y = np.meshgrid(np.linspace(1, -1, 4), np.linspace(1, -1, 4))
        >>> wall = np.stack([x, y, 0 * x], axis=-1)
        >>> grid = {"sensor_grid": wall, "sensor_normals": np.broadcast_to([0, 0, 1], wall.shape)}
        >>> window = {"start_opl": 0.0, "bin_width_opl": 0.01}
        >>> capture = make_capture(np.ones((4, 4, 9)), mode="confocal", **window, **grid)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = save_matlab_capture(capture, folder + "/wall.mat", layout="fk")
        ...     round(load_capture(file).attrs["bin_width_opl"], 6)
        0.01
    """
    # Does the capture fit the layout?
    checks.one_of("layout", layout, LAYOUTS)
    capture = read_capture(as_capture(capture), "capture")
    mode = capture.attrs["capture_mode"]
    if mode != "confocal":
        raise ValueError(f"capture: {mode} captures are not supported; use a confocal capture")
    if ON_WALL in capture:
        raise ValueError("capture: pixels beyond the wall are not supported; crop the capture")
    measured = Measured.of(without_first_and_last_legs(capture))
    side = _side(measured)
    start = measured.start / measured.width
    _, rows, columns, bins = measured.shape
    count = bins + math.ceil(max(start, 0))
    if start + bins <= 1:
        raise ValueError("capture: all bins end before light leaves the wall; choose later bins")

    # Is there enough space on the disk?
    size = 4 * rows * columns * count
    checks.require("capture", f"{size} bytes", size <= MAX_BYTES, f"at most {MAX_BYTES} bytes")
    target = check_file(path, ".mat", overwrite=overwrite, needed_bytes=size)

    # Bring the light to the order of the layout
    light = np.concatenate([measured.light(0, block) for block in measured.blocks()])
    light = _from_the_wall(light, start)
    if np.linalg.det(measured.frame.axes) < 0:
        light = light[:, ::-1]
    arrays: dict[str, Any] = {"bin_width_s": measured.width / SPEED_OF_LIGHT, "wall_size": side}
    if layout == "fk":
        arrays |= {"meas": light, "tofgrid": np.zeros((rows, columns))}
    else:
        arrays |= {"rect_data": light[:, ::-1].transpose(1, 0, 2), "width": side / 2}

    with replacing(target, needed_bytes=size) as temporary, temporary.open("wb") as file:
        savemat(file, arrays)
    return target


def _side(measured: Measured) -> float:
    """Return the side of the scanned square, from the first to the last point [m]."""
    lattice = measured.lattice
    if lattice is None:
        raise ValueError("capture: sensor_grid must be a regular grid on a plane wall")
    _, rows, columns, _ = measured.shape
    width = (columns - 1) * lattice.dx
    height = (rows - 1) * lattice.dy
    if not math.isclose(width, height, rel_tol=FRACTION):
        raise ValueError(
            f"capture: the wall is {width:.4g} m wide and {height:.4g} m high. The layout needs a "
            "square; crop the capture"
        )
    return width


def _from_the_wall(light: np.ndarray, start: float) -> np.ndarray:
    """Return light whose first bin starts at the path length 0, when it leaves the wall.

    Light that falls between two new bins is divided between both. Earlier bins are dropped.

    Args:
        light: Light (rows, columns, bins).
        start: Start of its first bin, in bins.
    """
    whole = math.floor(start + FRACTION)
    part = np.float32(max(0.0, start - whole))
    if part > FRACTION:
        light = np.pad(light, [(0, 0), (0, 0), (0, 1)])
        light = (1 - part) * light + part * np.roll(light, 1, axis=2)
    if whole < 0:
        return light[:, :, -whole:]
    return np.pad(light, [(0, 0), (0, 0), (whole, 0)])
