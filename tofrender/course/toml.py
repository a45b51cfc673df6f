"""TOML files of an assignment: read, and checked against dataclasses."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def read(path: Path, name: object = "") -> dict[str, Any]:
    """Content of a file, called `name` or by its path in errors; ValueError if it is no TOML."""
    name = name or path
    if not path.is_file():
        raise ValueError(f"{name}: is missing")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{name}: is not TOML: {error}") from None


def make(kind: type, table: Mapping[str, Any], where: str) -> Any:
    """Dataclass instance from a table, whose lists become tuples; ValueError if keys differ."""
    known = kind.__dataclass_fields__
    for key in table:
        if key not in known:
            raise ValueError(f"{where}: {key!r} is unknown; must be one of {', '.join(known)}")
    try:
        return kind(**{key: _tuples(value) for key, value in table.items()})
    except TypeError as error:
        raise ValueError(f"{where}: {str(error).split('__init__() ')[-1]}") from None


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
