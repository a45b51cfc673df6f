"""Checks of what a value is: a name, text, a function, an object of some type."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from difflib import get_close_matches
from typing import Any

from .messages import listed, shown
from .numbers import is_bool


def boolean(name: str, value: Any) -> bool:
    """Return `value` if it is True or False.

    Raises:
        ValueError: One line with name and value.

    Example:
        >>> boolean("camera_unwarp", "yes")
        Traceback (most recent call last):
        ValueError: camera_unwarp = 'yes': must be True or False
    """
    if is_bool(value):
        return bool(value)
    raise ValueError(f"{name} = {shown(value)}: must be True or False")


def instance(name: str, value: Any, kind: Any, what: str) -> Any:
    """Return `value` if it is of a kind, a type or several, which the message calls `what`.

    Raises:
        ValueError: One line with name and value.

    Example:
        >>> instance("title", 3, str, "text")
        Traceback (most recent call last):
        ValueError: title = 3: must be text
    """
    if isinstance(value, kind):
        return value
    raise ValueError(f"{name} = {shown(value)}: must be {what}")


def text(name: str, value: Any) -> str | None:
    """Return `value` if it is text or None.

    Raises:
        ValueError: One line with name and value.
    """
    return instance(name, value, str | None, "text")


def mapping(name: str, value: Any) -> dict[str, Any]:
    """Return a mapping of names as a dict, an empty one of None.

    Raises:
        ValueError: One line with name and value.

    Example:
        >>> mapping("parameters", [("a", 1)])
        Traceback (most recent call last):
        ValueError: parameters = [('a', 1)]: must be a dict of names and values
    """
    given = {} if value is None else value
    if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
        raise ValueError(f"{name} = {shown(value)}: must be a dict of names and values")
    return dict(given)


def function(name: str, value: Any) -> Any:
    """Return `value` if it can be called.

    Raises:
        ValueError: One line with name and value.
    """
    if callable(value):
        return value
    raise ValueError(f"{name} = {shown(value)}: must be a function")


def one_of(name: str, value: Any, allowed: Collection[str]) -> str:
    """Return `value` if it is one of the `allowed` names.

    Raises:
        ValueError: One line with name, value, the nearest name if one is close, and all of them.

    Example:
        >>> one_of("light", "aera", ("area", "flash"))
        Traceback (most recent call last):
        ValueError: light = 'aera': did you mean 'area'? Must be one of area, flash
    """
    if isinstance(value, str) and value in allowed:
        return value
    close = get_close_matches(value, allowed, 1) if isinstance(value, str) else []
    hint = f"did you mean {close[0]!r}? Must" if close else "must"
    raise ValueError(f"{name} = {shown(value)}: {hint} be one of {listed(allowed)}")
