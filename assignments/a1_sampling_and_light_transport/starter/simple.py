"""Problem a1.simple: a point light and white surfaces."""

from __future__ import annotations

from typing import Any

import mitsuba as mi


class Simple(mi.SamplingIntegrator):
    """Direct light of one point light on white diffuse surfaces (plugin `simple`).

        L(x) = Phi / (4 pi^2) max(0, cos) / |x - p|^2 V(x, p)

    x is the first surface point along the camera ray, p the light's position, cos the cosine
    between the direction from x to p and the shading normal, flipped to the side of the surface
    that the camera ray comes from. V is 1 if nothing lies between x and p, otherwise 0. A ray that
    hits nothing has L = 0. The lights and materials of the scene are ignored.

    Parameters (`props["position"]` and so on, all required):
        position: Position p of the light [m]; three numbers.
        energy: Power Phi of the light [W]; one number, or three for R, G and B.
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
            Radiance [W m^-2 sr^-1], mask of the lanes that hit a surface, and [].
        """
        raise NotImplementedError("a1.simple: Simple.sample")


mi.register_integrator("simple", Simple)
