"""Problem a1.path_tracer_mats: path tracing with BSDF sampling.

Allowed: everything of Mitsuba but its own integrators (`si.bsdf()`, `si.emitter(scene)`,
`scene.ray_intersect` ...).
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class PathTracerMats(mi.SamplingIntegrator):
    """Path tracing with BSDF sampling alone (plugin `path_tracer_mats`).

    Each direction is a BSDF sample, and a light counts if the path hits it:

        L = Le(x1) + f cos / p(w) (Le(x2) + f cos / p(w) (Le(x3) + ...

    The environment counts for paths that leave the scene (`si.emitter(scene)` returns it there).
    Point lights are never hit, and stay dark.

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
        raise NotImplementedError("a1.path_tracer_mats: PathTracerMats.sample")


mi.register_integrator("path_tracer_mats", PathTracerMats)
