"""NetCDF 3 files of measurements, which `xarray.load_dataset` opens as well."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..runtime import checks
from ..runtime.atomic import replacing
from ..runtime.backend import versions
from .files import reading, seal_file

MAX = np.iinfo(np.int32).max  # NetCDF 3 has no larger integers, and none without a sign


def save_measurement(measured: xr.Dataset, path: Path) -> None:
    """Write a Dataset with a `quantity` and a seal; integers become int32, large ones float64."""
    attrs: dict[str, Any] = {"versions": versions()}
    for name, value in measured.attrs.items():  # With bools
        attrs[name] = (int if value <= MAX else float)(value) if isinstance(value, int) else value
    for name, array in measured.items():
        if array.dtype.kind == "u":
            kind = np.int32 if array.max() <= MAX else np.float64
            measured = measured.assign({name: array.astype(kind)})
    with replacing(path, needed_bytes=measured.nbytes) as temporary:
        measured.assign_attrs(attrs).to_netcdf(temporary, engine="scipy")
        seal_file(temporary)


def load_measurement(path: Path) -> xr.Dataset:
    """Read a file of `save_measurement`; one that is damaged or something else is a ValueError."""
    with reading(path, "a file that `tofrender sense` or `tofrender fmcw` wrote") as file:
        found = xr.load_dataset(file, engine="scipy")
        checks.require("its quantity", None, found.attrs.get("quantity") in found, "there")
    return found
