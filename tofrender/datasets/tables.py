"""Checks of the tables of a config: keys, tables in tables, and values that are no numbers."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from difflib import get_close_matches
from typing import Any


def known_keys(where: str, given: Mapping[str, Any], allowed: Collection[str]) -> None:
    """Refuse a key that is not one of the `allowed` ones.

    Raises:
        ValueError: One line with the key, the nearest that is allowed, and all of them.

    Example:
        >>> known_keys("render", {"ssp": 4}, ("spp", "width"))
        Traceback (most recent call last):
        ValueError: render.ssp: is not known, did you mean spp? Must be one of spp, width
    """
    for key in given:
        if key not in allowed:
            raise ValueError(unknown(f"{where}.{key}" if where else str(key), key, allowed))


def unknown(what: str, name: Any, allowed: Collection[str]) -> str:
    """What is said of a name that nothing has."""
    close = get_close_matches(str(name), allowed, 1)
    hint = f", did you mean {close[0]}? Must" if close else "; must"
    return f"{what}: is not known{hint} be one of {', '.join(allowed)}"


def table(name: str, given: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """The table `name` of a table, empty if there is none.

    Raises:
        ValueError: It is something else; one line.
    """
    value = given.get(name, {})
    if not isinstance(value, Mapping):
        raise ValueError(f"{where}{name} = {value!r}: must be a table")
    return dict(value)


def boolean(name: str, value: Any) -> bool:
    """Return `value` if it is true or false, as TOML spells them.

    Raises:
        ValueError: One line with name and value.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} = {value!r}: must be true or false")
    return value


def text(name: str, value: Any) -> str:
    """Return `value` if it is text, and not empty.

    Raises:
        ValueError: One line with name and value.
    """
    if not isinstance(value, str) or not value:
        raise ValueError(f"{name} = {value!r}: must be text")
    return value
