"""The hidden scene from a capture: five methods, volumes in metres, depth and its error."""

from __future__ import annotations

from .depths import DepthError, depth_error, depth_map, max_projection
from .methods import METHODS, reconstruct
from .volume import VolumeGrid

__all__ = [
    "METHODS",
    "DepthError",
    "VolumeGrid",
    "depth_error",
    "depth_map",
    "max_projection",
    "reconstruct",
]
