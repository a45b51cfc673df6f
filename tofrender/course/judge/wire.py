"""What goes over the wire between judge and worker: data, never objects.

A value is a number, text, boolean, None, an array, or a list or dict of values. It travels as an
npz archive: the structure as JSON, with the number of an array in each array's place. Files appear
whole, because they are renamed into place.
"""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

_ARRAY = "__array__"


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


def read(path: Path) -> Any:
    """Read a value.

    Raises:
        ValueError: The file is not what `write` writes.
    """
    try:
        with path.open("rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
        structure = json.loads(content.pop("structure").tobytes())
        return _put_together(structure, content)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, RecursionError) as error:
        raise ValueError(f"{path.name}: is not an answer: {error}") from None


def _take_apart(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        value = np.asarray(value)
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biufcU":
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
