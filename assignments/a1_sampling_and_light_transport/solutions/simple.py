"""A point light that looks at the surfaces: visibility is tested from the light."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class Simple(mi.SamplingIntegrator):
    """Direct light of one point light on white diffuse surfaces."""

    def __init__(self, props):
        super().__init__(props)
        self.position = mi.ScalarPoint3f(props["position"])
        energy = props["energy"]
        channels = [energy] * 3 if isinstance(energy, int | float) else list(energy)
        self.intensity = mi.ScalarColor3f([each / (4 * dr.pi) for each in channels])

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Radiance along camera rays."""
        si = scene.ray_intersect(ray, active)
        valid = si.is_valid()
        light = mi.Point3f(self.position)
        to_x = si.p - light
        distance = dr.norm(to_x)
        shadow = mi.Ray3f(light, to_x / distance, distance * (1 - 1e-3), 0.0, [])
        lit = valid & ~scene.ray_test(shadow, valid)
        normal = dr.select(dr.dot(si.sh_frame.n, ray.d) > 0, -si.sh_frame.n, si.sh_frame.n)
        cos = dr.maximum(-dr.dot(normal, to_x), 0) / distance
        irradiance = mi.Color3f(self.intensity) * cos / dr.square(distance)
        return dr.select(lit, irradiance / dr.pi, 0), valid, []


mi.register_integrator("simple", Simple)
