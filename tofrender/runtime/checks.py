"""Checks of arguments: each refuses a bad value in one line, `name = value: must be ...`."""

from __future__ import annotations

import math
import operator
from collections.abc import Collection
from difflib import get_close_matches
from typing import Any

MAX_SPP = 1 << 24
MAX_SIZE = 1 << 16
MAX_BINS = 1 << 20
MAX_DEPTH = 1 << 16
MAX_SEED = (1 << 32) - 1
MAX_OPL = 1e12


def integer(name: str, value: Any, low: int, high: int) -> int:
    """Return `value` as an int in [low, high].

    Args:
        name: The parameter's name, for the message.
        value: An int or NumPy integer; a bool, a float or text is refused.
        low: Smallest value that is allowed.
        high: Largest value that is allowed.

    Raises:
        ValueError: One line with name, value and the range.

    Example:
        >>> integer("spp", 0, 1, MAX_SPP)
        Traceback (most recent call last):
        ValueError: spp = 0: must be an integer from 1 to 16777216
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool) or not low <= number <= high:
        raise ValueError(f"{name} = {value!r}: must be an integer from {low} to {high}")
    return number


def depth(name: str, value: Any) -> int:
    """Return `value` as a path depth: -1 for no limit, else 1 or more segments.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> depth("max_depth", 0)
        Traceback (most recent call last):
        ValueError: max_depth = 0: must be -1 (no limit) or an integer from 1 to 65536
    """
    try:
        return integer(name, value, 1 if value != -1 else -1, MAX_DEPTH)
    except ValueError:
        allowed = f"-1 (no limit) or an integer from 1 to {MAX_DEPTH}"
        raise ValueError(f"{name} = {value!r}: must be {allowed}") from None


def depth_of_bounces(max_bounces: Any) -> int:
    """Path depth in segments of a number of surfaces: one more, or -1 for no limit.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> depth_of_bounces(1)
        2
        >>> depth_of_bounces(-2)
        Traceback (most recent call last):
        ValueError: max_bounces = -2: must be -1 (no limit) or an integer from 0 to 65535
    """
    try:
        bounces = integer("max_bounces", max_bounces, -1, MAX_DEPTH - 1)
    except ValueError:
        allowed = f"-1 (no limit) or an integer from 0 to {MAX_DEPTH - 1}"
        raise ValueError(f"max_bounces = {max_bounces!r}: must be {allowed}") from None
    return bounces if bounces < 0 else bounces + 1


def metres(name: str, value: Any, *, positive: bool = False, unit: str = "metres") -> float:
    """Return `value`, a length in metres, as a finite float.

    Args:
        name: The parameter's name, for the message.
        value: A number; NaN, infinities, bools and text are refused.
        positive: Whether the length must be above 0 (a width) or may be any (a position).
        unit: What the message calls the unit, if it is another one.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> metres("bin_width_opl", -0.02, positive=True)
        Traceback (most recent call last):
        ValueError: bin_width_opl = -0.02: must be a finite number of metres above 0
    """
    try:
        number = math.nan if isinstance(value, bool | str | bytes) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number) or (positive and number <= 0):
        above = " above 0" if positive else ""
        raise ValueError(f"{name} = {value!r}: must be a finite number of {unit}{above}")
    return number


def boolean(name: str, value: Any) -> bool:
    """Return `value` if it is True or False.

    Raises:
        ValueError: One line with name and value.

    Example:
        >>> boolean("camera_unwarp", "yes")
        Traceback (most recent call last):
        ValueError: camera_unwarp = 'yes': must be True or False
    """
    if isinstance(value, bool):
        return value
    raise ValueError(f"{name} = {value!r}: must be True or False")


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
    known = ", ".join(each or "''" for each in allowed)
    raise ValueError(f"{name} = {value!r}: {hint} be one of {known}")
