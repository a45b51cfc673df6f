"""Checks of numbers, of lengths and of points."""

from __future__ import annotations

import math
import operator
from typing import Any

from .messages import shown

MAX_SPP = 1 << 24
MAX_SIZE = 1 << 16
MAX_BINS = 1 << 20
MAX_DEPTH = 1 << 16
MAX_SEED = (1 << 32) - 1
MAX_OPL = 1e12
STEPS = 8


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
    if number is None or is_bool(value) or not low <= number <= high:
        raise ValueError(f"{name} = {shown(value)}: must be an integer from {low} to {high}")
    return number


def is_bool(value: Any) -> bool:
    """Whether it is a bool of Python's or NumPy's."""
    return type(value).__name__ in ("bool", "bool_")


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
        found = integer(name, value, -1, MAX_DEPTH)
        return integer(name, found, -1 if found < 0 else 1, MAX_DEPTH)
    except ValueError:
        allowed = f"-1 (no limit) or an integer from 1 to {MAX_DEPTH}"
        raise ValueError(f"{name} = {shown(value)}: must be {allowed}") from None


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
        raise ValueError(f"max_bounces = {shown(max_bounces)}: must be {allowed}") from None
    return bounces if bounces < 0 else bounces + 1


def number(
    name: str,
    value: Any,
    *,
    unit: str = "",
    positive: bool = False,
    low: float | None = None,
    high: float | None = None,
) -> float:
    """Return `value` as a finite float in the range that is allowed.

    Args:
        name: The parameter's name, for the message.
        value: A number; NaN, infinities, bools and text are refused.
        unit: What the message calls the unit; "" for a number without one.
        positive: Whether it must be above 0.
        low: Smallest value that is allowed, None if there is none.
        high: Largest value that is allowed, None if there is none.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> number("frequency_hz", 0, unit="hertz", positive=True)
        Traceback (most recent call last):
        ValueError: frequency_hz = 0: must be a finite number of hertz above 0
        >>> number("contrast", 1.5, positive=True, high=1)
        Traceback (most recent call last):
        ValueError: contrast = 1.5: must be a finite number above 0 and at most 1
    """
    try:
        bare = not isinstance(value, str | bytes) and getattr(value, "shape", ()) == ()
        given = float(value) if bare and not is_bool(value) else math.nan
    except (TypeError, ValueError, OverflowError):
        given = math.nan
    below = (positive and given <= 0) or (low is not None and given < low)
    if not math.isfinite(given) or below or (high is not None and given > high):
        kind = f"a finite number of {unit}" if unit else "a finite number"
        if low is not None and high is not None:
            limits = f" from {low:g} to {high:g}"
        else:
            least = "" if low is None else f"at least {low:g}"
            most = "" if high is None else f"at most {high:g}"
            bounds = " and ".join(filter(None, ["above 0" * positive, least, most]))
            limits = bounds and f" {bounds}"
        raise ValueError(f"{name} = {shown(value)}: must be {kind}{limits}")
    return given


def metres(name: str, value: Any, *, positive: bool = False) -> float:
    """Return `value`, a length in metres, as a finite float: `number` with its unit.

    Args:
        name: The parameter's name, for the message.
        value: A number; NaN, infinities, bools and text are refused.
        positive: Whether the length must be above 0 (a width) or may be any (a position).

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> metres("bin_width_opl", -0.02, positive=True)
        Traceback (most recent call last):
        ValueError: bin_width_opl = -0.02: must be a finite number of metres above 0
    """
    return number(name, value, unit="metres", positive=positive)


def width(name: str, value: Any) -> float:
    """Return the width of a pulse, in metres that single precision can divide by.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> width("pulse_width_opl", 1e-30)
        Traceback (most recent call last):
        ValueError: pulse_width_opl = 1e-30: must be a finite number of metres from 1e-12 to 1e+12
    """
    metres(name, value, positive=True)
    return number(name, value, unit="metres", low=1 / MAX_OPL, high=MAX_OPL)


def resolved(name: str, width: float, *lengths: float) -> None:
    """Refuse a width of less than `STEPS` steps of single precision at path lengths, in metres.

    A bin of k steps holds floor(k) or ceil(k) of the lengths that there are: 8 keep what is in it
    right within 6 % (rms), and none is empty.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> resolved("bin_width_opl", 0.1, 0.0, 1e7)
        Traceback (most recent call last):
        ValueError: bin_width_opl = 0.1: must be at least 8.08 m, as lengths of 1e+07 m round to 1 m
    """
    farthest = max(abs(each) for each in lengths)
    step = math.ldexp(1.0, math.frexp(farthest)[1] - 24)
    if width < STEPS * step:
        least, rounded = 1.01 * STEPS * step, f"lengths of {farthest:g} m round to {step:.2g} m"
        raise ValueError(f"{name} = {width:g}: must be at least {least:.3g} m, as {rounded}")


def place(name: str, value: Any, count: int = 3) -> list[float]:
    """Return the coordinates of a point, `count` finite numbers of metres.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> place("laser", (0, 1))
        Traceback (most recent call last):
        ValueError: laser = (0, 1): must be 3 finite numbers of metres
    """
    try:
        numbers = [metres(name, each) for each in value]
    except (TypeError, ValueError):
        numbers = []
    if isinstance(value, str) or len(numbers) != count:
        raise ValueError(f"{name} = {shown(value)}: must be {count} finite numbers of metres")
    return numbers
