"""TOML files of an assignment: read them, and convert their tables to dataclasses."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def read(path: Path, name: object = "") -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: Path of the file.
        name: Name of the file in error messages; by default its path.

    Raises:
        ValueError: The file is missing or is not TOML.
    """
    name = name or path
    if not path.is_file():
        raise ValueError(f"{name}: is missing")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{name}: is not TOML: {error}") from None


def make(kind: type, table: Mapping[str, Any], where: str) -> Any:
    """Make an instance of a dataclass from a TOML table; lists become tuples.

    Args:
        kind: The dataclass.
        table: Values by the names of the fields.
        where: Beginning of error messages: the file and the table.

    Raises:
        ValueError: The table has an unknown key, or lacks a required one.
    """
    fields = kind.__dataclass_fields__
    for key in table:
        if key not in fields:
            raise ValueError(f"{where}: {key!r} is unknown; must be one of {', '.join(fields)}")
    try:
        return kind(**{key: _tuples(value) for key, value in table.items()})
    except TypeError as error:
        # The text after "__init__() " names the missing fields
        raise ValueError(f"{where}: {str(error).split('__init__() ')[-1]}") from None


def _tuples(value: Any) -> Any:
    """Convert nested lists to nested tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
