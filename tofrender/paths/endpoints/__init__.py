"""Light-sampling techniques, see `protocols.Endpoint` and the table there.

Lengths end at the point that emits. An environment or directional light has none; its light starts
on the plane that touches the sphere around scene and sensor and faces the light, so that each
direction's wavefront is plane, all of it starts at OPL 0, and no length is negative.
"""

from .gated import GatedLights as GatedLights
from .scene_lights import (
    ConnectionsOnly as ConnectionsOnly,
    EmitterHits as EmitterHits,
    SceneLights as SceneLights,
)
