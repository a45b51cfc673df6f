"""Integrator plugin `path_tracer_mats`: light where the materials look for it."""

from __future__ import annotations

import mitsuba as mi

from ..paths.endpoints import EmitterHits
from .path_tracer import PathTracer


class PathTracerMats(PathTracer):
    """Path tracing by material sampling alone (plugin `path_tracer_mats`).

    At every surface the material chooses a direction wo, in proportion to what it reflects from
    there if it can. The path counts light only when it runs into it:

        L = Le(x1) + f cos / p(wo) (Le(x2) + f cos / p(wo) (Le(x3) + ...

    Good for large lights and for mirrors; a small light is rarely found, and a point light never.
    Parameters: those of `PathTracer` but `light_samples`.

    Example:
        >>> integrator = mi.load_dict({"type": "path_tracer_mats", "max_bounces": 1})
        >>> integrator.max_bounces
        1
    """

    takes_light_samples = False

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> EmitterHits:
        """Return the technique: paths must run into emitters."""
        return self.emitters(EmitterHits, scene, sensor)
