"""Reconstruction of the hidden scene from a capture: five methods, depth and its error."""

from .depths import (
    DepthError as DepthError,
    depth_error as depth_error,
    depth_map as depth_map,
    max_projection as max_projection,
)
from .methods import METHODS as METHODS, reconstruct as reconstruct
from .volume import VolumeGrid as VolumeGrid
