"""Reading films from disk: Zarr 3 groups that `render(out=...)` has written."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from .dataset import DIMS, ERRORS, in_components
from .labels import labelled

if TYPE_CHECKING:
    import xarray as xr


FILES = "files.json"
"""What names all files of a film, with sizes and checksums: one that is missing reads as zeros."""

READ_BYTES = 1 << 24


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


def is_film(path: str | os.PathLike) -> bool:
    """Whether a folder is a finished film on disk."""
    folder = Path(path)
    return (folder / "zarr.json").is_file() and (folder / FILES).is_file()


def load_zarr(path: str | os.PathLike) -> xr.Dataset:
    """Open a film that `render(out=...)` has written, without reading it.

    Args:
        path: The folder.

    Returns:
        A Dataset as `render` returns it, whose variables are read from disk when they are used
        (dask arrays), which raises an OSError that names the folder where a block is damaged. All
        functions of this package read it by pieces.

    Raises:
        FileNotFoundError: There is nothing at `path`.
        ValueError: It is not a finished film of this package, or files of it are missing or cut;
            one line.
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
    _require_files(folder)
    try:
        dataset = xr.open_zarr(folder, chunks={}, consolidated=True)
        dataset = dataset.assign_coords(channel=list(map(str, dataset["channel"].values)))
        missing = set(DIMS) - set(dataset.data_vars)
        if missing or "start_opl" not in dataset.attrs:
            raise ValueError
        group = zarr.open_group(folder, mode="r")
        for name in dataset.data_vars:
            dataset[name] = dataset[name].copy(data=_checked(group[name], folder))
    except (OSError, ValueError, KeyError, TypeError):
        raise ValueError(f"path = {path}: must be a finished film that `render` wrote") from None
    dataset = in_components(labelled(dataset))
    dataset.encoding["source"] = str(folder)
    return dataset


def list_files(film: Path) -> None:
    """Write down which files a finished film has; those of tiles that are zero are not there."""
    own = tuple(f"{name}/c/" for name in DIMS | ERRORS)
    files = {}
    for file in sorted(each for each in film.rglob("*") if each.is_file()):
        name = file.relative_to(film).as_posix()
        crc = None if name.startswith(own) else checksum(file)  # Each block of tiles has its own
        files[name] = file.stat().st_size, crc
    (film / FILES).write_text(json.dumps(files))


def _require_files(film: Path) -> None:
    """Refuse a film whose files are not those that were written.

    Raises:
        ValueError: One line that names the first.
    """
    try:
        files = json.loads((film / FILES).read_text())
        wrong = [name for name, known in files.items() if not _is_whole(film / name, *known)]
    except (OSError, ValueError, TypeError, AttributeError):
        files, wrong = [FILES], [FILES]
    if wrong:
        raise ValueError(
            f"path = {film}: {len(wrong)} of {len(files)} files are missing, cut or damaged, the "
            f"first is {wrong[0]}; must be as they were written, copy or render the film again"
        )


def _is_whole(file: Path, size: int, crc: int | None) -> bool:
    """Whether a file is there, of this size and, if it is given, this CRC-32C."""
    try:
        return file.stat().st_size == size and (crc is None or checksum(file) == crc)
    except OSError:
        return False


def checksum(path: Path) -> int:
    """CRC-32C of a file, which processors have an instruction for."""
    import google_crc32c  # zarr has it

    value = 0
    with open(path, "rb") as file:
        while part := file.read(READ_BYTES):
            value = google_crc32c.extend(value, part)
    return value


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
