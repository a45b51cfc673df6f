"""Datasets of arrays in memory without the import of Dask, which is slow.

xarray imports Dask when it creates a Dataset, if Dask is installed. xarray has no option against
it, and libraries for lazy imports change only the imports of their own package. Therefore this
module replaces an entry in xarray's cache of array modules.
"""

import sys
from functools import cache
from typing import Any


class _Dask:
    """Entry for Dask in xarray's cache of array modules, without an import of Dask."""

    @property
    def type(self) -> tuple[type, ...]:
        """Return Dask's array type in a tuple, which is empty until `dask.array` is imported."""
        array = getattr(sys.modules.get("dask.array"), "Array", None)
        return () if array is None else (array,)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of xarray's original entry, which imports Dask."""
        from xarray.namedarray.pycompat import DuckArrayModule

        return getattr(DuckArrayModule("dask"), name)


@cache
def defer_dask() -> None:
    """Prevent xarray from importing Dask to check whether an array is a Dask array.

    If Dask is installed, xarray would import Dask for the first array of a process.
    """
    from xarray.namedarray import pycompat, utils

    # Replace the entry of the cache
    pycompat._cached_duck_array_modules.setdefault("dask", _Dask())  # pyright: ignore

    # Without an import of Dask, no object is a Dask collection
    ask = utils.is_dask_collection

    def is_dask_collection(x: object) -> bool:
        return "dask.base" in sys.modules and ask(x)

    utils.is_dask_collection = is_dask_collection  # pyright: ignore
