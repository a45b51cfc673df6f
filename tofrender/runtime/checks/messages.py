"""What messages show of values and names."""

from __future__ import annotations

import re
from collections.abc import Collection
from itertools import accumulate
from typing import Any

LONGEST = 80
"""Characters of a value that a message shows."""

LISTED = 400
"""Characters of the allowed names that a message lists."""


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


def printable(text: str) -> str:
    r"""Text for a terminal, in which control characters, as of file names, are escaped.

    Example:
        >>> printable("out\x1b[31m")
        'out\\x1b[31m'
    """
    text = re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", lambda found: f"\\x{ord(found[0]):02x}", text)
    return text.encode(errors="backslashreplace").decode()


def listed(names: Collection[str]) -> str:
    """Names for a message, of very many the first ones and how many more there are.

    Example:
        >>> listed(["area", "flash"])
        'area, flash'
    """
    texts = [each or "''" for each in names]
    ends = accumulate(len(each) + 2 for each in texts)
    first = [each for each, end in zip(texts, ends, strict=True) if end <= LISTED]
    more = len(texts) - len(first)
    return ", ".join(first) + (f", or {more} more" if more else "")


def kind_of(value: Any) -> str:
    """What a value is, for messages: an array's dtype, any other's type."""
    dtype = getattr(value, "dtype", None)
    return type(value).__name__ if dtype is None else str(dtype)
