"""Checks of arguments. A bad value gives a message in one line, `name = value: must be RANGE`.

Each function has the parameters `name`, which is the name in the message, and `value`. It returns
the value with the right type. It raises a ValueError if the value is not allowed.
"""

from __future__ import annotations

import math
import operator
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

MAX_SPP = 1 << 24
MAX_SIZE = 1 << 16
MAX_BINS = 1 << 20
MAX_DEPTH = 1 << 16
MAX_SEED = (1 << 32) - 1
MAX_OPL = 1e12  # optical path length [m]
MAX_NAME = 255  # length of a file name [bytes]
MAX_PATH = 4096  # length of a path [bytes]
MIN_STEPS = 8  # smallest number of steps of single precision in a time bin
LONGEST = 80  # characters of a value in a message
LISTED = 400  # characters of a list of names in a message


def quote(value: Any) -> str:
    """Return the `repr` of a value in one line for a message.

    Long text is cut. Arrays are described by their type and shape.
    """
    if isinstance(value, int) and value.bit_length() > 200:
        return f"an integer of {value.bit_length()} bits"
    shape = getattr(value, "shape", None)
    dtype = getattr(value, "dtype", None)
    if isinstance(shape, tuple) and len(shape) and dtype is not None:
        return f"{type(value).__name__} of {dtype} with shape {shape}"
    try:
        text = " ".join(repr(value).splitlines())
    except Exception:
        # A class can raise any error in its `__repr__`
        text = f"<{type(value).__name__}>"
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]} ..."


def printable(text: str) -> str:
    """Escape control characters, for example in file names, before text is printed."""
    text = re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", lambda found: f"\\x{ord(found[0]):02x}", text)
    return text.encode(errors="backslashreplace").decode()


def join_names(names: Collection[str]) -> str:
    """Join names for a message. A long list ends with the number of names that are left out."""
    texts = [each or "''" for each in names]
    ends = accumulate(len(each) + 2 for each in texts)
    first = [each for each, end in zip(texts, ends, strict=True) if end <= LISTED]
    more = len(texts) - len(first)
    return ", ".join(first) + (f", or {more} more" if more else "")


def require(name: str, value: Any, valid: Any, allowed: str) -> Any:
    """Require a value to be `valid`; the message contains the text `allowed`."""
    if not valid:
        raise ValueError(f"{name} = {quote(value)}: must be {allowed}")
    return value


def shape(name: str, array: Any, valid: Any, allowed: str) -> None:
    """Require the shape of an array to be `valid`; the message contains the text `allowed`."""
    if not valid:
        raise ValueError(f"{name} with shape {array.shape}: must be {allowed}")


def items(name: str, value: Any, count: int, allowed: str) -> list[Any]:
    """Require a sequence of `count` items; the message contains the text `allowed`."""
    try:
        found = list(value)
    except TypeError:
        found = []
    require(name, value, len(found) == count, allowed)
    return found


def boolean(name: str, value: Any) -> bool:
    """Require True or False."""
    return bool(require(name, value, _is_bool(value), "True or False"))


def instance(name: str, value: Any, kind: Any, allowed: str) -> Any:
    """Require an instance of a type or a union; the message contains the text `allowed`."""
    return require(name, value, isinstance(value, kind), allowed)


def text(name: str, value: Any) -> str | None:
    """Require text or None."""
    return instance(name, value, str | None, "text")


def function(name: str, value: Any) -> Any:
    """Require something that can be called."""
    return require(name, value, callable(value), "a function")


def mapping(name: str, value: Any) -> dict[str, Any]:
    """Require a mapping with text as keys and return a dict; None gives an empty dict."""
    found = {} if value is None else value
    is_valid = isinstance(found, Mapping) and all(isinstance(key, str) for key in found)
    return dict(require(name, found, is_valid, "a dict of names and values"))


def one_of(name: str, value: Any, allowed: Collection[str]) -> str:
    """Require one of the `allowed` names; the message suggests the nearest one.

    Example:
        >>> one_of("light", "aera", ("area", "flash"))
        Traceback (most recent call last):
        ValueError: light = 'aera': did you mean 'area'? Must be one of area, flash
    """
    if isinstance(value, str) and value in allowed:
        return value
    close = get_close_matches(value, allowed, 1) if isinstance(value, str) else []
    hint = f"did you mean {close[0]!r}? Must" if close else "must"
    raise ValueError(f"{name} = {quote(value)}: {hint} be one of {join_names(allowed)}")


