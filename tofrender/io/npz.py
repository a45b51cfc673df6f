"""Datasets as NumPy archives without pickles."""

import json
import os
from pathlib import Path
from typing import Annotated, Any
from zipfile import ZipFile

import numpy as np
import xarray as xr
from numpy.lib import format as npy

from ..labels import FILM
from ..rendering.cubes import Cube
from ..rendering.dataset import ERRORS, HALVES, for_file, require_finite
from ..runtime.archives import read_array
from ..runtime.atomic import replacing
from ..runtime.progress import status
from .description import describe, parse, restore, shapes_of, warn_not_finite
from .files import reading
from .output import check_output, stack_bytes

_ARRAYS = ("transient", "steady", "y", "x", "opl")


@status("Writing NPZ")
def save_npz(
    dataset: Annotated[xr.Dataset, FILM], path: str | os.PathLike, *, overwrite: bool = False
) -> Path:
    """Write a rendered Dataset as one .npz file that `numpy.load` opens as well.

    The arrays have the Dataset's names. The array `tofrender` is a JSON text with sizes, channels
    and all attributes. Arrays are not compressed, since zlib would be eight times slower. An
    incomplete file never appears at `path`. See also `load_npz`.

    Args:
        dataset: The result of `render`, or a part of it.
        path: A file name that ends in .npz.
        overwrite: Replace an existing file.

    Raises:
        ValueError: Another Dataset, or another suffix.
        OSError: `path` may not be replaced or is not writable, or the disk is full.

    Warns:
        UserWarning: A value is NaN or infinite, so that the file cannot be read again.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_npz(dataset, folder + "/box.npz").name
        'box.npz'
    """
    dataset = for_file(dataset, halves=True)
    shape = dataset["transient"].shape
    target = check_output(path, shape, layout="npz", overwrite=overwrite)
    warn_not_finite(dataset, stacklevel=4)
    needed = stack_bytes(shape) * (3 if "raw" in dataset else 1)
    with replacing(path, needed_bytes=needed) as temporary, ZipFile(temporary, "w") as archive:
        _write(archive, "tofrender", Cube(np.array(json.dumps(describe(dataset)))))
        for name in (*_ARRAYS, *(name for name in ERRORS | HALVES if name in dataset)):
            _write(archive, name, Cube(dataset[name]))
    return target


def save_arrays(dataset: xr.Dataset, path: Path) -> None:
    """Write all variables and coordinates of a Dataset to a compressed NumPy archive.

    Attributes are not written. Reconstructed volumes are stored in this way.

    Args:
        dataset: The Dataset.
        path: The file, with the suffix ".npz".
    """
    arrays: dict[str, Any] = {str(name): v.values for name, v in dataset.variables.items()}
    np.savez_compressed(path, **arrays)


def _write(archive: ZipFile, name: str, cube: Cube) -> None:
    """Add an array in the format of `numpy.savez`, some rows at a time."""
    form = {"descr": npy.dtype_to_descr(cube.dtype), "fortran_order": False, "shape": cube.shape}
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        npy.write_array_header_1_0(member, form)
        for values in (part for _, part in cube.rows()) if cube.shape else [cube.read()]:
            member.write(np.ascontiguousarray(values).data)


@status("Reading NPZ")
def load_npz(path: str | os.PathLike) -> xr.Dataset:
    """Read a Dataset that `save_npz` wrote, equal bit by bit.

    See also `save_npz`.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is damaged or not of `save_npz`, or its values are not finite.
        MemoryError: The Dataset does not fit into memory.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     load_npz(save_npz(dataset, folder + "/box.npz")).identical(dataset)
        True
    """
    with reading(path, "a file that save_npz wrote") as file, ZipFile(file) as archive:
        # The description lists the arrays, and their shapes
        description = parse(read_array(archive, "tofrender"))
        names = (*_ARRAYS, *(n for n in ERRORS | HALVES if n in description["variables"]))
        shapes = shapes_of(description)
        dataset = restore(description, {n: read_array(archive, n, shapes[n]) for n in names})
        require_finite(dataset)
    return dataset
