"""Reading of films on disk: Zarr 3 groups that `render(out=...)` has written."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from .dataset import DIMS, ERRORS, in_components
from .labels import labeled

if TYPE_CHECKING:
    import xarray as xr

# List of all files of a film, with sizes and checksums. Zarr reads missing files as zeros
FILES = "files.json"

# Number of bytes that are read together to compute a checksum
READ_BYTES = 1 << 24

# Supported codecs. Other codecs, for example numcodecs.pickle, may run code from the file
CODECS = {
    "bytes",
    "vlen-utf8",
    "vlen-bytes",
    "transpose",
    "sharding_indexed",
    "crc32c",
    "zstd",
    "gzip",
    "blosc",
}

# Largest number of values of an axis. Axes are read when a film is opened
MOST_LABELS = 1 << 22

# Largest number of blocks of an array. Each block needs memory when a film is opened
MOST_BLOCKS = 1 << 22

# Largest number of values of a block. Blocks are read as a whole
MOST_BLOCK_VALUES = 1 << 30


def require_zarr() -> Any:
    """Return the package zarr.

    Raises:
        ImportError: The package is not installed.
    """
    try:
        import zarr
    except ImportError:
        raise ImportError(
            "films on disk need zarr and dask: pip install 'tofrender[cluster]'"
        ) from None
    return zarr


def is_film(path: str | os.PathLike) -> bool:
    """Return whether a folder is a finished film on disk."""
    folder = Path(path)
    return (folder / "zarr.json").is_file() and (folder / FILES).is_file()


def load_zarr(path: str | os.PathLike) -> xr.Dataset:
    """Open a film that `render(out=...)` has written. The values are not read yet.

    See also `save_zarr`.

    Args:
        path: The folder.

    Returns:
        A Dataset as `render` returns it. Its variables are Dask arrays, which read their values
        from disk when they are used. Reading a damaged block raises an OSError that names the
        folder. All functions of this package read the film in pieces.

    Raises:
        FileNotFoundError: `path` does not exist.
        ValueError: The folder is not a finished film of this package, or files are missing or
            incomplete.
        ImportError: The packages zarr and dask are missing.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=50, bin_width_opl=0.2)
        >>> film = tofrender.render(scene, spp=4, out=tempfile.mkdtemp() + "/box.zarr")
        >>> tofrender.load_zarr(film.encoding["source"]).sizes["opl"]
        50
    """
    import xarray as xr

    # Is the folder a complete film?
    folder = checks.path("path", path)
    if not folder.exists():
        raise FileNotFoundError(f"path = {path}: does not exist; must be a film on disk")
    require_zarr()
    if not is_film(folder):
        raise ValueError(f"path = {path}: must be a finished film that `render` wrote")
    require_whole(folder)

    # Open the film
    try:
        dataset = xr.open_zarr(folder, chunks={}, consolidated=True, zarr_format=3)
        dataset = dataset.assign_coords(channel=list(map(str, dataset["channel"].values)))
        missing = set(DIMS) - set(dataset.data_vars)
        if missing or "start_opl" not in dataset.attrs:
            raise ValueError
        dataset = naming_files(dataset, folder, "film")
    except (OSError, RuntimeError, ValueError, KeyError, TypeError):
        raise ValueError(f"path = {path}: must be a finished film that `render` wrote") from None
    dataset = in_components(labeled(dataset))
    dataset.encoding["source"] = str(folder)
    return dataset


def list_files(film: Path, arrays: Iterable[str] = DIMS | ERRORS) -> None:
    """Write the list of the files of a finished film.

    Tiles of zeros are not stored. Each block of the large `arrays` contains a checksum already, so
    the list contains checksums of the other files only.
    """
    own = tuple(f"{name}/c/" for name in arrays)
    files = {}
    for file in sorted(each for each in film.rglob("*") if each.is_file()):
        name = file.relative_to(film).as_posix()
        crc = None if name.startswith(own) else checksum(file)
        files[name] = file.stat().st_size, crc
    (film / FILES).write_text(json.dumps(files))


def require_whole(film: Path, listed: bool = True) -> None:
    """Raise a ValueError if a film has unsupported codecs, large arrays or damaged files.

    Args:
        film: Folder of a Zarr group.
        listed: Whether the group has a list of its files.
    """
    # Check the metadata of the group and of each array
    for file in (film / "zarr.json", *sorted(film.glob("*/zarr.json"))):
        place = file.relative_to(film)
        try:
            nodes = list(_nodes(json.loads(file.read_text()), file.parent.name))
            wrong = sorted({codec for _, node in nodes for codec in _codecs(node)} - CODECS)
            too_large = [text for name, node in nodes for text in _too_large(name, node)]
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            raise ValueError(
                f"path = {film}: {place} is damaged. Restore it, or render again"
            ) from None
        if wrong:
            raise ValueError(
                f"path = {film}: {place} has the codec {checks.quote(wrong[0])}; "
                f"must be one of {', '.join(sorted(CODECS))}"
            )
        if too_large:
            raise ValueError(f"path = {film}: {place}: {too_large[0]}")

    # Compare the files with the list
    if not listed:
        return
    try:
        files = json.loads((film / FILES).read_text())
        wrong = [name for name, known in files.items() if not _is_whole(film / name, *known)]
    except (OSError, ValueError, TypeError, AttributeError):
        files = [FILES]
        wrong = [FILES]
    if wrong:
        raise ValueError(
            f"path = {film}: {len(wrong)} of {len(files)} files are missing, cut or damaged, the "
            f"first is {wrong[0]}; must be as they were written, copy it or make it again"
        )


def _nodes(metadata: Any, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the name and the metadata of a node and of all nodes inside, without user attributes.

    Nodes are groups and arrays.
    """
    # Remove the key only from nodes, because an array may have the name "attributes"
    known = ("attributes", "consolidated_metadata")
    yield name, {key: value for key, value in metadata.items() if key not in known}
    within = metadata.get("consolidated_metadata") or {}
    for inner, node in (within.get("metadata") or {}).items():
        yield from _nodes(node, inner)


