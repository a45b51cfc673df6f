"""Integrator plugin `path_tracer_nee`: path tracing with next-event estimation only."""

from __future__ import annotations

import mitsuba as mi

from ..paths.endpoints import ConnectionsOnly
from .path_tracer import PathTracer


class PathTracerNEE(PathTracer):
    """Path tracing with next-event estimation only (plugin `path_tracer_nee`).

    At every surface, a point on an emitter is sampled. The light from this point is added if no
    surface blocks it:

        L_direct = f cos Le(y) V(x, y) / p(direction to y)

    The path continues with a BSDF sample. An emitter that the next ray hits does not count, because
    the connection has already added its light. After mirrors and glass, emitters that the next ray
    hits do count, because mirrors and glass do not support connections. This method suits small
    emitters. Reflections of large emitters on glossy surfaces are noisy. The parameters are the
    parameters of `PathTracer`.

    Example:
        >>> integrator = mi.load_dict({"type": "path_tracer_nee", "max_bounces": 4})
        >>> integrator.max_depth
        5
    """

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> ConnectionsOnly:
        """Return the endpoint with next-event estimation."""
        return self.emitters(ConnectionsOnly, scene, sensor, light_samples=self.light_samples)
