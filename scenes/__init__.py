"""The scene builders, importable from the project's root; this folder also holds Mitsuba XML."""

from tofrender.scenes import (
    bust_ao,
    bust_simple,
    cornell_box,
    cornell_box_flash,
    cornell_box_glass,
    cornell_box_mirror,
    cornell_box_steady_state,
    rectangle_light_quad,
    rectangle_light_triangles,
    small_box,
    sphere_light_large,
    sphere_light_medium,
    sphere_light_small,
    veach,
)

__all__ = [
    "bust_ao",
    "bust_simple",
    "cornell_box",
    "cornell_box_flash",
    "cornell_box_glass",
    "cornell_box_mirror",
    "cornell_box_steady_state",
    "rectangle_light_quad",
    "rectangle_light_triangles",
    "small_box",
    "sphere_light_large",
    "sphere_light_medium",
    "sphere_light_small",
    "veach",
]
