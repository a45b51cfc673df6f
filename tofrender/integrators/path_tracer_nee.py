"""Integrator plugin `path_tracer_nee`: light where the lights are."""

from __future__ import annotations

import mitsuba as mi

from ..paths.endpoints import ConnectionsOnly
from .path_tracer import PathTracer


class PathTracerNEE(PathTracer):
    """Path tracing with next-event estimation alone (plugin `path_tracer_nee`).

    At every surface a point on a light is chosen, and counts if nothing is in the way:

        L_direct = f cos Le(y) V(x, y) / p(direction to y)

    The path goes on by material sampling, and does not count a light that it then runs into: the
    connection has counted it. Only mirrors and glass, which reflect no connection, show the light
    that the path runs into after them. Good for small lights; a glossy surface's reflection of a
    large light is noisy. Parameters: those of `PathTracer`.

    Example:
        >>> integrator = mi.load_dict({"type": "path_tracer_nee", "max_bounces": 4})
        >>> integrator.max_depth
        5
    """

    def endpoint(self, scene: mi.Scene, sensor: mi.Sensor | None) -> ConnectionsOnly:
        """Return next-event estimation."""
        return self.emitters(ConnectionsOnly, scene, sensor, light_samples=self.light_samples)
