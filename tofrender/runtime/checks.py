"""Checks of arguments: each refuses a bad value in one line, `name = value: must be ...`.

Every function takes the parameter's name, for the message, and its value, returns the value as its
type, and raises a ValueError if it is not allowed.
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
MAX_OPL = 1e12
MAX_NAME, MAX_PATH = 255, 4096  # Bytes of a file's name, and of a path, that file systems allow
MIN_STEPS = 8  # Of single precision, in a bin
LONGEST = 80  # Characters of a value that a message shows
LISTED = 400  # Characters of the allowed names that a message lists


def quote(value: Any) -> str:
    """`repr` for messages: in one line, cut if it is long; arrays by type and shape."""
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


def printable(text: str) -> str:
    """Escape control characters, as of file names, for a terminal."""
    text = re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", lambda found: f"\\x{ord(found[0]):02x}", text)
    return text.encode(errors="backslashreplace").decode()


def join_names(names: Collection[str]) -> str:
    """Join names for a message; of very many, the first ones and how many more there are."""
    texts = [each or "''" for each in names]
    ends = accumulate(len(each) + 2 for each in texts)
    first = [each for each, end in zip(texts, ends, strict=True) if end <= LISTED]
    more = len(texts) - len(first)
    return ", ".join(first) + (f", or {more} more" if more else "")


def require(name: str, value: Any, valid: Any, allowed: str) -> Any:
    """Require a value to be `valid`; the message says what is `allowed`."""
    if not valid:
        raise ValueError(f"{name} = {quote(value)}: must be {allowed}")
    return value


def shape(name: str, array: Any, valid: Any, allowed: str) -> None:
    """Require an array's shape to be `valid`; the message says what is `allowed`."""
    if not valid:
        raise ValueError(f"{name} with shape {array.shape}: must be {allowed}")


def items(name: str, value: Any, count: int, allowed: str) -> list[Any]:
    """Require a value of `count` items; the message says what is `allowed`."""
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
    """Require an instance of a type, or of one of several, which the message calls `allowed`."""
    return require(name, value, isinstance(value, kind), allowed)


def text(name: str, value: Any) -> str | None:
    """Require text or None."""
    return instance(name, value, str | None, "text")


def function(name: str, value: Any) -> Any:
    """Require something that can be called."""
    return require(name, value, callable(value), "a function")


def mapping(name: str, value: Any) -> dict[str, Any]:
    """Require a mapping of names and return it as a dict, an empty one for None."""
    given = {} if value is None else value
    valid = isinstance(given, Mapping) and all(isinstance(key, str) for key in given)
    return dict(require(name, given, valid, "a dict of names and values"))


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
    """Whether a value is a bool of Python's or NumPy's."""
    return type(value).__name__ in ("bool", "bool_")


def integer(name: str, value: Any, low: int, high: int) -> int:
    """Require an int or NumPy integer in [low, high]; a bool, a float or text is refused."""
    return _integer(name, value, low, high, f"an integer from {low} to {high}")


def _integer(name: str, value: Any, low: int, high: int, allowed: str) -> int:
    try:
        found = None if _is_bool(value) else operator.index(value)
    except TypeError:
        found = None
    require(name, value, found is not None and low <= found <= high, allowed)
    return operator.index(value)


def depth(name: str, value: Any) -> int:
    """Require a path depth: -1 for no limit, else 1 or more segments."""
    allowed = f"-1 (no limit) or an integer from 1 to {MAX_DEPTH}"
    found = _integer(name, value, -1, MAX_DEPTH, allowed)
    return require(name, found, found != 0, allowed)


