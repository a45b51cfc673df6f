"""The scene builders, importable from the project's root; this folder also holds Mitsuba XML."""

from tofrender.scenes import (
    cornell_box,
    cornell_box_flash,
    cornell_box_glass,
    cornell_box_mirror,
    cornell_box_steady_state,
)

__all__ = [
    "cornell_box",
    "cornell_box_flash",
    "cornell_box_glass",
    "cornell_box_mirror",
    "cornell_box_steady_state",
]
