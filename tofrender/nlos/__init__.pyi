from .captures import (
    MODES as MODES,
    check_capture as check_capture,
    make_capture as make_capture,
    without_first_and_last_legs as without_first_and_last_legs,
)
from .capturing import capture as capture
from .device.laser import focus_laser as focus_laser
from .reconstruction.depths import (
    DepthError as DepthError,
    depth_error as depth_error,
    depth_map as depth_map,
    max_projection as max_projection,
)
from .reconstruction.methods import METHODS as METHODS, reconstruct as reconstruct
from .reconstruction.volume import VolumeGrid as VolumeGrid
from .truth import hidden_depth as hidden_depth