def _is_bool(value: Any) -> bool:
    """Return whether a value is a bool of Python or NumPy."""
    return type(value).__name__ in ("bool", "bool_")


def integer(name: str, value: Any, low: int, high: int) -> int:
    """Require an integer of Python or NumPy in [low, high]. Bools and floats are refused."""
    return _integer(name, value, low, high, f"an integer from {low} to {high}")


def _integer(name: str, value: Any, low: int, high: int, allowed: str) -> int:
    try:
        found = None if _is_bool(value) else operator.index(value)
    except TypeError:
        found = None
    require(name, value, found is not None and low <= found <= high, allowed)
    return operator.index(value)


def depth(name: str, value: Any) -> int:
    """Require a path depth: 1 or more segments, or -1 for no limit."""
    allowed = f"-1 (no limit) or an integer from 1 to {MAX_DEPTH}"
    found = _integer(name, value, -1, MAX_DEPTH, allowed)
    return require(name, found, found != 0, allowed)


def depth_of_bounces(max_bounces: Any) -> int:
    """Convert a number of bounces to a path depth in segments; -1 stays without limit."""
    allowed = f"-1 (no limit) or an integer from 0 to {MAX_DEPTH - 1}"
    bounces = _integer("max_bounces", max_bounces, -1, MAX_DEPTH - 1, allowed)
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
    """Require a finite number in [low, high]. Bools and text are refused.

    Args:
        name: Name in the message.
        value: Value to check.
        unit: Unit in the message.
        positive: Whether the number must be above 0.
        low: Smallest value.
        high: Largest value.

    Example:
        >>> number("contrast", 1.5, positive=True, high=1)
        Traceback (most recent call last):
        ValueError: contrast = 1.5: must be a finite number above 0 and at most 1
    """
    try:
        is_scalar = not isinstance(value, str | bytes) and getattr(value, "shape", ()) == ()
        found = float(value) if is_scalar and not _is_bool(value) else math.nan
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    is_too_low = (positive and found <= 0) or (low is not None and found < low)
    is_too_high = high is not None and found > high
    if not math.isfinite(found) or is_too_low or is_too_high:
        kind = f"a finite number of {unit}" if unit else "a finite number"
        if low is not None and high is not None:
            limits = f" from {low:g} to {high:g}"
        else:
            least = "" if low is None else f"at least {low:g}"
            most = "" if high is None else f"at most {high:g}"
            bounds = " and ".join(filter(None, ["above 0" * positive, least, most]))
            limits = bounds and f" {bounds}"
        raise ValueError(f"{name} = {quote(value)}: must be {kind}{limits}")
    return found


def meters(name: str, value: Any, *, positive: bool = False) -> float:
    """Require a length in meters. It may be negative, as a position, unless `positive` is set."""
    return number(name, value, unit="meters", positive=positive)


def width(name: str, value: Any) -> float:
    """Require the width of a pulse or a bin in meters. Its inverse fits into single precision."""
    return number(name, value, unit="meters", low=1 / MAX_OPL, high=MAX_OPL)


def resolved(name: str, width: float, *lengths: float) -> None:
    """Require a bin width of at least `MIN_STEPS` steps of single precision.

    In single precision, path lengths are multiples of a step. A bin that is k steps wide contains
    floor(k) or ceil(k) of these multiples, so that narrow bins receive different amounts of light.
    With 8 steps the error is 6 % (rms), and no bin is empty.

    Args:
        name: Name in the message.
        width: Width of a bin [m].
        *lengths: Path lengths at which the step is computed [m].

    Example:
        >>> resolved("bin_width_opl", 0.1, 0.0, 1e7)
        Traceback (most recent call last):
        ValueError: bin_width_opl = 0.1: must be at least 8.08 m, as lengths of 1e+07 m round to 1 m
    """
    farthest = max(abs(each) for each in lengths)
    step = math.ldexp(1.0, math.frexp(farthest)[1] - 24)
    if width < MIN_STEPS * step:
        least = 1.01 * MIN_STEPS * step
        reason = f"lengths of {farthest:g} m round to {step:.2g} m"
        raise ValueError(f"{name} = {width:g}: must be at least {least:.3g} m, as {reason}")


