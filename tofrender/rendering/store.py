"""Films on disk: a Zarr 3 group that grows by pieces, each written once and checked.

A tile of pixels is a shard of the array `transient`, one file, in which blocks of bins can be read
alone; every block has a CRC-32C. While a film is incomplete, a folder of receipts says which tiles
are there, with the CRC-32 of their files; at the end the metadata are consolidated and the receipts
go.
"""

from __future__ import annotations

import json
import os
import warnings
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..runtime import atomic, checks
from .dataset import DIMS
from .pieces import Piece, Taken

RECEIPTS, PLAN = ".receipts", "plan.json"
BLOCK_BYTES = 4 << 20
"""Most bytes of a block that is read and checked by itself."""

READ_BYTES = 1 << 24


@dataclass
class Receipt:
    """What is known of a tile on disk.

    Attributes:
        files: CRC-32 of each file, by its name.
        steady, transient: Sums of all values.
        not_finite: Contributions that were left out.
        seconds: Time that it took [s].
    """

    files: dict[str, int]
    steady: float
    transient: float
    not_finite: int
    seconds: float


class Store:
    """A film on disk that is being rendered, begun by `Store.begin`.

    Args:
        folder: Where it is.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.plan = folder, self.planned(folder)
        self.shape, self.tile = tuple(self.plan["shape"]), tuple(self.plan["tile"])
        self._transient, self._steady = (self._group()[name] for name in DIMS)

    @classmethod
    def begin(
        cls,
        folder: Path,
        plan: Mapping[str, Any],
        shape: tuple[int, int, int, int],
        tile: tuple[int, int],
    ) -> Store:
        """Go on with a film, or begin one.

        Args:
            folder: Where it is, made if it is not there.
            plan: All that it depends on, as JSON can hold it.
            shape: (height, width, temporal_bins, channels).
            tile: Rows and columns of a tile.

        Raises:
            ValueError: The folder is of another render; one line that names what differs.
            ImportError: The package zarr is missing; one line.
        """
        plan = json.loads(json.dumps(dict(plan) | {"shape": shape, "tile": tile}))
        found = cls.planned(folder)
        if found:
            for name, value in plan.items():
                if found.get(name) != value:
                    raise ValueError(
                        f"{folder}: was begun with {name} = {found.get(name)!r}; must be "
                        f"{value!r}, or the folder removed"
                    )
        else:
            _create(folder, shape, tile)
            with atomic.replacing(folder / RECEIPTS / PLAN) as file:
                file.write_text(json.dumps(plan))
        return cls(folder)

    @staticmethod
    def planned(folder: Path) -> dict[str, Any]:
        """What a film that was begun is of; nothing if there is none."""
        try:
            return dict(json.loads((folder / RECEIPTS / PLAN).read_text()))
        except (OSError, ValueError, TypeError):
            return {}

    def _group(self) -> Any:
        return require_zarr().open_group(self.folder, mode="r+", zarr_format=3)

    # ------------------------------------------------------------------------------- pieces

    def put(self, piece: Piece, taken: Taken) -> Receipt:
        """Write a piece that is finished, whole tiles.

        Raises:
            OSError: There is no room; one line. What was written before stays.
        """
        place = np.s_[piece.y : piece.y + piece.height, piece.x : piece.x + piece.width]
        try:
            self._transient[place] = taken.transient
            self._steady[place] = taken.steady
        except OSError as error:
            if error.errno not in atomic.DISK_FULL:
                raise
            raise atomic.disk_full(self.folder, taken.transient.nbytes) from None
        files = {}
        for name in self._files(piece):
            atomic.to_disk(self.folder / name)
            files[name] = checksum(self.folder / name)
        receipt = Receipt(
            files,
            float(taken.steady.sum(dtype=np.float64)),
            float(taken.transient.sum(dtype=np.float64)),
            taken.not_finite,
            taken.seconds,
        )
        with atomic.replacing(self._receipt(piece)) as file:
            file.write_text(json.dumps(asdict(receipt)))
        return receipt

    def receipt(self, piece: Piece) -> Receipt | None:
        """The receipt of a piece that is there and undamaged.

        Warns:
            UserWarning: It is damaged.
        """
        path = self._receipt(piece)
        if not path.exists():
            return None
        try:
            receipt = Receipt(**json.loads(path.read_text()))
            whole = all(checksum(self.folder / n) == crc for n, crc in receipt.files.items())
        except (OSError, ValueError, TypeError):
            whole, receipt = False, None
        if not whole:
            warnings.warn(f"{path.stem} of {self.folder}: is damaged, rendering it", stacklevel=2)
            return None
        return receipt

    def checkpoint_path(self, piece: Piece) -> Path:
        """Where the checkpoint of a piece under way goes."""
        return self._receipt(piece).with_suffix(".npz")

    def _receipt(self, piece: Piece) -> Path:
        return self.folder / RECEIPTS / f"tile {piece.y} {piece.x}.json"

    def _files(self, piece: Piece) -> list[str]:
        """Names of the files that hold a piece; one that would hold zeros alone is not there."""
        rows, columns = self.tile
        tiles = [
            (y // rows, x // columns)
            for y in range(piece.y, piece.y + piece.height, rows)
            for x in range(piece.x, piece.x + piece.width, columns)
        ]
        names = [
            f"{array}/c/{y}/{x}/{rest}"
            for y, x in tiles
            for array, rest in (("transient", "0/0"), ("steady", "0"))
        ]
        return [name for name in names if (self.folder / name).exists()]

    # ---------------------------------------------------------------------------- the end

    def finish(self, coordinates: Mapping[str, np.ndarray], attrs: Mapping[str, Any]) -> None:
        """Write coordinates and attributes, and what makes the folder a finished film."""
        group = self._group()
        for name, values in coordinates.items():
            text = values.dtype.kind == "U"
            array = group.create_array(
                name,
                shape=values.shape,
                dtype=str if text else values.dtype,
                dimension_names=[name],
                overwrite=True,
            )
            array[:] = values.astype(object) if text else values
        group["opl"].attrs.update({"units": "m", "long_name": "optical path length"})
        group.attrs.update(dict(attrs))
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Consolidated metadata is currently not part")
            require_zarr().consolidate_metadata(self.folder)
        atomic.remove(self.folder / RECEIPTS)
        atomic.to_disk(self.folder)


def _create(folder: Path, shape: tuple[int, int, int, int], tile: tuple[int, int]) -> None:
    """Make an empty film."""
    atomic.remove(folder)
    zarr = require_zarr()
    from zarr.codecs import Crc32cCodec

    height, width, bins, channels = shape
    rows, columns = tile
    block = max(1, min(bins, BLOCK_BYTES // (4 * rows * columns * channels)))
    along = -(-bins // block) * block
    group = zarr.open_group(folder, mode="w", zarr_format=3)
    common: dict[str, Any] = {
        "dtype": "float32",
        "compressors": [Crc32cCodec()],
        "fill_value": 0.0,
    }
    group.create_array(
        "transient",
        shape=shape,
        chunks=(rows, columns, block, channels),
        shards=(rows, columns, along, channels),
        dimension_names=DIMS["transient"],
        **common,
    )
    group.create_array(
        "steady",
        shape=(height, width, channels),
        chunks=(rows, columns, channels),
        dimension_names=DIMS["steady"],
        **common,
    )
    (folder / RECEIPTS).mkdir()


def require_zarr() -> Any:
    """The package zarr.

    Raises:
        ImportError: It is missing; one line that says how to get it.
    """
    try:
        import zarr
    except ImportError:
        raise ImportError(
            "films on disk need zarr and dask: pip install 'tofrender[cluster]'"
        ) from None
    return zarr


def checksum(path: Path) -> int:
    """CRC-32 of a file."""
    value = 0
    with open(path, "rb") as file:
        while part := file.read(READ_BYTES):
            value = zlib.crc32(part, value)
    return value


def is_film(path: str | os.PathLike) -> bool:
    """Whether a folder is a finished film on disk."""
    folder = Path(path)
    return (folder / "zarr.json").is_file() and not (folder / RECEIPTS).exists()


def load_zarr(path: str | os.PathLike) -> Any:
    """Open a film that `render(out=...)` has written, without reading it.

    Args:
        path: The folder.

    Returns:
        A Dataset as `render` returns it, whose variables are read from disk when they are used
        (dask arrays), which raises an OSError that names the folder where a block is damaged. All
        functions of this package read it by pieces.

    Raises:
        FileNotFoundError: There is nothing at `path`.
        ValueError: It is not a finished film of this package; one line.
        ImportError: The packages zarr and dask are missing; one line.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=50, bin_width_opl=0.2)
        >>> film = tofrender.render(scene, spp=4, out=tempfile.mkdtemp() + "/box.zarr")
        >>> tofrender.load_zarr(film.encoding["source"]).sizes["opl"]
        50
    """
    import xarray as xr

    folder = checks.path("path", path)
    if not folder.exists():
        raise FileNotFoundError(f"path = {path}: does not exist; must be a film on disk")
    zarr = require_zarr()
    if not is_film(folder):
        raise ValueError(f"path = {path}: must be a finished film that `render` wrote")
    try:
        dataset = xr.open_zarr(folder, chunks={}, consolidated=True)
        dataset = dataset.assign_coords(channel=list(map(str, dataset["channel"].values)))
        missing = set(DIMS) - set(dataset.data_vars)
        if missing or "start_opl" not in dataset.attrs:
            raise ValueError
        group = zarr.open_group(folder, mode="r")
        for name in DIMS:
            dataset[name] = dataset[name].copy(data=_checked(group[name], folder))
    except (OSError, ValueError, KeyError, TypeError):
        raise ValueError(f"path = {path}: must be a finished film that `render` wrote") from None
    dataset.encoding["source"] = str(folder)
    return dataset


def _checked(array: Any, folder: Path) -> Any:
    """A dask array of an array on disk, which says what film a damaged block is of."""
    import dask.array

    return dask.array.from_array(_Checked(array, folder), chunks=array.chunks, name=False)


class _Checked:
    """An array on disk that names its film where a block cannot be read."""

    def __init__(self, array: Any, folder: Path) -> None:
        self._array, self._folder = array, folder
        self.shape, self.dtype, self.ndim = array.shape, array.dtype, array.ndim

    def __getitem__(self, index: Any) -> np.ndarray:
        try:
            return self._array[index]
        except (OSError, RuntimeError, ValueError) as error:
            reason = str(error).split(". ")[0].splitlines()[0]
            raise OSError(
                f"film {self._folder}: {self._array.basename} is damaged or cannot be read "
                f"({reason}); must be copied or rendered again"
            ) from None
