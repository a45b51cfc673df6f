"""The six scenes in which `make bench-full` measures errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi

import tofrender

SIZE = 64
BINS = 300
DEPTH = 6
Described = dict[str, Any]


def box(name: str = "cornell_box", **more: Any) -> Described:
    """A Cornell box at the size of the table."""
    found = getattr(tofrender, name)(
        **{"width": SIZE, "height": SIZE, "temporal_bins": BINS} | more
    )
    found["integrator"]["max_depth"] = DEPTH
    return found


def sixteen_lamps() -> Described:
    """The box's lamp, cut into sixteen that are a third as long and wide as their part of it."""
    found = box()
    lamp = found.pop("light")
    grid = [(x, y) for x in (-0.75, -0.25, 0.25, 0.75) for y in (-0.75, -0.25, 0.25, 0.75)]
    for k, (x, y) in enumerate(grid):
        part = mi.ScalarTransform4f().translate([x, y, 0]).scale([1 / 12, 1 / 12, 1])
        found[f"light{k}"] = lamp | {"to_world": lamp["to_world"] @ part}
    return found


def small_lamp() -> Described:
    """The box with a lamp 4 cm wide, two bins."""
    found = box()
    lamp = found["light"]
    part = mi.ScalarTransform4f().scale([0.02 / 0.23, 0.02 / 0.19, 1])
    found["light"] = lamp | {"to_world": lamp["to_world"] @ part}
    return found


SCENES: dict[str, Callable[[], Described]] = {
    "Cornell box": box,
    "sixteen lamps": sixteen_lamps,
    "lamp two bins wide": small_lamp,
    "glass sphere": lambda: box("cornell_box_glass"),
    "mirror": lambda: box("cornell_box_mirror"),
    "flash": lambda: box("cornell_box_flash"),
}
