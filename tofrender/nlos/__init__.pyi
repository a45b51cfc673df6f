from .captures import (
    MODES as MODES,
    check_capture as check_capture,
    make_capture as make_capture,
    without_first_and_last_legs as without_first_and_last_legs,
)
from .capturing import capture as capture
from .device.laser import focus_laser as focus_laser
from .reconstruction import (
    METHODS as METHODS,
    DepthError as DepthError,
    VolumeGrid as VolumeGrid,
    depth_error as depth_error,
    depth_map as depth_map,
    max_projection as max_projection,
    reconstruct as reconstruct,
)
from .truth import hidden_depth as hidden_depth
