"""Lane memory for records: dataclasses of Dr.Jit arrays that symbolic loops store and read."""

from copy import copy
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import drjit as dr


def tape(example: Any, length: int) -> Any:
    """Allocate memory for `length` records with the fields of an example.

    The memory is on the stack of the thread that executes a lane. Therefore its size does not
    depend on the number of lanes.
    """
    return dr.alloc_local(_type(example), length)


def packed(value: Any) -> Any:
    """Convert a record to the type that `tape` stores, without the fields that are None."""
    if not is_dataclass(value):
        return value
    stored = _type(value)()
    for name, each in _given(value):
        setattr(stored, name, packed(each))
    return stored


def unpacked(stored: Any, example: Any) -> Any:
    """Convert a stored record back to the type of an example."""
    if not is_dataclass(example):
        return dr.copy(stored)  # A step may change the value in place
    record = copy(example)
    for name, each in _given(example):
        setattr(record, name, unpacked(getattr(stored, name), each))
    return record


def _given(value: Any) -> list[tuple[str, Any]]:
    pairs = [(field.name, getattr(value, field.name)) for field in fields(value)]
    return [(name, each) for name, each in pairs if each is not None]


def _type(value: Any) -> type:
    """Return the type of a record with concrete field types. Lane memory requires them."""
    if not is_dataclass(value):
        return type(value)
    return _struct(type(value).__name__, tuple((name, _type(each)) for name, each in _given(value)))


@cache
def _struct(name: str, members: tuple[tuple[str, type], ...]) -> type:
    return type(name, (), {"DRJIT_STRUCT": dict(members)})
