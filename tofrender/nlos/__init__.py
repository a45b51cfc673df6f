"""Around the corner: captures of a relay wall, and the hidden scenes that they show."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .captures import MODES, check_capture, make_capture, without_first_and_last_legs
from .reconstruction import (
    METHODS,
    DepthError,
    VolumeGrid,
    depth_error,
    depth_map,
    max_projection,
    reconstruct,
)

if TYPE_CHECKING:
    from .capturing import capture, focus_laser

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


def __getattr__(name: str) -> Any:
    """What renders is imported when it is asked for: captures can be read without a variant."""
    if name in ("capture", "focus_laser"):
        from . import capturing

        return getattr(capturing, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
