from .captures import (
    MODES as MODES,
)
from .captures import (
    check_capture as check_capture,
)
from .captures import (
    make_capture as make_capture,
)
from .captures import (
    without_first_and_last_legs as without_first_and_last_legs,
)
from .capturing import capture as capture
from .capturing import focus_laser as focus_laser
from .reconstruction import (
    METHODS as METHODS,
)
from .reconstruction import (
    DepthError as DepthError,
)
from .reconstruction import (
    VolumeGrid as VolumeGrid,
)
from .reconstruction import (
    depth_error as depth_error,
)
from .reconstruction import (
    depth_map as depth_map,
)
from .reconstruction import (
    max_projection as max_projection,
)
from .reconstruction import (
    reconstruct as reconstruct,
)
from .truth import hidden_depth as hidden_depth