def depth_of_bounces(max_bounces: Any) -> int:
    """Path depth in segments of a number of surfaces: one more, or -1 for no limit."""
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
    """Require a finite number in [low, high] and above 0 if `positive`; bools and text are refused.

    Example:
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
        raise ValueError(f"{name} = {quote(value)}: must be {kind}{limits}")
    return given


def metres(name: str, value: Any, *, positive: bool = False) -> float:
    """Require a length in metres: above 0 (a width) if `positive`, else any (a position)."""
    return number(name, value, unit="metres", positive=positive)


def width(name: str, value: Any) -> float:
    """Require the width of a pulse or a bin, in metres that single precision can divide by."""
    return number(name, value, unit="metres", low=1 / MAX_OPL, high=MAX_OPL)


def resolved(name: str, width: float, *lengths: float) -> None:
    """Require a width of at least `MIN_STEPS` steps of single precision at path lengths [m].

    A bin of k steps holds floor(k) or ceil(k) of the lengths that there are: 8 keep what is in it
    right within 6 % (rms), and none is empty.

    Example:
        >>> resolved("bin_width_opl", 0.1, 0.0, 1e7)
        Traceback (most recent call last):
        ValueError: bin_width_opl = 0.1: must be at least 8.08 m, as lengths of 1e+07 m round to 1 m
    """
    farthest = max(abs(each) for each in lengths)
    step = math.ldexp(1.0, math.frexp(farthest)[1] - 24)
    if width < MIN_STEPS * step:
        least, rounded = 1.01 * MIN_STEPS * step, f"lengths of {farthest:g} m round to {step:.2g} m"
        raise ValueError(f"{name} = {width:g}: must be at least {least:.3g} m, as {rounded}")


def interval(
    name: str, value: Any, allowed: str = "(start, stop) in metres"
) -> tuple[float, float]:
    """Require start and stop of path lengths, in metres."""
    try:
        start, stop = value
    except (TypeError, ValueError):
        raise ValueError(f"{name} = {quote(value)}: must be {allowed}") from None
    start, stop = metres(f"{name}[0]", start), metres(f"{name}[1]", stop)
    if not start < stop < start + MAX_OPL:
        raise ValueError(f"{name} = {quote(value)}: must end after it starts, and not at infinity")
    return start, stop


def point(name: str, value: Any, count: int = 3) -> list[float]:
    """Require a point, `count` finite coordinates in metres."""
    try:
        numbers = [metres(name, each) for each in value]
    except (TypeError, ValueError):
        numbers = []
    valid = not isinstance(value, str) and len(numbers) == count
    require(name, value, valid, f"{count} finite numbers of metres")
    return numbers


def path(name: str, value: Any) -> Path:
    """Require a path; a number is refused, which `open` would take for an open file, and close."""
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
            value, allowed = text, "must be a name in one line, without NUL"
    raise ValueError(f"{name} = {quote(value)}: {allowed}")


def address(name: str, value: Any) -> str:
    """Require the address of a scheduler."""
    found = re.fullmatch(r"((tcp|tls|ws|wss|ucx)://)?(\[[\w:%.]+\]|[^\s/:]+):(\d{1,5})", str(value))
    valid = isinstance(value, str) and found is not None and 0 < int(found[4]) < 1 << 16
    return require(name, value, valid, "an address like tcp://10.0.0.1:8786")


def real_array(name: str, values: Any, dtype: Any = None) -> np.ndarray:
    """Require real numbers, NaN and infinities among them, and return them as an array."""
    import numpy as np  # Not for `tofrender --help`

    try:
        array = np.asarray(values)
    except (TypeError, ValueError, OverflowError):
        array = np.array(None)
    if array.dtype.kind not in "fiu":
        kind = getattr(values, "dtype", type(values).__name__)
        raise ValueError(f"{name} of type {kind}: must hold real numbers")
    return array if dtype is None else array.astype(dtype, copy=False)


def finite(name: str, values: np.ndarray) -> np.ndarray:
    """Require that all values of an array are finite."""
    if values.dtype.kind == "f":
        finite_parts(name, [((0,) * values.ndim, values)])
    return values


def finite_parts(name: str, parts: Iterable[tuple[Sequence[int], np.ndarray]]) -> None:
    """Require finite values of an array in parts, each with the index of its first value.

    NaN and infinities show in the least or the largest value, which are looked at first: no memory
    is needed, and a gigabyte of float32 takes a fraction of a second.
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
