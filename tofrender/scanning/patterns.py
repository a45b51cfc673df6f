"""Scan patterns: the direction and the time of each shot of a lidar."""

import os
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ..labels import PATTERN, read
from ..runtime import checks

PATTERNS = ("raster", "spinning", "rosette")
# Golden ratio, the ratio of the rates of both prisms in a rosette
GOLDEN = (5**0.5 - 1) / 2


def scan_pattern(
    pattern: str | os.PathLike[str] = "raster",
    *,
    shots: Any = (64, 48),
    fov_deg: Any = (40.0, 30.0),
    rate_hz: float = 100e3,
) -> xr.Dataset:
    """Return the directions and times of a lidar's shots.

    A "raster" scans row by row, from the upper left. A "spinning" lidar scans column by column: its
    head rotates clockwise and fires all rings from the top. A "rosette" has two (Risley) prisms,
    which rotate in opposite directions, with rates in the golden ratio g. With N shots and n turns
    of the first prism, azimuth and elevation of shot k are (cos f + cos gf, sin f - sin gf) / 2,
    relative to half the field of view, with f = 2 pi n k / N.

    Args:
        pattern: Name, or path of a CSV file with the columns azimuth_deg, elevation_deg and
            optionally time_s. Shots of a file do not depend on the other parameters.
        shots: Number of columns and rows. Rows are rings, or turns of the first prism.
        fov_deg: Width and height of the field of view [degrees], up to 360 and 180.
        rate_hz: Shots per second.

    Returns:
        A Dataset along "shot": `azimuth` from the sensor's axis to the left and `elevation` [rad],
        `time` [s].

    Raises:
        ValueError: The pattern is unknown, the file is invalid, or a value is out of range.

    Example:
        >>> pattern = scan_pattern(shots=(4, 2), fov_deg=(40, 10))
        >>> np.rad2deg(pattern["azimuth"][:4]).values.round().tolist()
        [15.0, 5.0, -5.0, -15.0]
    """
    # Check the numbers
    two = "two numbers, of the width and the height"
    sides = checks.items("shots", shots, 2, two)
    columns, rows = (checks.integer("shots", n, 1, checks.MAX_SIZE) for n in sides)
    limits = zip(checks.items("fov_deg", fov_deg, 2, two), (360, 180), strict=True)
    fov = [checks.number("fov_deg", angle, positive=True, high=most) for angle, most in limits]

    # Compute the directions relative to the field of view, or read them
    k = np.arange(columns * rows)
    time = k / checks.number("rate_hz", rate_hz, positive=True)
    if isinstance(pattern, os.PathLike) or str(pattern).lower().endswith(".csv"):
        table = _read(checks.path("pattern", pattern))
        pattern = str(pattern)
        fov = (2.0, 2.0)
        time = table.get("time_s", np.zeros(len(table)))
        across = table["azimuth_deg"]
        up = table["elevation_deg"]
    elif checks.one_of("pattern", pattern, PATTERNS) == "rosette":
        f = 2 * np.pi * rows * k / k.size
        across = (np.cos(f) + np.cos(GOLDEN * f)) / 2
        up = (np.sin(f) - np.sin(GOLDEN * f)) / 2
    else:
        column, row = (k % columns, k // columns) if pattern == "raster" else (k // rows, k % rows)
        across = 1 - (2 * column + 1) / columns
        up = 1 - (2 * row + 1) / rows

    # Describe the shots
    values = {"azimuth": np.deg2rad(fov[0] / 2 * across), "elevation": np.deg2rad(fov[1] / 2 * up)}
    arrays = {name: ("shot", np.asarray(each), {"units": "rad"}) for name, each in values.items()}
    arrays["time"] = "shot", np.asarray(time), {"units": "s"}
    return xr.Dataset(arrays, attrs={"pattern": pattern})


def _read(path: Any) -> pd.DataFrame:
    """Read and check a CSV file of shots."""
    try:
        table = pd.read_csv(path, skipinitialspace=True).apply(pd.to_numeric, errors="coerce")
        needed = {"azimuth_deg", "elevation_deg"}
        names = {*table.columns}
        valid = len(table) and needed <= names <= needed | {"time_s"} and np.isfinite(table.values)

        # If rows are longer than the header, pandas uses the first columns as the index
        valid &= isinstance(table.index, pd.RangeIndex)
        if np.all(valid) and table["elevation_deg"].abs().max() <= 90:
            return table
        reason = f"has {len(table)} rows of {checks.join_names([*table.columns])}"
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split())
    allowed = "a CSV file of finite azimuth_deg, elevation_deg up to 90, and perhaps time_s"
    raise ValueError(f"pattern = {path}: {reason}; must be {allowed}")


def read_pattern(pattern: Any) -> xr.Dataset:
    """Read a result of `scan_pattern`, or the pattern in a result of `lidar`."""
    found = read(pattern, PATTERN, "pattern")
    for name in PATTERN.variables:
        checks.finite("pattern", checks.real_array("pattern", found[name].values))
    return found.drop_dims(["bin", "axis"], errors="ignore")


def directions(pattern: xr.Dataset) -> np.ndarray:
    """Return unit vectors (shot, 3) in the space of a sensor: x to the left, y up, z forward."""
    a, e = (pattern[name].values for name in ("azimuth", "elevation"))
    return np.stack([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)], axis=1)
