"""Data between judge and worker: plain values, never objects.

A value is a number, text, boolean, None, an array, or a list or dict of values. It is sent as an
npz archive. The archive contains the arrays, and the remaining structure as JSON, in which a
reference replaces each array. A file is renamed when it is complete, so no reader finds a partial
file. Reading has a size limit, because a submission can write the file.
"""

import json
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

MAX_BYTES = 256 << 20  # largest size of a value, compressed and uncompressed [bytes]
MAX_STRUCTURE = 16 << 20  # largest size of the structure without arrays [bytes]
_ARRAY = "__array__"  # key of a reference to an array
KINDS = "biufcU"  # allowed types of arrays: NumPy's letters for numbers and texts


def write(path: Path, value: Any, convert: Callable[[Any], Any] = lambda part: part) -> None:
    """Write a value to a file.

    Args:
        path: Path of the file.
        value: The value.
        convert: Function that converts parts of other types to arrays.

    Raises:
        TypeError: A part of the value is not a plain value and cannot be converted.
    """
    arrays: dict[str, Any] = {}

    def add_array(part: Any) -> dict[str, str]:
        """Store an array, and return the reference to it."""
        array = convert(part)
        if not isinstance(array, np.ndarray | np.generic):
            raise TypeError(
                f"a {type(part).__name__} cannot be sent; return a number, text, None, an array, "
                "or a list or dict of them"
            )
        if array.dtype.kind not in KINDS:
            raise TypeError(f"an array of {array.dtype} cannot be sent; return an array of numbers")
        name = f"a{len(arrays)}"
        arrays[name] = array
        return {_ARRAY: name}

    # Write a temporary file, then rename it
    structure = json.dumps(value, default=add_array).encode()
    temporary = path.with_name(f"{path.name}.part")
    with temporary.open("wb") as file:
        np.savez(file, structure=np.frombuffer(structure, np.uint8), **arrays)
    os.replace(temporary, path)


def read(path: Path, most: int = MAX_BYTES) -> Any:
    """Read a value that `write` wrote.

    Args:
        path: Path of the file.
        most: Largest allowed size [bytes].

    Raises:
        ValueError: The file is damaged, too large, or was not written by `write`.
    """
    try:
        # Read arrays and structure
        with open_untrusted(path, most) as file:
            content = arrays_of(file, most)
        structure = content.pop("structure")
        if structure.nbytes > MAX_STRUCTURE:
            raise ValueError(f"the texts have {structure.nbytes} bytes, more than {MAX_STRUCTURE}")

        # Replace references by arrays; arrays without dimensions become numbers
        def insert_array(part: dict[str, Any]) -> Any:
            array = content[part[_ARRAY]] if set(part) == {_ARRAY} else part
            return array[()] if isinstance(array, np.ndarray) and not array.shape else array

        return json.loads(structure.tobytes(), object_hook=insert_array)
    except Exception as error:  # A hostile file can cause any exception in its readers
        raise ValueError(f"{path.name} is not an answer: {str(error)[:200]}") from None


def open_untrusted(path: Path, most: int = MAX_BYTES) -> IO[bytes]:
    """Open a file of a submission, which may be hostile and may still be writing.

    Raises:
        ValueError: The file is a link, a device or a folder, or larger than `most` bytes.
        OSError: The file cannot be opened.
    """
    # Do not follow a link, and do not wait for the writer of a pipe
    careful = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    fd = os.open(path, os.O_RDONLY | careful | getattr(os, "O_BINARY", 0))

    # Check the opened file, not the path, which could be replaced in between
    state = os.fstat(fd)
    if stat.S_ISREG(state.st_mode) and state.st_size <= most:
        return os.fdopen(fd, "rb")
    os.close(fd)
    if not stat.S_ISREG(state.st_mode):
        raise ValueError("the file is not a regular file")
    raise ValueError(f"the file has {state.st_size} bytes, more than {most}")


def arrays_of(file: IO[bytes], most: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """Read the arrays of numbers and texts in an npz file, by name.

    Raises:
        ValueError: The arrays have more than `most` bytes, or contain objects.
        Exception: A damaged file can cause any exception of NumPy and `zipfile`.
    """
    with np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
        assert archive.zip is not None
        size = sum(entry.file_size for entry in archive.zip.infolist())
        if size > most:
            raise ValueError(f"the file contains {size} bytes of arrays, more than {most}")
        content = {name: archive[name] for name in archive.files}
    for name, array in content.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in KINDS:
            raise ValueError(f"{name[:50]!a} is not an array of numbers or texts")
    return content
