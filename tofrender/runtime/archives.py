"""Safe reading of .npz files of unknown origin. Headers are checked before arrays are unpacked."""

import math
from zipfile import ZipFile

import numpy as np
from numpy.lib import format as npy

from . import memory
from .atomic import readable

MOST_BYTES = 1 << 28  # largest size of an array of unknown shape


def read_array(archive: ZipFile, name: str, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """Read an array of an .npz file and compare its checksum.

    Args:
        archive: The open file.
        name: Name of the array.
        shape: Expected shape; None if it is unknown.

    Raises:
        ValueError: The array has another shape, its entry in the file has a wrong size, or `shape`
            is None and the array is larger than 256 MiB.
    """
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as stream:
        version = npy.read_magic(stream)
        header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        found, _, dtype = header(stream)
        size = math.prod(found) * dtype.itemsize
        if shape is not None and found != shape:
            raise ValueError(f"{name} with shape {found}: must be {shape}")
        if shape is None and size > MOST_BYTES:
            raise ValueError(f"{name} of {readable(size)}: must be at most {readable(MOST_BYTES)}")
        if stream.tell() + size != info.file_size:
            raise ValueError(
                f"{name}: the file is damaged, its entry does not have the size of an array "
                f"{found}. Save the file again"
            )
        memory.require_free(name, size)
        stream.seek(0)
        array = npy.read_array(stream, allow_pickle=False)
        stream.read(1)  # zipfile compares the checksum at the end of the stream
    return array
