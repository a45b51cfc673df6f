"""Problem a1.path_tracer_nee: path tracing with next-event estimation.

Allowed: everything of Mitsuba but its own integrators, `scene.sample_emitter_direction` included:
it does for all kinds of light what you wrote for some of them in a1.lights.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class PathTracerNEE(mi.SamplingIntegrator):
    """Path tracing with next-event estimation alone (plugin `path_tracer_nee`).

    At every surface a point y on a light is chosen, and counts if nothing is in the way:

        L_direct = f cos Le(y) V(x, y) / p(direction to y)

    The path goes on in a direction that the material chooses, and a light that it then runs into
    does not count, because the connection has counted it. Two cases have no connection, and do
    count: what the camera sees directly, and what is seen by way of mirrors or smooth glass alone
    since the last other surface (or the camera), whose directions are a delta distribution.

    Parameters:
        max_bounces: Most surfaces that a path is reflected from: 0 shows lights only, 1 adds direct
            light, -1 (the default) has no limit: Russian roulette ends the paths.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_bounces = props.get("max_bounces", -1)

    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: Any = None,
        active: mi.Bool = True,
    ) -> tuple[mi.Color3f, mi.Bool, list]:
        """Estimate the radiance along camera rays; `mi.render` calls this.

        Returns:
            Radiance [W m^-2 sr^-1], the lanes whose camera ray met a surface, and [].
        """
        raise NotImplementedError("a1.path_tracer_nee: PathTracerNEE.sample")


mi.register_integrator("path_tracer_nee", PathTracerNEE)
