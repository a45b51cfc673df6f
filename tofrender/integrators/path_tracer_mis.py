"""Integrator plugin `path_tracer_mis`: emitter samples and BSDF samples, combined by MIS."""

from __future__ import annotations

import mitsuba as mi

from ..paths.endpoints import SceneLights
from ..runtime import checks
from ..scenes.media import media_of
from .one_sample import OneSampleLights
from .path_tracer import PathTracer

# Ways to combine emitter samples and BSDF samples
TECHNIQUES = ("reuse", "one_sample")


class PathTracerMIS(PathTracer):
    """Path tracing with multiple importance sampling (plugin `path_tracer_mis`).

    The parameter `technique` chooses how emitter samples and BSDF samples are combined:

    | technique | direct light at a surface | rays at a surface |
    |---|---|---|
    | "reuse" | a connection, and the emitter that the next ray hits, with the power heuristic | 2 |
    | "one_sample" | one technique, chosen at random, over the mean of the densities | 2 |

    With "reuse", the BSDF sample does not need an additional ray, because the path continues along
    the same ray. The other parameters are the parameters of `PathTracer`. The parameter
    `light_samples` is only supported with "reuse".

    Example:
        >>> integrator = mi.load_dict({"type": "path_tracer_mis", "technique": "one_sample"})
        >>> integrator.technique, integrator.max_bounces
        ('one_sample', -1)
    """

    def __init__(self, props: mi.Properties) -> None:
        name = props.get("technique", "reuse")
        self.technique = checks.one_of("technique", name, TECHNIQUES)
        super().__init__(props)

    @property
    def takes_light_samples(self) -> bool:
        """Whether a vertex may have several emitter samples: only if `technique` is "reuse"."""
        return self.technique == "reuse"

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> SceneLights | OneSampleLights:
        """Return the endpoint that combines emitter samples and BSDF samples."""
        # Rays of one-sample MIS must pass index-matched boundaries in scenes with media
        if self.technique == "one_sample":
            in_media = bool(media_of(scene, sensor))
            return self.emitters(OneSampleLights, scene, sensor, passes_boundaries=in_media)
        return self.emitters(SceneLights, scene, sensor, light_samples=self.light_samples)
