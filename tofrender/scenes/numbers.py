"""The numbers that the parameters of a scene consist of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import numpy as np

SHOWN = 16
"""Longest parameter that a message shows whole."""


def floats_of(value: Any) -> Iterator[Any]:
    """The arrays of floating-point numbers that a parameter consists of."""
    if is_transform(value):
        value = value.matrix
    if dr.is_tensor_v(value):
        value = value.array
    if dr.depth_v(value) > 1 or (dr.depth_v(value) == 1 and not dr.is_jit_v(value)):
        for each in value:
            yield from floats_of(each)
    elif isinstance(value, float) or (dr.is_array_v(value) and dr.is_float_v(value)):
        yield value


def is_transform(value: Any) -> bool:
    """Whether a parameter places something."""
    return "Transform" in type(value).__name__


def finite(array: np.ndarray) -> bool:
    """Whether all numbers are finite; smallest and largest tell, since NaN is passed on."""
    return array.size == 0 or bool(np.isfinite(array.min()) and np.isfinite(array.max()))


def first_wrong(
    name: str, arrays: list[np.ndarray], good: Callable[[np.ndarray], np.ndarray]
) -> str:
    """A parameter and its value: whole if it is short, else the first number that is wrong."""
    flat = np.concatenate([np.ravel(each) for each in arrays])
    if flat.size == 1:
        return f"{name} = {flat[0]:g}"
    if flat.size <= SHOWN:
        return f"{name} = [{', '.join(f'{x:g}' for x in flat)}]"
    first = int(np.flatnonzero(~good(flat))[0])
    return f"{name}[{first}] = {flat[first]:g}"
