"""Datasets on disk for tests, read with little memory."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import dask
import dask.local
import numpy as np
import xarray as xr
from dask.core import flatten

from helpers.limits import lower
from tofrender.rendering.job import WorkItem, WorkResult
from tofrender.rendering.stored_film import StoredFilm, load_zarr, under_way


@contextmanager
def at_most(size: int, monkeypatch: Any, free: int | None = None) -> Iterator[list[int]]:
    """Fail what reads more than `size` bytes at once; yield how many were.

    So many bytes, or `free` ones, are what the machine's memory seems to have left.
    """
    sizes: list[int] = []

    def get(graph: Any, keys: Any, **options: Any) -> Any:
        found = dask.local.get_sync(graph, keys, **options)
        sizes.append(sum(array.nbytes for array in flatten(found, (list, tuple))))
        assert sizes[-1] <= size, f"{sizes[-1]} bytes at once, {size} are allowed"
        return found

    with monkeypatch.context() as patch, dask.config.set(scheduler=get):
        lower(
            patch,
            piece_bytes=size,
            memory_share=1 if free is None else free // size,
            free_memory=size if free is None else free,
        )
        yield sizes


def write_film(folder: Path, dataset: xr.Dataset, tile: tuple[int, int]) -> xr.Dataset:
    """Write a Dataset as `render(out=...)` does, in tiles of so many rows and columns."""
    store = StoredFilm.begin(under_way(folder), {"of": "a test"}, dataset["transient"].shape, tile)
    height, width = dataset["steady"].shape[:2]
    rows, columns = tile
    for y in range(0, height, rows):
        for x in range(0, width, columns):
            part = dataset.isel(y=slice(y, y + rows), x=slice(x, x + columns))
            arrays = {name: part[name].values for name in ("transient", "steady")}
            item = WorkItem(y, x, *arrays["steady"].shape[:2], 0, 1)
            store.write(item, WorkResult(arrays, 1))
    coordinates = {str(axis): np.asarray(dataset[axis].values) for axis in dataset.coords}
    store.finish(coordinates, dataset.attrs, folder)
    return load_zarr(folder)
