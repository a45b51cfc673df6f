"""Checks of arrays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from .messages import kind_of

if TYPE_CHECKING:
    import numpy as np


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
