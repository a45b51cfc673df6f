"""Light-sampling techniques, see `protocols.Endpoint` and the table in `protocols`.

Path lengths end at the point that emits. Environments and directional lights do not have such a
point. Their light starts on planes that touch the sphere around scene and sensor and face the
light. The wavefront of each direction is plane, all of it starts at OPL 0, and no length is
negative.
"""

from .gated_emitters import GatedLights as GatedLights
from .scene_lights import (
    ConnectionsOnly as ConnectionsOnly,
    EmitterHits as EmitterHits,
    SceneLights as SceneLights,
)
