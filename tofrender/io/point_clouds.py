"""Point clouds of a lidar as PLY, LAS and netCDF."""

import math
import os
import re
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
import xarray as xr

from ..labels import CLOUD, read
from ..runtime import checks
from ..runtime.atomic import check_file, replacing
from .netcdf import LARGEST_EXACT, in_netcdf_types

SUFFIXES = (".ply", ".las", ".nc")
PLY_TYPES = {
    "int8": "char",
    "uint8": "uchar",
    "int16": "short",
    "uint16": "ushort",
    "int32": "int",
    "uint32": "uint",
    "float32": "float",
    "float64": "double",
}
LAS_STEP_M = 1e-4  # Usual step of coordinates
LAS_STEPS = (1 << 31) - 2  # Largest number of steps from the offset
LAS_WHITE = (1 << 16) - 1  # Largest intensity
LAS_RETURNS = 15  # Largest number of a return


def save_point_cloud(
    cloud: Annotated[xr.Dataset, CLOUD],
    path: str | os.PathLike[str],
    *,
    intensity_scale: float = 1.0,
    overwrite: bool = False,
) -> Path:
    """Write a point cloud as PLY, LAS or netCDF for other programs.

    PLY and netCDF files contain all data variables. LAS files (version 1.4, point format 6) contain
    the variables with a field in LAS. LAS needs the package laspy. The coordinates of LAS have
    steps of 0.1 mm, or larger steps if the cloud is wider than 400 km. The intensity of LAS is an
    integer, `intensity * intensity_scale`. With one scale, files of one scan are comparable.

    Args:
        cloud: Result of `point_cloud` or `true_points`.
        path: File name that ends in .ply, .las or .nc.
        intensity_scale: Steps of the LAS intensity per unit of `intensity`. In results of
            `point_cloud`, the unit is a photon. Other formats ignore this scale.
        overwrite: Replace an existing file.

    Raises:
        ValueError: `cloud` is another Dataset, the format cannot hold the exact values of a
            variable, the suffix is unknown, or laspy is not installed.
        OSError: `path` may not be replaced or is not writable.

    Warns:
        UserWarning: Points are brighter than the largest LAS intensity, 65535, and are written with
            that intensity.

    Example:
        >>> import tempfile
        >>> cloud = xr.Dataset({name: ("point", np.zeros(2)) for name in "xyz"})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_point_cloud(cloud, folder + "/cloud.ply").stat().st_size
        166
    """
    # Check the arguments
    cloud = read(cloud, CLOUD, "cloud")
    for name, column in cloud.items():
        checks.require(
            f"cloud: dimensions of {name}", column.dims, column.dims == ("point",), "point"
        )
    scale = checks.number("intensity_scale", intensity_scale, positive=True)
    target = check_file(path, *SUFFIXES, overwrite=overwrite, needed_bytes=cloud.nbytes)
    require_laspy("path", target)

    # Write the file in the format of its suffix
    suffix = target.suffix.lower()
    with replacing(target) as temporary:
        if suffix == ".ply":
            _write_ply(cloud, temporary)
        elif suffix == ".las":
            _write_las(cloud, temporary, scale)
        else:
            in_netcdf_types(cloud).to_netcdf(temporary, engine="scipy")
    return target


def require_laspy(name: str, path: Path) -> None:
    """Require laspy for a LAS file, a parameter of this name."""
    needed = path.suffix.lower() == ".las" and find_spec("laspy") is None
    checks.require(name, str(path), not needed, ".ply or .nc without laspy, see tofrender[lidar]")


def _write_ply(cloud: xr.Dataset, path: Path) -> None:
    """Write all variables, each with the type of PLY that has the same values."""
    # Fill a table with a row for each point
    columns = {str(name): _ply_column(str(name), cloud[name].values) for name in cloud}
    dtype = [(name, column.dtype) for name, column in columns.items()]
    table = np.empty(cloud.sizes["point"], dtype)
    for name, column in columns.items():
        table[name] = column

    # Describe the columns in the header
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {table.size}"]
    for name, column in columns.items():
        lines.append(f"property {PLY_TYPES[column.dtype.name]} {name}")
    header = "\n".join([*lines, "end_header", ""])
    path.write_bytes(header.encode() + table.tobytes())


