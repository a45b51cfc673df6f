"""Films on disk: a Zarr 3 group that grows by work items, each written once and checked.

A tile of pixels is a shard of the array `transient`, one file, in which blocks of bins can be read
alone; every block has a CRC-32C. While a film is incomplete, receipts beside it say which tiles are
there, with the CRC-32C of their files; at the end the metadata are consolidated, all files are
listed, and the film moves out of the folder that holds both.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..labels import FILM as RENDERED
from ..runtime import atomic, checks
from ..runtime.progress import status
from .dataset import DIMS, ERRORS, for_file, of_intensity, plain_attributes
from .films_on_disk import checksum, list_files, load_zarr, require_whole, require_zarr
from .job import WorkItem, WorkResult
from .labels import TIME, labels_of
from .tiling import tile_size

if TYPE_CHECKING:
    import xarray as xr

SUFFIX = ".zarr"
FILM, RECEIPTS, PLAN = "film.zarr", "receipts", "plan.json"
BLOCK_BYTES = 4 << 20  # Most bytes of a block that is read and checked by itself


@dataclass
class Receipt:
    """Checksums and sums of a tile on disk."""

    files: dict[str, int]  # CRC-32C of each file, by its name
    steady: float  # sum of all values
    transient: float  # sum of all values
    not_finite: int  # contributions that were left out
    seconds: float  # time that it took [s]


class Store:
    """A film on disk that is being rendered, begun by `Store.begin`."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.film, self.plan = folder, folder / FILM, self.planned(folder)
        self.shape, self.tile = tuple(self.plan["shape"]), tuple(self.plan["tile"])
        group = self._group()
        self._arrays = {name: group[name] for name in DIMS | ERRORS if name in group}

    @classmethod
    def begin(
        cls,
        folder: Path,
        plan: Mapping[str, object],
        shape: tuple[int, int, int, int],
        tile: tuple[int, int],
        errors: bool = False,
    ) -> Store:
        """Go on with a film, or begin one."""
        plan = json.loads(json.dumps(dict(plan) | {"shape": shape, "tile": tile, "errors": errors}))
        found = cls.planned(folder)
        if found:
            require_whole(folder / FILM, listed=False)
            for name, value in plan.items():
                if found.get(name) != value:
                    raise ValueError(
                        f"{folder}: was begun with {name} = {found.get(name)!r}; must be "
                        f"{value!r}, or the folder removed"
                    )
        else:
            _create(folder, shape, tile, errors)
            with atomic.replacing(folder / RECEIPTS / PLAN) as file:
                file.write_text(json.dumps(plan))
        return cls(folder)

    @staticmethod
    def planned(folder: Path) -> dict[str, Any]:
        """Recipe of a film that was begun, empty if there is none."""
        try:
            return dict(json.loads((folder / RECEIPTS / PLAN).read_text()))
        except (OSError, ValueError, TypeError):
            return {}

    def _group(self) -> Any:
        return require_zarr().open_group(self.film, mode="r+", zarr_format=3)

    def write(self, item: WorkItem, result: WorkResult) -> Receipt:
        """Write the result of a work item, whole tiles."""
        for name in self._files(item):  # Zarr would read what is damaged before it writes
            (self.film / name).unlink()
        try:
            pixels = np.s_[item.y : item.y + item.height, item.x : item.x + item.width]
            for name, array in result.arrays.items():
                self._arrays[name][pixels] = array
        except OSError as error:
            if error.errno not in atomic.DISK_FULL:
                raise
            raise atomic.disk_full(self.folder, result.arrays["transient"].nbytes) from None
        files = {}
        for name in self._files(item):
            atomic.sync(self.film / name)
            files[name] = checksum(self.film / name)
        steady, transient = (
            float(of_intensity(result.arrays[name]).sum(dtype=np.float64))
            for name in ("steady", "transient")
        )
        receipt = Receipt(files, steady, transient, result.not_finite, result.seconds)
        with atomic.replacing(self._receipt(item)) as file:
            file.write_text(json.dumps(asdict(receipt)))
        return receipt

    def receipt(self, item: WorkItem) -> Receipt | None:
        """The receipt of a work item that is there and undamaged."""
        path = self._receipt(item)
        if not path.exists():
            return None
        try:
            receipt = Receipt(**json.loads(path.read_text()))
            if all(checksum(self.film / name) == crc for name, crc in receipt.files.items()):
                return receipt
        except (OSError, ValueError, TypeError):
            pass
        warnings.warn(f"{path.stem} of {self.folder}: is damaged, rendering it", stacklevel=2)
        return None

    def checkpoint_path(self, item: WorkItem) -> Path:
        """Name of the checkpoint of a work item under way."""
        return self._receipt(item).with_suffix(".npz")

    def _receipt(self, item: WorkItem) -> Path:
        return self.folder / RECEIPTS / f"tile {item.y} {item.x}.json"

    def _files(self, item: WorkItem) -> list[str]:
        """Names of the files that hold a work item; those of zeros alone are not there."""
        rows, columns = self.tile
        names = [
            "/".join([array, "c", str(y), str(x), *("0" for _ in (DIMS | ERRORS)[array][2:])])
            for y in range(item.y // rows, -(-(item.y + item.height) // rows))
            for x in range(item.x // columns, -(-(item.x + item.width) // columns))
            for array in self._arrays
        ]
        return [name for name in names if (self.film / name).exists()]

    def finish(
        self,
        coordinates: Mapping[str, np.ndarray],
        attrs: Mapping[str, object],
        target: Path,
        labels: Mapping[str, Mapping[str, object]] | None = None,
    ) -> None:
        """Write coordinates and attributes, those of variables too, and move the film."""
        group = self._group()
        for name, values in coordinates.items():
            if name == TIME:
                continue
            put_labels(group, name, values, [name])
        for name, array in group.arrays():
            array.attrs.update(labels_of(name, attrs) | dict((labels or {}).get(name, {})))
        group.attrs.update(dict(attrs))
        put_in_place(self.film, target)
        atomic.remove(self.folder)


def put_labels(group: Any, name: str, values: np.ndarray, axes: list[str]) -> None:
    """Write a small array, of numbers or text, in place of one that is there."""
    text = values.dtype.kind == "U"
    array = group.create_array(
        name,
        shape=values.shape,
        dtype=str if text else values.dtype,
        dimension_names=axes,
        overwrite=True,
    )
    array[:] = values.astype(object) if text else values


def put_in_place(folder: Path, target: Path, arrays: Iterable[str] = DIMS | ERRORS) -> None:
    """Consolidate the metadata of a group that is complete, and move it to its place.

    All files are listed, so that one that is missing is found; see `list_files` for `arrays`.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
        require_zarr().consolidate_metadata(folder)
    list_files(folder, arrays)
    atomic.sync(folder)
    os.rename(folder, target)
    atomic.sync(target.parent, deep=False)


@status("Writing Zarr")
def save_zarr(dataset: Annotated[xr.Dataset, RENDERED], path: str | os.PathLike[str]) -> xr.Dataset:
    """Write a Dataset of `render` as a film on disk, tile by tile.

    See also `load_zarr`.

    Args:
        dataset: The Dataset, in memory or on disk.
        path: Name of a new folder that ends in .zarr; it appears whole.

    Returns:
        The film as `load_zarr` opens it.

    Raises:
        ValueError: Not such a Dataset, or not such a name; one line.
        FileExistsError: The folder exists; one line.
        ImportError: The packages zarr and dask are missing; one line.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=50, bin_width_opl=0.2)
        >>> film = save_zarr(tofrender.render(scene, spp=4), tempfile.mkdtemp() + "/box.zarr")
        >>> film.sizes["opl"]
        50
    """
    dataset = for_file(dataset)
    target = check_film(path, "path")
    shape: Any = dataset["transient"].shape
    rows, columns = tile = tile_size(shape)
    errors = "transient_error" in dataset
    with atomic.locked(target):
        folder = under_way(target)
        if Store.planned(folder):
            what = f"{folder} is of a stopped render"
            raise FileExistsError(f"path = {path}: {what}; must be another, or remove that")
        atomic.remove(folder)
        store = Store.begin(folder, {}, shape, tile, errors)
        for y in range(0, shape[0], rows):
            for x in range(0, shape[1], columns):
                part = dataset.isel(y=slice(y, y + rows), x=slice(x, x + columns))
                arrays = {str(name): part[name].values for name in part.data_vars}
                item = WorkItem(y, x, part.sizes["y"], part.sizes["x"], 0, 1)
                store.write(item, WorkResult(arrays, 1))
        coordinates = {axis: dataset[axis].values for axis in DIMS["transient"]}
        labels = {str(name): plain_attributes(each) for name, each in dataset.variables.items()}
        store.finish(coordinates, plain_attributes(dataset), target, labels)
    return load_zarr(target)


def check_film(out: object, name: str = "out") -> Path:
    """Refuse a name that a film cannot stream to."""
    target = checks.path(name, out)
    if target.suffix != SUFFIX:
        raise ValueError(f"{name} = {out}: must be the name of a folder that ends in {SUFFIX}")
    if os.path.lexists(target):
        raise FileExistsError(f"{name} = {out}: exists; must be a new folder")
    atomic.check_writable(target)
    return target


def under_way(out: str | os.PathLike[str]) -> Path:
    """Folder of a film that streams to `out`, until it is finished."""
    return atomic.sibling(out, ".film")


def _create(
    folder: Path, shape: tuple[int, int, int, int], tile: tuple[int, int], errors: bool
) -> None:
    """Make an empty film."""
    atomic.remove(folder)
    zarr = require_zarr()
    from zarr.codecs import Crc32cCodec

    height, width, bins, channels = shape
    rows, columns = tile
    block = max(1, min(bins, BLOCK_BYTES // (4 * rows * columns * channels)))
    along = -(-bins // block) * block
    group = zarr.open_group(folder / FILM, mode="w", zarr_format=3)
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
    (folder / RECEIPTS).mkdir()
