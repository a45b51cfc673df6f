"""Built-in scenes: functions that return dicts for `mi.load_dict`, and their names."""

from __future__ import annotations

from collections.abc import Callable

from .boxes import (
    START_OPL,
    cornell_box,
    cornell_box_flash,
    cornell_box_glass,
    cornell_box_mirror,
    cornell_box_steady_state,
    small_box,
)
from .light_transport import (
    bust_ao,
    bust_simple,
    rectangle_light_quad,
    rectangle_light_triangles,
    sphere_light_large,
    sphere_light_medium,
    sphere_light_small,
    veach,
)
from .parts import SAMPLER, Dict

__all__ = [
    "BUILT_IN",
    "SAMPLER",
    "START_OPL",
    "bust_ao",
    "bust_simple",
    "cornell_box",
    "cornell_box_flash",
    "cornell_box_glass",
    "cornell_box_mirror",
    "cornell_box_steady_state",
    "describe",
    "rectangle_light_quad",
    "rectangle_light_triangles",
    "small_box",
    "sphere_light_large",
    "sphere_light_medium",
    "sphere_light_small",
    "veach",
]

BUILT_IN: dict[str, Callable[..., Dict]] = {
    builder.__name__: builder
    for builder in (
        cornell_box,
        cornell_box_mirror,
        cornell_box_glass,
        cornell_box_flash,
        cornell_box_steady_state,
        bust_simple,
        bust_ao,
        veach,
        sphere_light_small,
        sphere_light_medium,
        sphere_light_large,
        rectangle_light_quad,
        rectangle_light_triangles,
        small_box,
    )
}
"""The built-in scenes by name; a builder's first line of documentation describes its scene."""


def describe(name: str) -> str:
    """The first line of a built-in scene's documentation.

    Example:
        >>> describe("cornell_box")
        'The Cornell box with two white boxes, lit from the ceiling.'
    """
    return (BUILT_IN[name].__doc__ or "").partition("\n")[0]
