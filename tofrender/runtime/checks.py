"""Checks of arguments: each refuses a bad value in one line, `name = value: must be ...`."""

from __future__ import annotations

import math
import operator
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

MAX_SPP = 1 << 24
MAX_SIZE = 1 << 16
MAX_BINS = 1 << 20
MAX_DEPTH = 1 << 16
MAX_SEED = (1 << 32) - 1
MAX_OPL = 1e12
MAX_NAME, MAX_PATH = 255, 4096
"""Bytes of a file's name, and of a path, that file systems take."""


LONGEST = 80
"""Characters of a value that a message shows."""


def shown(value: Any) -> str:
    """A value as messages show it: in one line, cut if it is long; arrays by type and shape.

    Example:
        >>> shown(0.5), len(shown([1] * 100)), shown(1 << 4000)
        ('0.5', 80, 'an integer of 4001 bits')
    """
    if isinstance(value, int) and value.bit_length() > 200:
        return f"an integer of {value.bit_length()} bits"
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if isinstance(shape, tuple) and len(shape) and dtype is not None:
        return f"{type(value).__name__} of {dtype} with shape {shape}"
    try:
        text = " ".join(repr(value).splitlines())
    except Exception:  # Whatever its own code raises
        text = f"<{type(value).__name__}>"
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]} ..."


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
    if number is None or _is_bool(value) or not low <= number <= high:
        raise ValueError(f"{name} = {shown(value)}: must be an integer from {low} to {high}")
    return number


def _is_bool(value: Any) -> bool:
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
        given = float(value) if bare and not _is_bool(value) else math.nan
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


def real_array(name: str, values: Any, dtype: Any = None) -> np.ndarray:
    """Return `values` as an array, which must hold real numbers; NaN and infinities may be there.

    Args:
        name: The parameter's name, for the message.
        values: An array, or what NumPy makes one of.
        dtype: The type to convert them to; None keeps theirs.

    Raises:
        ValueError: One line with the name and what it is instead.

    Example:
        >>> real_array("I", ["a", "b"])
        Traceback (most recent call last):
        ValueError: I of type list: must hold real numbers
    """
    import numpy as np  # Not for `tofrender --help`

    try:
        array = np.asarray(values)
    except (TypeError, ValueError, OverflowError):
        array = np.array(None)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} of type {kind_of(values)}: must hold real numbers")
    return array if dtype is None else array.astype(dtype, copy=False)


def kind_of(value: Any) -> str:
    """What a value is, for messages: an array's dtype, any other's type."""
    dtype = getattr(value, "dtype", None)
    return type(value).__name__ if dtype is None else str(dtype)


def finite(name: str, values: np.ndarray) -> np.ndarray:
    """Return `values` if all of them are finite.

    Least and largest value tell: NaN and infinities turn up in them, and no memory is needed. A
    gigabyte of float32 takes a fraction of a second.

    Args:
        name: What the values are, for the message.
        values: An array of real numbers, of any shape.

    Raises:
        ValueError: One line that says how many are not finite, and the first one's index.

    Example:
        >>> import numpy as np
        >>> _ = finite("transient", np.ones((2, 3)))
        >>> finite("transient", np.array([[1, np.inf], [np.nan, 2]]))
        Traceback (most recent call last):
        ValueError: transient: 2 of 4 values are not finite, the first is inf at [0, 1]; must all be
    """
    if values.dtype.kind == "f":
        finite_parts(name, [((0,) * values.ndim, values)])
    return values


def finite_parts(name: str, parts: Iterable[tuple[Sequence[int], np.ndarray]]) -> None:
    """`finite` of an array that comes in parts, each with the index of its first value.

    Raises:
        ValueError: As of `finite`.

    Example:
        >>> import numpy as np
        >>> finite_parts("transient", [((0,), np.ones(2)), ((2,), np.array([np.nan, 1]))])
        Traceback (most recent call last):
        ValueError: transient: 1 of 4 values are not finite, the first is nan at [2]; must all be
    """
    import numpy as np

    total = count = 0
    first: tuple[list[int], float] | None = None
    for start, values in parts:
        total += values.size
        with np.errstate(invalid="ignore"):
            if not values.size or (math.isfinite(values.min()) and math.isfinite(values.max())):
                continue
        for index, part in enumerate(values if values.ndim > 1 else values[None]):  # Saves memory
            bad = ~np.isfinite(part)
            found = int(np.count_nonzero(bad))
            count += found
            if found:
                inner = np.unravel_index(int(bad.argmax()), bad.shape)
                at = [index] * (values.ndim > 1) + [int(i) for i in inner]
                here = [a + b for a, b in zip(start, at, strict=True)]
                if first is None or here < first[0]:
                    first = here, float(part[inner])
    if first is not None:
        raise ValueError(
            f"{name}: {count} of {total} values are not finite, the first is {first[1]:g} at "
            f"{first[0]}; must all be"
        )


def path(name: str, value: Any) -> Path:
    """Return `value`, text or an `os.PathLike`, as a `Path`.

    A number is refused, which `open` would take for an open file, and close.

    Raises:
        ValueError: One line with name and value.

    Example:
        >>> path("path", 3)
        Traceback (most recent call last):
        ValueError: path = 3: must be text or an os.PathLike, the name of a file or folder
    """
    allowed = "must be text or an os.PathLike, the name of a file or folder"
    if isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        if isinstance(text, str) and text.splitlines() == [text] and "\0" not in text:
            longest = max(len(os.fsencode(part)) for part in (*Path(text).parts, ""))
            if longest > MAX_NAME or len(text) > MAX_PATH:
                allowed = f"must have names of at most {MAX_NAME} bytes, {MAX_PATH} in all"
                raise ValueError(f"{name} = {shown(text)}: {allowed}")
            return Path(text)
    raise ValueError(f"{name} = {shown(value)}: {allowed}")


def boolean(name: str, value: Any) -> bool:
    """Return `value` if it is True or False.

    Raises:
        ValueError: One line with name and value.

    Example:
        >>> boolean("camera_unwarp", "yes")
        Traceback (most recent call last):
        ValueError: camera_unwarp = 'yes': must be True or False
    """
    if _is_bool(value):
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
    known = ", ".join(each or "''" for each in allowed)
    raise ValueError(f"{name} = {shown(value)}: {hint} be one of {known}")


def address(name: str, value: Any) -> str:
    """Return the address of a scheduler.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> address("scheduler", "10.0.0.1")
        Traceback (most recent call last):
        ValueError: scheduler = '10.0.0.1': must be an address like tcp://10.0.0.1:8786
    """
    found = re.fullmatch(r"((tcp|tls|ws|wss|ucx)://)?(\[[\w:%.]+\]|[^\s/:]+):(\d{1,5})", str(value))
    if not isinstance(value, str) or not found or not 0 < int(found[4]) < 1 << 16:
        raise ValueError(f"{name} = {shown(value)}: must be an address like tcp://10.0.0.1:8786")
    return found[0]
