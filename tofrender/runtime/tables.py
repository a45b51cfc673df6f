"""TOML files, and checks of the keys and values in their tables."""

import os
import tomllib
from collections.abc import Callable, Collection, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from . import checks


def read_toml(name: str, source: str | os.PathLike[str]) -> tuple[dict[str, Any], Path]:
    """Read a TOML file, and return its content and its path.

    Args:
        name: Name of the parameter with the path, for messages.
        source: Path of the file.
    """
    path = checks.path(name, source)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")), path
    except FileNotFoundError:
        raise FileNotFoundError(f"{name} = {path}: does not exist; must be a TOML file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{name} = {path}: cannot be read ({type(error).__name__})") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{name} = {path}: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise ValueError(f"{name} = {path}: is nested too deeply; must be flatter") from None


def known_keys(where: str, given: Mapping[str, Any], allowed: Collection[str]) -> None:
    """Raise a ValueError if a table contains keys that are not in `allowed`."""
    for key in given:
        if key not in allowed:
            raise ValueError(unknown(f"{where}.{key}" if where else str(key), key, allowed))


def unknown(where: str, name: Any, allowed: Collection[str]) -> str:
    """Return the message about an unknown name, with the nearest allowed name."""
    close = get_close_matches(str(name), allowed, 1)
    hint = f", did you mean {close[0]}? Must" if close else "; must"
    return f"{where}: is not known{hint} be one of {', '.join(allowed)}"


def checked(
    where: str, given: Mapping[str, Any], allowed: Mapping[str, Callable[[str, Any], Any]]
) -> dict[str, Any]:
    """Check the values of a table, and return them.

    Args:
        where: Name of the table, for messages.
        given: The table.
        allowed: Check of each key. It is called with the full name of the key and the value, and
            returns the value.

    Raises:
        ValueError: The table contains an unknown key, or a check fails.

    Example:
        >>> checked("outputs", {"depth": 1}, {"depth": boolean})
        Traceback (most recent call last):
        ValueError: outputs.depth = 1: must be true or false
    """
    known_keys(where, given, allowed)
    prefix = f"{where}." if where else ""
    return {key: allowed[key](f"{prefix}{key}", value) for key, value in given.items()}


def table(name: str, value: Any) -> dict[str, Any]:
    """Return `value` as a dict if it is a table."""
    return dict(checks.instance(name, value, Mapping, "a table"))


def boolean(name: str, value: Any) -> bool:
    """Return `value` if it is true or false, as TOML spells them."""
    return checks.instance(name, value, bool, "true or false")


def text(name: str, value: Any) -> str:
    """Return `value` if it is text, and not empty."""
    return checks.require(name, value, isinstance(value, str) and value, "text")
