"""Point clouds of a lidar as PLY, LAS and netCDF."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import xarray as xr

from ..runtime import checks
from ..runtime.atomic import check_file, replacing

SUFFIXES = (".ply", ".las", ".nc")
PLY_TYPES = {"u": ("<u1", "uchar"), "i": ("<i4", "int"), "f": ("<f8", "double")}


def save_point_cloud(
    cloud: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False
) -> Path:
    """Write a point cloud for other programs.

    PLY and netCDF have all columns. LAS (1.4, point format 6, by `laspy`) has coordinates in steps
    of 0.1 mm, times, returns, an intensity of 65535 for the brightest point, and as extra columns
    `photons` and `true_range`.

    Args:
        cloud: A result of `point_cloud` or `true_points`.
        path: A file name that ends in .ply, .las or .nc.
        overwrite: Replace an existing file.

    Raises:
        ValueError: Another Dataset or suffix, or laspy is not installed.
        OSError: `path` may not be replaced or is not writable.

    Example:
        >>> import tempfile
        >>> cloud = xr.Dataset({name: ("point", np.zeros(2)) for name in "xyz"})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_point_cloud(cloud, folder + "/cloud.ply").stat().st_size
        166
    """
    whole = isinstance(cloud, xr.Dataset) and {*"xyz"} <= set(cloud)
    checks.require("cloud", cloud, whole, "a Dataset of point_cloud")
    target = check_file(path, *SUFFIXES, overwrite=overwrite, needed_bytes=cloud.nbytes)
    require_laspy("path", target)
    write = {".ply": _write_ply, ".las": _write_las, ".nc": xr.Dataset.to_netcdf}
    with replacing(target) as temporary:
        write[target.suffix.lower()](cloud, temporary)
    return target


def require_laspy(name: str, path: Path) -> None:
    """Require laspy for a LAS file, a parameter of this name."""
    needed = path.suffix.lower() == ".las" and find_spec("laspy") is None
    checks.require(name, str(path), not needed, ".ply or .nc without laspy, see tofrender[lidar]")


def _write_ply(cloud: xr.Dataset, path: Path) -> None:
    kinds = {str(name): PLY_TYPES[cloud[name].dtype.kind] for name in cloud}
    table = np.empty(cloud.sizes["point"], [(name, kind[0]) for name, kind in kinds.items()])
    for name in kinds:
        table[name] = cloud[name]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {table.size}"]
    lines += [f"property {kind} {name}" for name, (_, kind) in kinds.items()]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + table.tobytes())


def _write_las(cloud: xr.Dataset, path: Path) -> None:
    import laspy  # pyright: ignore[reportMissingImports]

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 1e-4), np.zeros(3)
    more = {"intensity": "photons", "true_range": "true_range"}
    more = {name: given for given, name in more.items() if given in cloud}
    header.add_extra_dims([laspy.ExtraBytesParams(name, np.float64) for name in more])
    las = laspy.LasData(header)
    las.x, las.y, las.z = (cloud[name].values for name in "xyz")
    las.gps_time = cloud["time"].values
    for name in {"return_number", "number_of_returns"} & set(cloud):
        las[name] = cloud[name].values
    if "intensity" in cloud and cloud.sizes["point"]:
        las.intensity = np.rint(65535 * (cloud["intensity"] / cloud["intensity"].max()).values)
    for name, given in more.items():
        las[name] = cloud[given].values
    las.write(path)