def _codecs(metadata: object) -> set[str]:
    """Return the names of all codecs in metadata, including nested codecs."""
    if isinstance(metadata, list):
        return set().union(*map(_codecs, metadata))
    if not isinstance(metadata, dict):
        return set()
    found = _codecs(list(metadata.values()))
    for name in ("codecs", "index_codecs", "storage_transformers", "compressor", "filters"):
        for each in metadata.get(name) or ():
            found.add(str(each.get("name") if isinstance(each, dict) else each))
    return found


def _too_large(name: str, node: Mapping[str, Any]) -> Iterator[str]:
    """Yield a description of each size that would need gigabytes of memory."""
    if node["node_type"] != "array":
        return

    # Find the sizes of the array and of its blocks, which may be inside shards
    shape = [int(side) for side in node["shape"]]
    blocks = [int(side) for side in node["chunk_grid"]["configuration"]["chunk_shape"]]
    for codec in node["codecs"]:
        if codec["name"] == "sharding_indexed":
            blocks = [int(side) for side in codec["configuration"]["chunk_shape"]]
    if len(blocks) != len(shape) or min(shape, default=0) < 0 or min(blocks, default=1) < 1:
        raise ValueError

    # Compare with the limits
    if len(shape) == 1 and shape[0] > MOST_LABELS:
        yield f"{name} has {shape[0]} values; must have at most {MOST_LABELS}"
    count = math.prod(-(-side // block) for side, block in zip(shape, blocks, strict=True))
    if count > MOST_BLOCKS:
        yield f"{name} has {count} blocks; must have at most {MOST_BLOCKS}"
    values = math.prod(blocks)
    if values > MOST_BLOCK_VALUES:
        yield f"{name} has blocks of {values} values; must be at most {MOST_BLOCK_VALUES}"


def _is_whole(file: Path, size: int, crc: int | None) -> bool:
    """Return whether a file exists and has the given size and, unless None, the given CRC-32C."""
    try:
        return file.stat().st_size == size and (crc is None or checksum(file) == crc)
    except OSError:
        return False


def checksum(path: Path) -> int:
    """Return the CRC-32C of a file. Processors compute this checksum with one instruction."""
    # A dependency of zarr
    import google_crc32c

    value = 0
    with open(path, "rb") as file:
        while part := file.read(READ_BYTES):
            value = google_crc32c.extend(value, part)
    return value


def naming_files(dataset: xr.Dataset, folder: Path, what: str) -> xr.Dataset:
    """Replace the variables of a Dataset by Dask arrays that name damaged files in errors.

    Args:
        dataset: Dataset of a Zarr group.
        folder: Folder of the group.
        what: Noun for the group, for messages.
    """
    import dask.array

    group = require_zarr().open_group(folder, mode="r", zarr_format=3)
    for name, variable in dataset.data_vars.items():
        if variable.dtype.kind in "fiub":
            array: Any = group[str(name)]
            checked = _Checked(array, f"{what} {folder}")
            data = dask.array.from_array(checked, chunks=array.chunks, name=False)
            dataset[name] = variable.copy(data=data)
    return dataset


class _Checked:
    """Array on disk. If a block cannot be read, the error names its file.

    Args:
        array: The Zarr array.
        owner: Noun and path of the group, for messages.
    """

    def __init__(self, array: Any, owner: str) -> None:
        self._array = array
        self._owner = owner
        self.shape = array.shape
        self.dtype = array.dtype
        self.ndim = array.ndim

    def __getitem__(self, index: Any) -> np.ndarray:
        try:
            return self._array[index]
        except (OSError, RuntimeError, ValueError) as error:
            # Find the file of the first value
            reason = str(error).split(". ")[0].splitlines()[0]
            sizes = self._array.shards or self._array.chunks
            starts = (int(getattr(each, "start", each) or 0) for each in index)
            place = "/".join(str(start // n) for start, n in zip(starts, sizes, strict=False))
            raise OSError(
                f"{self._owner}: {self._array.basename}/c/{place} is damaged or cannot be read "
                f"({reason}); must be copied or rendered again"
            ) from None
