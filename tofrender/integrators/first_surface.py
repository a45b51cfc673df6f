"""Base class of `simple` and `ao`: light of one bounce off white surfaces."""

from __future__ import annotations

import mitsuba as mi

from ..paths.scattering import Materials
from ..runtime import checks
from .path_tracer import PathTracer

WHITE = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 1.0}}


class FirstSurface(PathTracer):
    """Direct light of what is seen, as if it were white and diffuse: f cos = cos / pi.

    Surfaces are lit on the side that is seen. The scene's own lights and materials make no
    difference. A subclass says in `endpoint` where the light comes from. Takes `hide_emitters`,
    `camera_unwarp`, and for films with time what `TransientPath` takes, without `light_samples`.
    """

    needs_lights = False  # Of the scene
    follows_media = follows_polarisation = has_derivatives = False
    takes_light_samples = False

    def __init__(self, props: mi.Properties) -> None:
        for name in ("max_depth", "max_bounces"):
            if name in props:
                raise ValueError(
                    f"{name} = {checks.quote(props[name])}: must be left out; light bounces once"
                )
        props["max_bounces"] = 1
        super().__init__(props)
        self.material = mi.load_dict(WHITE)

    def scattering(self, scene: mi.Scene) -> Materials:
        """Return the scattering at white surfaces."""
        return Materials(scene, self.material)
