"""Base class of `simple` and `ao`: light that white surfaces reflect once."""

from __future__ import annotations

import mitsuba as mi

from ..paths.scattering import Materials
from ..runtime import checks
from .path_tracer import PathTracer

# Material of all surfaces
WHITE = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 1.0}}


class FirstSurface(PathTracer):
    """Direct light on visible surfaces, with a white diffuse material: f cos = cos / pi.

    The visible side of surfaces is lit. The emitters and materials of the scene are ignored. A
    subclass overrides `endpoint` to define where the light comes from. The parameters are
    `hide_emitters`, `camera_unwarp`, and the temporal parameters of `TransientPath` except
    `light_samples`.
    """

    needs_lights = False
    follows_media = False
    follows_polarization = False
    has_derivatives = False
    takes_light_samples = False

    def __init__(self, props: mi.Properties) -> None:
        # The number of bounces is fixed
        for name in ("max_depth", "max_bounces"):
            if name in props:
                raise ValueError(
                    f"{name} = {checks.quote(props[name])}: must be left out, because light "
                    "bounces once"
                )
        props["max_bounces"] = 1
        super().__init__(props)
        self.material = mi.load_dict(WHITE)

    def scattering(self, scene: mi.Scene) -> Materials:
        """Return white diffuse scattering for all surfaces."""
        return Materials(scene, self.material)
