"""States of a loop, kept in memory of each lane so that they can be read backwards."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any

import drjit as dr


def tape(example: Any, length: int) -> Any:
    """Room for `length` records like an example, none of which is written yet.

    Dr.Jit keeps it on the stack of the thread that works on a lane: it takes no memory of its own,
    however many lanes there are.
    """
    return dr.alloc_local(_type(example), length)


def packed(value: Any) -> Any:
    """A record as `tape` stores it: without what is None."""
    if not is_dataclass(value):
        return value
    stored = _type(value)()
    for name, each in _given(value):
        setattr(stored, name, packed(each))
    return stored


def unpacked(stored: Any, example: Any) -> Any:
    """The reverse, like the example."""
    if not is_dataclass(example):
        return dr.copy(stored)  # What a step changes in place must not be what is kept
    kept = {name: unpacked(getattr(stored, name), each) for name, each in _given(example)}
    return replace(example, **kept)


def _given(value: Any) -> list[tuple[str, Any]]:
    pairs = [(field.name, getattr(value, field.name)) for field in fields(value)]
    return [(name, each) for name, each in pairs if each is not None]


def _type(value: Any) -> type:
    """The type of a record, in the very types that Dr.Jit asks for."""
    if not is_dataclass(value):
        return type(value)
    return _struct(type(value).__name__, tuple((name, _type(each)) for name, each in _given(value)))


@cache
def _struct(name: str, members: tuple[tuple[str, type], ...]) -> type:
    return type(name, (), {"DRJIT_STRUCT": dict(members)})
