"""Films on disk: Zarr 3 groups that grow by work items, see `GroupStore`.

A tile of pixels is a shard of the array `transient`. A shard is one file. It consists of blocks of
bins that can be read separately. Each block has a CRC-32C.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..labels import FILM as RENDERED
from ..runtime import atomic, checks
from ..runtime.progress import status
from .dataset import DIMS, ERRORS, for_file, of_intensity, plain_attributes
from .films_on_disk import load_zarr, require_zarr
from .group_store import BLOCK_BYTES, GroupStore, PartReceipt, put_labels
from .job import WorkItem, WorkResult
from .labels import TIME, labels_of
from .tiling import tile_size

if TYPE_CHECKING:
    import xarray as xr

# Suffix of a film's folder
SUFFIX = ".zarr"


@dataclass(kw_only=True)
class TileReceipt(PartReceipt):
    """Checksums and sums of a tile on disk."""

    # Sums of the intensity of the two variables
    steady: float
    transient: float

    # Number of ignored contributions, which were NaN or infinite
    not_finite: int

    # Duration of the render [s]
    seconds: float


class StoredFilm(GroupStore[WorkItem, TileReceipt]):
    """Unfinished film on disk, made by `StoredFilm.begin`."""

    group_name = "film.zarr"
    what = "film"
    receipt_class = TileReceipt

    @classmethod
    def begin(
        cls,
        folder: Path,
        recipe: Mapping[str, object],
        shape: tuple[int, int, int, int],
        tile: tuple[int, int],
        errors: bool = False,
    ) -> StoredFilm:
        """Continue with an unfinished film, or make an empty film.

        Args:
            folder: Folder of the film and its receipts.
            recipe: Values that determine the film.
            shape: Shape of the film, (height, width, temporal_bins, channels).
            tile: Rows and columns of a tile.
            errors: Whether the film has standard errors.
        """
        recipe = dict(recipe) | {"shape": shape, "tile": tile, "errors": errors}
        create = partial(_create_arrays, shape=shape, tile=tile, errors=errors)
        return cls.continued(folder, recipe, create)

    @property
    def tile(self) -> tuple[int, int]:
        """Number of rows and columns of a tile."""
        rows, columns = self.recipe["tile"]
        return rows, columns

    def _open_arrays(self) -> dict[str, Any]:
        """Return the arrays of the film, by name."""
        return {name: self.group[name] for name in DIMS | ERRORS if name in self.group}

    def name_of(self, part: WorkItem) -> str:
        """Return the name of a work item."""
        return f"tile {part.y} {part.x}"

    def _indices(self, part: WorkItem) -> Any:
        """Return the slices of rows and columns that select a work item in each array."""
        return np.s_[part.y : part.y + part.height, part.x : part.x + part.width]

    def _file_names(self, part: WorkItem) -> list[str]:
        """Return the names of all files that contain the pixels of a work item.

        Each array has one file for each tile. A file that contains only zeros may be missing on the
        disk.
        """
        rows, columns = self.tile
        return [
            "/".join([array, "c", str(y), str(x), *("0" for _ in (DIMS | ERRORS)[array][2:])])
            for y in range(part.y // rows, -(-(part.y + part.height) // rows))
            for x in range(part.x // columns, -(-(part.x + part.width) // columns))
            for array in self.arrays
        ]

    def write(self, item: WorkItem, result: WorkResult) -> TileReceipt:
        """Write the result of a work item that consists of whole tiles."""
        # The sums of the intensity give the energy outside the window
        steady, transient = (
            float(of_intensity(result.arrays[name]).sum(dtype=np.float64))
            for name in ("steady", "transient")
        )
        receipt = TileReceipt(
            steady=steady,
            transient=transient,
            not_finite=result.not_finite,
            seconds=result.seconds,
        )
        return self.write_part(item, result.arrays, receipt)

    def checkpoint_path(self, item: WorkItem) -> Path:
        """Return the path of the checkpoint of an unfinished work item."""
        return self.receipt_path(item).with_suffix(".npz")

    def finish(
        self,
        coordinates: Mapping[str, np.ndarray],
        attrs: Mapping[str, object],
        target: Path,
        labels: Mapping[str, Mapping[str, object]] | None = None,
    ) -> None:
        """Write coordinates and attributes, and move the film to its place.

        Args:
            coordinates: Coordinates of the Dataset, by name.
            attrs: Attributes of the Dataset.
            target: Path of the film.
            labels: Attributes of variables, by the name of the variable.
        """
        group = require_zarr().open_group(self.group_path, mode="r+", zarr_format=3)
        for name, values in coordinates.items():
            if name != TIME:
                put_labels(group, name, values, [name])
        for name, array in group.arrays():
            array.attrs.update(labels_of(name, attrs) | dict((labels or {}).get(name, {})))
        group.attrs.update(dict(attrs))
        self.move_to(target, DIMS | ERRORS)


@status("Writing Zarr")
def save_zarr(dataset: Annotated[xr.Dataset, RENDERED], path: str | os.PathLike[str]) -> xr.Dataset:
    """Write a result of `render` as a film on disk, tile by tile.

    See also `load_zarr`.

    Args:
        dataset: The Dataset, in memory or on disk.
        path: Name of a new folder that ends in .zarr. The folder appears when the film is complete.

    Returns:
        The film as `load_zarr` opens it.

    Raises:
        ValueError: The Dataset is not a result of `render`, or the name is wrong.
        FileExistsError: The folder exists.
        ImportError: The packages zarr and dask are missing.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=50, bin_width_opl=0.2)
        >>> film = save_zarr(tofrender.render(scene, spp=4), tempfile.mkdtemp() + "/box.zarr")
        >>> film.sizes["opl"]
        50
    """
    # Check the Dataset and the path
    dataset = for_file(dataset)
    target = check_film(path, "path")
    shape: Any = dataset["transient"].shape
    rows, columns = tile = tile_size(shape)
    errors = "transient_error" in dataset
    with atomic.locked(target):
        # Does an unfinished render use the folder?
        folder = under_way(target)
        if StoredFilm.planned(folder):
            what = f"{folder} is of a stopped render"
            raise FileExistsError(f"path = {path}: {what}; must be another, or remove that")

        # Write the tiles
        atomic.remove(folder)
        store = StoredFilm.begin(folder, {}, shape, tile, errors)
        for y in range(0, shape[0], rows):
            for x in range(0, shape[1], columns):
                part = dataset.isel(y=slice(y, y + rows), x=slice(x, x + columns))
                arrays = {str(name): part[name].values for name in part.data_vars}
                item = WorkItem(
                    y=y,
                    x=x,
                    height=part.sizes["y"],
                    width=part.sizes["x"],
                    first=0,
                    count=1,
                )
                store.write(item, WorkResult(arrays, 1))

        # Write the coordinates and the attributes
        coordinates = {axis: dataset[axis].values for axis in DIMS["transient"]}
        labels = {str(name): plain_attributes(each) for name, each in dataset.variables.items()}
        store.finish(coordinates, plain_attributes(dataset), target, labels)
    return load_zarr(target)


def check_film(out: object, name: str = "out") -> Path:
    """Return the path of a new film.

    Args:
        out: Name of the folder.
        name: Name of the argument, for messages.

    Raises:
        ValueError: The name does not end in .zarr.
        FileExistsError: The folder exists.
    """
    target = checks.path(name, out)
    if target.suffix != SUFFIX:
        raise ValueError(f"{name} = {out}: must be the name of a folder that ends in {SUFFIX}")
    if os.path.lexists(target):
        raise FileExistsError(f"{name} = {out}: exists; must be a new folder")
    atomic.check_writable(target)
    return target


def under_way(out: str | os.PathLike[str]) -> Path:
    """Return the folder of the film `out` while the film is unfinished."""
    return atomic.sibling(out, ".film")


def _create_arrays(
    group: Any, *, shape: tuple[int, int, int, int], tile: tuple[int, int], errors: bool
) -> None:
    """Create the arrays of an empty film."""
    from zarr.codecs import Crc32cCodec

    height, width, bins, channels = shape
    rows, columns = tile

    # Find the number of bins of a block, and of a shard that consists of whole blocks
    block = max(1, min(bins, BLOCK_BYTES // (4 * rows * columns * channels)))
    along = -(-bins // block) * block

    # Create the arrays
    common: dict[str, Any] = {"dtype": "float32", "compressors": [Crc32cCodec()], "fill_value": 0.0}
    for suffix in ("", "_error") if errors else ("",):
        group.create_array(
            f"transient{suffix}",
            shape=shape,
            chunks=(rows, columns, block, channels),
            shards=(rows, columns, along, channels),
            dimension_names=DIMS["transient"],
            **common,
        )
        group.create_array(
            f"steady{suffix}",
            shape=(height, width, channels),
            chunks=(rows, columns, channels),
            dimension_names=DIMS["steady"],
            **common,
        )
