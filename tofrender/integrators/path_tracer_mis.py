"""Integrator plugin `path_tracer_mis`: light by both techniques, each where it is good."""

from __future__ import annotations

import mitsuba as mi

from ..paths.endpoints import SceneLights
from ..runtime import checks
from ..scenes.media import media_of
from .one_sample import OneSampleLights
from .path_tracer import PathTracer

TECHNIQUES = ("reuse", "one_sample")


class PathTracerMIS(PathTracer):
    """Path tracing with multiple importance sampling (plugin `path_tracer_mis`).

    Two ways to combine the lights' sampling with the materials', by `technique`:

    | technique | direct light at a surface | rays at a surface |
    |---|---|---|
    | "reuse" | a connection, and the light that the next ray runs into, power heuristic | 2 |
    | "one_sample" | one of both by chance, over the mean of the densities | 2 |

    "reuse" needs no ray for the material's sample, because the path goes on along it: it takes two
    samples for the price of one. Other parameters: those of `PathTracer`, `light_samples` with
    "reuse" only.

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
        """Whether vertices may take several emitter samples: not with one-sample MIS."""
        return self.technique == "reuse"

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> SceneLights | OneSampleLights:
        """Combine emitter and BSDF samples."""
        if self.technique == "one_sample":
            in_media = bool(media_of(scene, sensor))
            return self.emitters(OneSampleLights, scene, sensor, passes_boundaries=in_media)
        return self.emitters(SceneLights, scene, sensor, light_samples=self.light_samples)
