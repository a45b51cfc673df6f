"""Around the corner: captures of a relay wall, and the hidden scenes that they show."""

from __future__ import annotations

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
    "make_capture",
    "max_projection",
    "reconstruct",
    "without_first_and_last_legs",
]
