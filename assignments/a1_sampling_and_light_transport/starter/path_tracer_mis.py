"""Problem a1.path_tracer_mis: path tracing with multiple importance sampling.

Everything in Mitsuba is allowed except its integrators, including `scene.sample_emitter_direction`
and `scene.pdf_emitter_direction`.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class PathTracerMIS(mi.SamplingIntegrator):
    """Path tracing with multiple importance sampling (plugin `path_tracer_mis`).

    Two techniques sample direct light at a surface, light sampling and BSDF sampling, and together
    they count it once. Choose one of two methods:

    - one sample: use one of the techniques at random, and divide by the mean of the two densities;
    - two samples: use both techniques, weight each with the balance or power heuristic, and
      continue the path along the ray of the BSDF sample (direct light needs no second ray).

    Light that only one technique can find has the MIS weight 1: point lights (light sampling), and
    lights seen in mirrors and smooth glass (BSDF sampling). Lights that the camera sees directly
    count once.

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
        raise NotImplementedError("a1.path_tracer_mis: PathTracerMIS.sample")


mi.register_integrator("path_tracer_mis", PathTracerMIS)
