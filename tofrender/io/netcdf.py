"""NetCDF 3 files of measurements, which `xarray.load_dataset` opens as well."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..runtime import checks
from ..runtime.atomic import replacing
from ..runtime.versions import versions
from .files import reading, seal_file

# Attributes of SciPy's file object, which attributes of a Dataset would replace
RESERVED = {"dimensions", "filename", "fp", "maskandscale", "mode", "use_mmap", "variables"}
LARGEST_EXACT = 1 << 53  # Up to it, float64 holds all integers


def save_measurement(measured: xr.Dataset, path: Path) -> None:
    """Write a Dataset with a `quantity` and a seal, in the types of `in_netcdf_types`."""
    stored = in_netcdf_types(measured)
    stored.attrs = {"versions": versions()} | stored.attrs
    with replacing(path, needed_bytes=stored.nbytes) as temporary:
        stored.to_netcdf(temporary, engine="scipy")
        seal_file(temporary)


def in_netcdf_types(dataset: xr.Dataset) -> xr.Dataset:
    """Convert variables and attributes to the types of NetCDF 3, without a change of values.

    NetCDF 3 supports signed integers of up to 32 bits, float32, float64 and text. Larger integers
    become float64, and float16 becomes float32.

    Raises:
        ValueError: A variable has another type, or an integer beyond 2^53, or SciPy's writer does
            not support the name of an attribute.
    """
    for name in sorted(RESERVED & {*map(str, dataset.attrs)}):
        raise ValueError(
            f"attribute {name} is not supported in NetCDF files, as SciPy's writer uses the name. "
            "Rename the attribute"
        )
    converted = {name: _in_netcdf_type(str(name), each) for name, each in dataset.variables.items()}
    attrs: dict[str, Any] = {}
    for name, value in dataset.attrs.items():
        attrs[str(name)] = value
        if isinstance(value, int):  # Also bool
            attrs[str(name)] = int(value) if _fits_int32(value, value) else float(value)
    return dataset.assign(converted).assign_attrs(attrs)


def _in_netcdf_type(name: str, variable: xr.Variable) -> xr.Variable:
    # Floats of 16 bits
    dtype = variable.dtype
    if dtype == np.float16:
        return variable.astype(np.float32)

    # Integers that are unsigned or have 64 bits
    if dtype.kind in "iu" and (dtype.kind == "u" or dtype.itemsize == 8) and variable.size:
        least = int(variable.min())
        largest = int(variable.max())
        if _fits_int32(least, largest):
            return variable.astype(np.int32)
        exact = least >= -LARGEST_EXACT and largest <= LARGEST_EXACT
        allowed = "integers up to 2^53 in a NetCDF file; subtract the first value, or use float64"
        checks.require(name, variable, exact, allowed)
        return variable.astype(np.float64)

    # All other types must be types of NetCDF 3
    is_text = dtype.kind in "SU"
    if dtype.kind == "O":
        is_text = all(isinstance(each, str) for each in variable.values.flat)
    is_float = dtype.kind == "f" and dtype.itemsize in (4, 8)
    known = dtype.kind in "biu" or is_float or is_text
    checks.require(
        f"type of {name}", str(dtype), known, "integers, floats, bool or text in a NetCDF file"
    )
    return variable


def _fits_int32(least: int, largest: int) -> bool:
    limits = np.iinfo(np.int32)
    return bool(limits.min <= least <= largest <= limits.max)


def load_measurement(path: Path) -> xr.Dataset:
    """Read a file that `save_measurement` wrote. Other or damaged files raise a ValueError."""
    with reading(path, "a file that `tofrender sense` or `tofrender fmcw` wrote") as file:
        found = xr.load_dataset(file, engine="scipy")
        checks.require("its quantity", None, found.attrs.get("quantity") in found, "there")
    return found
