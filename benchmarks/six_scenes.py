"""Six scenes in which `make bench-full` measures errors."""

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
    """Describe a Cornell box with the size of the table."""
    found = getattr(tofrender, name)(
        **{"width": SIZE, "height": SIZE, "temporal_bins": BINS} | more
    )
    found["integrator"]["max_depth"] = DEPTH
    return found


def sixteen_lamps() -> Described:
    """Describe the box with sixteen small lamps instead of one.

    The lamp is cut into sixteen parts, and each part is scaled to a third of its length and width.
    """
    found = box()
    lamp = found.pop("light")
    grid = [(x, y) for x in (-0.75, -0.25, 0.25, 0.75) for y in (-0.75, -0.25, 0.25, 0.75)]
    for k, (x, y) in enumerate(grid):
        part = mi.ScalarTransform4f().translate([x, y, 0]).scale([1 / 12, 1 / 12, 1])
        found[f"light{k}"] = lamp | {"to_world": lamp["to_world"] @ part}
    return found


def small_lamp() -> Described:
    """Describe the box with a lamp that is 4 cm or two bins wide."""
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
