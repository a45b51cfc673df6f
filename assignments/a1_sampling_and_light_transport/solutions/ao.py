"""Ambient occlusion without a frame: the normal plus a point of the unit sphere."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class AmbientOcclusion(mi.SamplingIntegrator):
    """White diffuse surfaces under a white sky."""

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """One direction, cosine-weighted around the normal that faces the camera."""
        si = scene.ray_intersect(ray, active)
        valid = si.is_valid()
        normal = si.sh_frame.n * -dr.sign(dr.dot(si.sh_frame.n, ray.d))
        uv = sampler.next_2d(active)
        z = 1 - 2 * uv.y
        r = dr.sqrt(1 - z * z)
        sine, cosine = dr.sincos(dr.two_pi * uv.x)
        direction = dr.normalize(normal + 0.9999 * mi.Vector3f(r * cosine, r * sine, z))
        blocked = scene.ray_test(si.spawn_ray(direction), valid)
        return mi.Color3f(dr.select(valid & ~blocked, 1.0, 0.0)), valid, []


mi.register_integrator("ao", AmbientOcclusion)