def interval(
    name: str, value: Any, allowed: str = "(start, stop) in meters"
) -> tuple[float, float]:
    """Require the start and the stop of path lengths in meters."""
    try:
        start, stop = value
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {quote(value)}: must be {allowed}") from None
    start = meters(f"{name}[0]", start)
    stop = meters(f"{name}[1]", stop)
    if not start < stop < start + MAX_OPL:
        raise ValueError(f"{name} = {quote(value)}: must end after it starts, and not at infinity")
    return start, stop


def point(name: str, value: Any, count: int = 3) -> list[float]:
    """Require a point with `count` finite coordinates in meters."""
    try:
        numbers = [meters(name, each) for each in value]
    except (TypeError, ValueError):
        numbers = []
    valid = not isinstance(value, str) and len(numbers) == count
    require(name, value, valid, f"{count} finite numbers of meters")
    return numbers


def path(name: str, value: Any) -> Path:
    """Require a path.

    A number is refused, because `open` uses a number as the descriptor of an open file and closes
    the file.
    """
    allowed = "must be text or an os.PathLike, the name of a file or folder"
    if isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        if isinstance(text, str) and text.splitlines() == [text] and "\0" not in text:
            longest = max(len(os.fsencode(part)) for part in (*Path(text).parts, ""))
            if longest > MAX_NAME or len(text) > MAX_PATH:
                allowed = f"must have names of at most {MAX_NAME} bytes, {MAX_PATH} in all"
                raise ValueError(f"{name} = {quote(text)}: {allowed}")
            return Path(text)
        if text:
            value = text
            allowed = "must be a name in one line, without NUL"
    raise ValueError(f"{name} = {quote(value)}: {allowed}")


def address(name: str, value: Any) -> str:
    """Require the address of a Dask scheduler, with a port."""
    found = re.fullmatch(r"((tcp|tls|ws|wss|ucx)://)?(\[[\w:%.]+\]|[^\s/:]+):(\d{1,5})", str(value))
    valid = isinstance(value, str) and found is not None and 0 < int(found[4]) < 1 << 16
    return require(name, value, valid, "an address like tcp://10.0.0.1:8786")


def real_array(name: str, values: Any, dtype: Any = None) -> np.ndarray:
    """Require real numbers and return an array. NaN and infinities are allowed."""
    import numpy as np  # Imported here, because `tofrender --help` does not need NumPy

    try:
        array = np.asarray(values)
    except (TypeError, ValueError, OverflowError):
        array = np.array(None)
    if array.dtype.kind not in "fiu":
        kind = getattr(values, "dtype", type(values).__name__)
        raise ValueError(f"{name} of type {kind}: must contain real numbers")
    return array if dtype is None else array.astype(dtype, copy=False)


def finite(name: str, values: np.ndarray) -> np.ndarray:
    """Require an array with finite values."""
    if values.dtype.kind == "f":
        finite_parts(name, [((0,) * values.ndim, values)])
    return values


def finite_parts(name: str, parts: Iterable[tuple[Sequence[int], np.ndarray]]) -> None:
    """Require finite values in the parts of an array.

    The smallest and the largest value of each part are tested first. One of them is not finite if
    the part contains NaN or an infinity. This is fast and does not need memory.

    Args:
        name: Name in the message.
        parts: Parts of the array, each with the index of its first value.

    Raises:
        ValueError: The message contains the number of bad values and the index of the first.
    """
    import numpy as np

    total = count = 0
    first: tuple[list[int], float] | None = None
    for start, values in parts:
        total += values.size
        with np.errstate(invalid="ignore"):
            if not values.size or (math.isfinite(values.min()) and math.isfinite(values.max())):
                continue

        # Look for the first bad value in one slice after another, which saves memory
        for index, part in enumerate(values if values.ndim > 1 else values[None]):
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
            f"{first[0]}; must all be finite"
        )
