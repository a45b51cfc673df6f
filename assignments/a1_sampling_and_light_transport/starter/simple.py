"""Problem a1.simple: a point light and white surfaces."""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class Simple(mi.SamplingIntegrator):
    """Direct light of one point light on white diffuse surfaces (plugin `simple`).

        L(x) = Phi / (4 pi^2) max(0, cos) / |x - p|^2 V(x, p)

    x is the first surface point along the camera ray, p the light's position, cos the cosine
    between the direction from x to p and the shading normal, turned to the side of the surface
    that the camera ray comes from. V is 1 if nothing lies between x and p, else 0. A ray that
    meets no surface has L = 0. The scene's own lights and materials make no difference.

    Parameters (`props["position"]` and so on, all required):
        position: Where the light is, p [m]; three numbers.
        energy: Its power Phi [W]; one number, or three for R, G and B.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        raise NotImplementedError("a1.simple: Simple")

    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: Any = None,
        active: mi.Bool = True,
    ) -> tuple[mi.Color3f, mi.Bool, list]:
        """Radiance along camera rays; `mi.render` calls this.

        Returns:
            Radiance [W m^-2 sr^-1], the lanes that met a surface, and [].
        """
        raise NotImplementedError("a1.simple: Simple.sample")


mi.register_integrator("simple", Simple)
