"""What sensors measure, as NetCDF 3 files, which `xarray.load_dataset` opens as well."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..runtime import checks
from ..runtime.atomic import replacing
from ..runtime.backend import versions
from .files import reading, seal_file

if TYPE_CHECKING:
    import xarray as xr

MAX = np.iinfo(np.int32).max  # NetCDF 3 has no larger integers, and none without a sign


def save_measurement(measured: xr.Dataset, path: Path) -> None:
    """Write a result of `sense`, with a seal; counts become int32."""
    small = {
        name: array.astype(np.int32 if array.max() <= MAX else np.float64)
        for name, array in measured.data_vars.items()
        if array.dtype.kind == "u"
    }
    attrs = {
        name: float(value) if isinstance(value, int) and abs(value) > MAX else value
        for name, value in ({"versions": versions()} | measured.attrs).items()
    }
    attrs = {n: int(value) if isinstance(value, bool) else value for n, value in attrs.items()}
    with replacing(path, needed_bytes=measured.nbytes) as temporary:
        measured.assign(small).assign_attrs(attrs).to_netcdf(temporary, engine="scipy")
        seal_file(temporary)


def load_measurement(path: Path) -> xr.Dataset:
    """Read a file of `save_measurement`; one that is damaged or something else is a ValueError."""
    import xarray as xr

    with reading(path, "a file that `tofrender sense` wrote") as file:
        found = xr.load_dataset(file, engine="scipy")
        quantity = found.attrs.get("quantity")
        checks.require("quantity", quantity, quantity in found and "sensor" in found.attrs, "there")
    return found
