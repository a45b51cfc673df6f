"""Problem a1.path_tracer_nee: path tracing with next-event estimation.

Everything in Mitsuba is allowed except its integrators, including `scene.sample_emitter_direction`.
That function samples all kinds of lights, as your code in a1.lights samples some of them.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class PathTracerNEE(mi.SamplingIntegrator):
    """Path tracing with next-event estimation alone (plugin `path_tracer_nee`).

    At every surface a point y on a light is sampled, and contributes if nothing occludes it:

        L_direct = f cos Le(y) V(x, y) / p(direction to y)

    The path continues in a direction that is sampled from the BSDF. A light that it then hits does
    not count, because the connection has counted it. In two cases a connection is not possible, and
    the hit counts: the camera sees the light directly, or the path came to the light only by
    mirrors or smooth glass since the last other surface (or the camera), because their directions
    are a delta distribution.

    Parameters:
        max_bounces: Largest number of reflections of a path: 0 shows lights only, 1 adds direct
            light. With -1 (the default), only Russian roulette ends the paths.
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
            Radiance [W m^-2 sr^-1], mask of the camera rays that hit a surface, and [].
        """
        raise NotImplementedError("a1.path_tracer_nee: PathTracerNEE.sample")


mi.register_integrator("path_tracer_nee", PathTracerNEE)
