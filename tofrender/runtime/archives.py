"""Arrays of .npz files from anywhere: their headers are compared before anything is unpacked."""

from __future__ import annotations

import math
from zipfile import ZipFile

import numpy as np
from numpy.lib import format as npy

from . import memory
from .atomic import readable

MOST_BYTES = 1 << 28
"""Of an array whose shape nobody knows."""


def read_array(archive: ZipFile, name: str, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """An array of an .npz file, read to its end, where its checksum is compared.

    Args:
        archive: The file.
        name: The array's.
        shape: What its shape must be; None for any of at most 256 MiB.

    Raises:
        ValueError: Its header says another shape or size; one line.
        KeyError: There is none of this name.
        MemoryError: It takes more than is free; one line.
    """
    info = archive.getinfo(f"{name}.npy")
    with archive.open(info) as stream:
        version = npy.read_magic(stream)
        header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        its, _, dtype = header(stream)
        size = math.prod(its) * dtype.itemsize
        if shape is not None and its != shape:
            raise ValueError(f"{name} with shape {its}: must be {shape}")
        if shape is None and size > MOST_BYTES:
            raise ValueError(f"{name} of {readable(size)}: must be at most {readable(MOST_BYTES)}")
        if stream.tell() + size != info.file_size:
            raise ValueError(f"{name} with shape {its} does not fill its part of the file")
        memory.require_free(name, size)
        stream.seek(0)
        array = npy.read_array(stream, allow_pickle=False)
        stream.read(1)
    return array
