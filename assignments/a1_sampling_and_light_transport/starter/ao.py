"""Problem a1.ao: ambient occlusion."""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class AmbientOcclusion(mi.SamplingIntegrator):
    """White diffuse surfaces under a white sky (plugin `ao`, without parameters).

        L(x) = integral over the hemisphere of V(x, w) cos / pi dw

    x is the first surface point along the camera ray. The hemisphere is centered at the shading
    normal, on the side of the surface that the camera ray comes from. V is 0 if the ray from x in
    the direction w hits a surface at any distance, otherwise 1. A camera ray that hits nothing has
    L = 0. Each call estimates the integral with one direction of the density cos / pi. You can
    import your cosine hemisphere: `from sphere_and_hemispheres import square_to_cosine_hemisphere`.
    """

    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: Any = None,
        active: mi.Bool = True,
    ) -> tuple[mi.Color3f, mi.Bool, list]:
        """Estimate L along camera rays; `mi.render` calls this.

        Returns:
            L, the same in each channel, the mask of the lanes that hit a surface, and [].
        """
        raise NotImplementedError("a1.ao: AmbientOcclusion.sample")


mi.register_integrator("ao", AmbientOcclusion)
