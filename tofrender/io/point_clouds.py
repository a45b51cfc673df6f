"""Point clouds of a lidar as PLY, LAS and netCDF."""

import os
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..runtime import checks
from ..runtime.atomic import check_file, replacing

SUFFIXES = (".ply", ".las", ".nc")
PLY_TYPES = {"u": ("<u1", "uchar"), "i": ("<i4", "int"), "f": ("<f8", "double")}


def save_point_cloud(
    cloud: xr.Dataset, path: str | os.PathLike[str], *, overwrite: bool = False
) -> Path:
    """Write a point cloud for other programs: all columns, in LAS (1.4, format 6) those it knows.

    LAS needs laspy. It has steps of 0.1 mm, and 65535 as the intensity of the brightest point.

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
    write: dict[str, Any] = dict(
        zip(SUFFIXES, (_write_ply, _write_las, xr.Dataset.to_netcdf), strict=True)
    )
    with replacing(target) as temporary:
        write[target.suffix.lower()](cloud, temporary)
    return target


def require_laspy(name: str, path: Path) -> None:
    """Require laspy for a LAS file, a parameter of this name."""
    needed = path.suffix.lower() == ".las" and find_spec("laspy") is None
    checks.require(name, str(path), not needed, ".ply or .nc without laspy, see tofrender[lidar]")


def _write_ply(cloud: xr.Dataset, path: Path) -> None:
    kinds = {str(name): PLY_TYPES[cloud[name].dtype.kind] for name in cloud}
    table = np.empty(cloud.sizes["point"], [(name, kind) for name, (kind, _) in kinds.items()])
    for name in kinds:
        table[name] = cloud[name]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {table.size}"]
    lines += [f"property {kind} {name}" for name, (_, kind) in kinds.items()]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + table.tobytes())


def _write_las(cloud: xr.Dataset, path: Path) -> None:
    import laspy  # pyright: ignore[reportMissingImports]

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 1e-4)
    las = laspy.LasData(header)
    for name in {"x", "y", "z", "return_number", "number_of_returns", "time"} & set(cloud):
        las["gps_time" if name == "time" else name] = cloud[name].values
    if "intensity" in cloud and cloud.sizes["point"]:
        las.intensity = np.rint(65535 * (cloud["intensity"] / cloud["intensity"].max()).values)
    las.write(str(path))
