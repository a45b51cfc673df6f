"""Problem a1.path_tracer_mats: path tracing with BSDF sampling.

Everything in Mitsuba is allowed except its integrators, for example `si.bsdf()`,
`si.emitter(scene)` and `scene.ray_intersect`.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class PathTracerMats(mi.SamplingIntegrator):
    """Path tracing with BSDF sampling alone (plugin `path_tracer_mats`).

    Each direction is a BSDF sample, and the emission of each light that the path hits is added:

        L = Le(x1) + f cos / p(w) (Le(x2) + f cos / p(w) (Le(x3) + ...

    Paths that leave the scene add the environment (`si.emitter(scene)` returns it there). Point
    lights are never hit and contribute nothing.

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
        raise NotImplementedError("a1.path_tracer_mats: PathTracerMats.sample")


mi.register_integrator("path_tracer_mats", PathTracerMats)
