"""Around the corner: captures of a relay wall, and the hidden scenes that they show."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names_of

if TYPE_CHECKING:
    from .captures import MODES, check_capture, make_capture, without_first_and_last_legs
    from .capturing import capture, focus_laser
    from .reconstruction import (
        METHODS,
        DepthError,
        VolumeGrid,
        depth_error,
        depth_map,
        max_projection,
        reconstruct,
    )
    from .truth import hidden_depth

__all__ = [
    "METHODS",
    "MODES",
    "DepthError",
    "VolumeGrid",
    "capture",
    "check_capture",
    "depth_error",
    "depth_map",
    "focus_laser",
    "hidden_depth",
    "make_capture",
    "max_projection",
    "reconstruct",
    "without_first_and_last_legs",
]

# What renders is a module of its own: captures can be read without a variant
__getattr__, __dir__ = names_of(
    __name__,
    {
        "captures": ("MODES", "check_capture", "make_capture", "without_first_and_last_legs"),
        "capturing": ("capture", "focus_laser"),
        "reconstruction": (
            "METHODS",
            "DepthError",
            "VolumeGrid",
            "depth_error",
            "depth_map",
            "max_projection",
            "reconstruct",
        ),
        "truth": ("hidden_depth",),
    },
)
