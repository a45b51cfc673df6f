"""Datasets of arrays in memory without an import of Dask, which takes as long as a small render."""

import sys
from functools import cache
from typing import Any


class _Dask:
    """Entry of xarray's cache for Dask: its array type once `dask.array` is imported."""

    @property
    def type(self) -> tuple[type, ...]:
        """Types of Dask's arrays that may exist in this process."""
        array = getattr(sys.modules.get("dask.array"), "Array", None)
        return () if array is None else (array,)

    def __getattr__(self, name: str) -> Any:
        """Module, version and availability, as xarray finds them by importing Dask."""
        from xarray.namedarray.pycompat import DuckArrayModule

        return getattr(DuckArrayModule("dask"), name)


@cache
def defer_dask() -> None:
    """Keep xarray from importing Dask only to see that an array is none of its arrays.

    xarray does so for the first array of a process, wherever Dask is installed.
    """
    from xarray.namedarray import pycompat, utils

    pycompat._cached_duck_array_modules.setdefault("dask", _Dask())  # pyright: ignore
    ask = utils.is_dask_collection

    def is_dask_collection(x: object) -> bool:
        return "dask.base" in sys.modules and ask(x)

    utils.is_dask_collection = is_dask_collection  # pyright: ignore
