"""Data between judge and worker: plain values, never objects.

A value is a number, text, boolean, None, an array, or a list or dict of values. It travels as an
npz archive: the structure as JSON, with the number of an array in each array's place. Files appear
whole, because they are renamed into place. Reading has a size limit, whoever wrote the file.
"""

import json
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

MAX_BYTES = 256 << 20  # of a value, as it travels and as it is taken apart
MAX_STRUCTURE = 16 << 20  # bytes of all that is not an array
_ARRAY = "__array__"
KINDS = "biufcU"  # of arrays: NumPy's letters for numbers and texts


def write(path: Path, value: Any, convert: Callable[[Any], Any] = lambda part: part) -> None:
    """Write a value; `convert` makes arrays of parts of other types, else TypeError in one line."""
    arrays: dict[str, Any] = {}

    def add_array(part: Any) -> dict[str, str]:
        array = convert(part)
        if not isinstance(array, np.ndarray | np.generic):
            raise TypeError(
                f"a {type(part).__name__} cannot be sent; must be a number, text, None, an array, "
                "or a list or dict of them"
            )
        if array.dtype.kind not in KINDS:
            raise TypeError(f"an array of {array.dtype} cannot be sent; must be one of numbers")
        name = f"a{len(arrays)}"
        arrays[name] = array
        return {_ARRAY: name}

    structure = json.dumps(value, default=add_array).encode()
    temporary = path.with_name(f"{path.name}.part")
    with temporary.open("wb") as file:
        np.savez(file, structure=np.frombuffer(structure, np.uint8), **arrays)
    os.replace(temporary, path)


def read(path: Path, most: int = MAX_BYTES) -> Any:
    """Read a value of at most `most` bytes; ValueError if it was not written by `write`."""
    try:
        with open_untrusted(path, most) as file:
            content = arrays_of(file, most)
        structure = content.pop("structure")
        if structure.nbytes > MAX_STRUCTURE:
            raise ValueError(f"its texts have {structure.nbytes} bytes, more than {MAX_STRUCTURE}")

        def insert_array(part: dict[str, Any]) -> Any:
            array = content[part[_ARRAY]] if set(part) == {_ARRAY} else part
            return array[()] if isinstance(array, np.ndarray) and not array.shape else array

        return json.loads(structure.tobytes(), object_hook=insert_array)
    except Exception as error:  # a hostile file raises whatever its readers can raise
        raise ValueError(f"{path.name}: is not an answer: {str(error)[:200]}") from None


def open_untrusted(path: Path, most: int = MAX_BYTES) -> IO[bytes]:
    """Open a regular file of at most `most` bytes, whose untrusted writer may still write it."""
    careful = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    fd = os.open(path, os.O_RDONLY | careful | getattr(os, "O_BINARY", 0))
    state = os.fstat(fd)
    if stat.S_ISREG(state.st_mode) and state.st_size <= most:
        return os.fdopen(fd, "rb")
    os.close(fd)
    if not stat.S_ISREG(state.st_mode):
        raise ValueError("it is no regular file")
    raise ValueError(f"it has {state.st_size} bytes, more than {most}")


def arrays_of(file: IO[bytes], most: int = MAX_BYTES) -> dict[str, np.ndarray]:
    """Arrays of an npz file, of numbers and texts, at most `most` bytes. Damage raises anything."""
    with np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
        assert archive.zip is not None
        size = sum(entry.file_size for entry in archive.zip.infolist())
        if size > most:
            raise ValueError(f"it holds {size} bytes, more than {most}")
        content = {name: archive[name] for name in archive.files}
    for name, array in content.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in KINDS:
            raise ValueError(f"{name[:50]!a} is no array of numbers or texts")
    return content
