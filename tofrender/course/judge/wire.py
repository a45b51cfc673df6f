"""What goes over the wire between judge and worker: data, never objects.

A value is a number, text, boolean, None, an array, or a list or dict of values. It travels as an
npz archive: the structure as JSON, with the number of an array in each array's place. Files appear
whole, because they are renamed into place. What is read has a limit, whoever wrote it.
"""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import IO, Any

import numpy as np

MAX_BYTES = 256 << 20
"""Most bytes of a value, as it travels and as it is taken apart."""
MAX_STRUCTURE = 16 << 20
"""Most bytes of all that is not an array."""
_ARRAY = "__array__"
KINDS = "biufcU"
"""What arrays may hold: NumPy's letters for numbers and texts."""


def write(path: Path, value: Any) -> None:
    """Write a value.

    Raises:
        TypeError: It holds what is none of the above; one line with its type.
    """
    arrays: dict[str, Any] = {}
    structure = json.dumps(_take_apart(value, arrays)).encode()
    temporary = path.with_name(f"{path.name}.part")
    with temporary.open("wb") as file:
        np.savez(file, structure=np.frombuffer(structure, np.uint8), **arrays)
    os.replace(temporary, path)


def read(path: Path, most: int = MAX_BYTES) -> Any:
    """Read a value.

    Args:
        path: The file.
        most: Its largest size, and that of its arrays together [bytes].

    Raises:
        ValueError: The file is not what `write` writes.
    """
    try:
        with opened(path, most) as file:
            content = arrays_of(file, most)
        structure = content.pop("structure")
        if structure.nbytes > MAX_STRUCTURE:
            raise ValueError(f"its texts have {structure.nbytes} bytes, more than {MAX_STRUCTURE}")
        return _put_together(json.loads(structure.tobytes()), content)
    except Exception as error:  # a hostile file raises whatever its readers can raise
        raise ValueError(f"{path.name}: is not an answer: {str(error)[:200]}") from None


def opened(path: Path, most: int = MAX_BYTES) -> IO[bytes]:
    """Open a file that somebody else has written, and may still write.

    Args:
        path: The file.
        most: Its largest size [bytes].

    Raises:
        ValueError: It is no regular file, or larger.
    """
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
    """The arrays of an npz file.

    Args:
        file: The file.
        most: Their largest size together [bytes].

    Raises:
        ValueError: They are larger, or not of numbers and texts. Damage raises anything.
    """
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


def _take_apart(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        value = np.asarray(value)
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in KINDS:
            raise TypeError(f"an array of {value.dtype} cannot be sent; must be one of numbers")
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {_ARRAY: name}
    if isinstance(value, dict):
        return {str(key): _take_apart(item, arrays) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_take_apart(item, arrays) for item in value]
    raise TypeError(
        f"a {type(value).__name__} cannot be sent; must be a number, text, None, an array, or a "
        "list or dict of them"
    )


def _put_together(structure: Any, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(structure, dict):
        if set(structure) == {_ARRAY}:
            array = arrays[structure[_ARRAY]]
            return array if array.shape else array[()]
        return {key: _put_together(item, arrays) for key, item in structure.items()}
    if isinstance(structure, list):
        return [_put_together(item, arrays) for item in structure]
    return structure
