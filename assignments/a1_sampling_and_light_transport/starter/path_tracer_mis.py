"""Problem a1.path_tracer_mis: path tracing with multiple importance sampling.

Allowed: everything of Mitsuba but its own integrators; `scene.sample_emitter_direction` and
`scene.pdf_emitter_direction` included.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class PathTracerMIS(mi.SamplingIntegrator):
    """Path tracing with multiple importance sampling (plugin `path_tracer_mis`).

    Direct light at a surface comes from two techniques, the lights' sampling and the material's,
    and is counted once. Choose one way:

    - one sample: take one of both at random, and divide by the mean of the two densities;
    - two samples: take both, weight each with the balance or power heuristic, and go on along the
      material's ray (it needs no ray of its own).

    What one technique alone can find has the weight 1: point lights (the lights' sampling), and
    what mirrors and smooth glass show (the material's). What the camera sees directly counts once.

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
        raise NotImplementedError("a1.path_tracer_mis: PathTracerMIS.sample")


mi.register_integrator("path_tracer_mis", PathTracerMIS)
