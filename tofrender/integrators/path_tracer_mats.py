"""Integrator plugin `path_tracer_mats`: path tracing with BSDF samples only."""

from __future__ import annotations

import mitsuba as mi

from ..paths.endpoints import EmitterHits
from .path_tracer import PathTracer


class PathTracerMats(PathTracer):
    """Path tracing with BSDF samples only (plugin `path_tracer_mats`).

    At every surface, a direction wo is sampled from the BSDF. Light only counts if the path hits an
    emitter:

        L = Le(x1) + f cos / p(wo) (Le(x2) + f cos / p(wo) (Le(x3) + ...

    This method suits large emitters and mirrors. Small emitters are rarely found, and point lights
    are never found. The parameters are the parameters of `PathTracer` except `light_samples`.

    Example:
        >>> integrator = mi.load_dict({"type": "path_tracer_mats", "max_bounces": 1})
        >>> integrator.max_bounces
        1
    """

    takes_light_samples = False

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> EmitterHits:
        """Return the endpoint without next-event estimation: paths must hit emitters."""
        return self.emitters(EmitterHits, scene, sensor)