def _ply_column(name: str, values: np.ndarray) -> np.ndarray:
    """Convert a variable to a type of PLY, which has neither 64-bit integers nor bool."""
    # A blank would end the name in the header
    is_name = re.fullmatch(r"[!-~]+", name) is not None
    checks.require("cloud: name of a variable", name, is_name, "printable ASCII without blanks")

    # Choose the type
    dtype = values.dtype
    if dtype.kind == "b":
        dtype = np.dtype(np.uint8)
    elif dtype == np.float16:
        dtype = np.dtype(np.float32)
    elif dtype.kind in "iu" and dtype.itemsize == 8:
        dtype = np.dtype(np.int32)
        limits = np.iinfo(dtype)
        fits = not values.size or limits.min <= values.min() <= values.max() <= limits.max
        allowed = "integers that fit into 32 bits in a PLY file, or converted to float64"
        checks.require(f"cloud: {name}", values, fits, allowed)
    known = dtype.name in PLY_TYPES
    checks.require(
        f"cloud: type of {name}", str(dtype), known, "integers, floats or bool in a PLY file"
    )
    return values.astype(dtype.newbyteorder("<"))


def _write_las(cloud: xr.Dataset, path: Path, intensity_scale: float) -> None:
    """Write the variables with a field in LAS."""
    import laspy  # pyright: ignore[reportMissingImports]

    # Place the coordinates around the middle of the cloud, in steps that 32 bits can count
    points = np.stack(
        [_las_column(cloud, axis, -checks.MAX_OPL, checks.MAX_OPL) for axis in "xyz"], axis=-1
    )
    low = points.min(axis=0, initial=math.inf)
    high = points.max(axis=0, initial=-math.inf)
    offsets = np.rint((low + high) / 2) if len(points) else np.zeros(3)
    widest = np.abs(points - offsets).max(initial=0.0)
    step = LAS_STEP_M
    while widest > LAS_STEPS * step:
        step *= 10
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, step)
    header.offsets = offsets
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T

    # Write the columns of echoes
    for name in ("return_number", "number_of_returns"):
        if name in cloud:
            numbers = _las_column(cloud, name, 0, LAS_RETURNS)
            whole = np.array_equal(numbers, np.rint(numbers))
            checks.require(f"cloud: {name}", numbers, whole, "integers in a LAS file")
            las[name] = numbers.astype(np.uint8)
    if "time" in cloud:
        las.gps_time = _las_column(cloud, "time", -math.inf, math.inf)
    if "intensity" in cloud:
        intensity = _las_column(cloud, "intensity", 0, math.inf) * intensity_scale
        too_bright = int(np.count_nonzero(intensity > LAS_WHITE))
        if too_bright:
            fitting = intensity_scale * LAS_WHITE / intensity.max()
            warnings.warn(
                f"{too_bright} of {len(intensity)} points are brighter than the largest LAS "
                f"intensity, {LAS_WHITE}, and are cut there; pass intensity_scale={fitting:.1g} "
                "or less to save_point_cloud for all files of a scan, or write .ply",
                stacklevel=3,
            )
        las.intensity = np.rint(np.minimum(intensity, LAS_WHITE)).astype(np.uint16)
    las.write(str(path))


def _las_column(cloud: xr.Dataset, name: str, low: float, high: float) -> np.ndarray:
    """Return a variable as float64. Raise an error for other types, and outside the LAS range."""
    given = checks.real_array(f"cloud: {name}", cloud[name].values)
    if given.dtype.kind in "iu":
        # Larger integers would be rounded
        low = max(low, -LARGEST_EXACT)
        high = min(high, LARGEST_EXACT)
    checks.finite(f"cloud: {name}", given)
    fits = not given.size or (given.min() >= low and given.max() <= high)
    checks.require(f"cloud: {name}", given, fits, f"from {low:g} to {high:g} in a LAS file")
    return given.astype(np.float64)
