"""Material sampling with roulette by the throughput, from the second surface on."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class PathTracerMats(mi.SamplingIntegrator):
    """Path tracing with BSDF sampling alone."""

    def __init__(self, props):
        super().__init__(props)
        self.max_bounces = props.get("max_bounces", -1)

    @dr.syntax
    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Estimate the radiance along camera rays."""
        ctx = mi.BSDFContext()
        ray = mi.Ray3f(ray)
        active = mi.Bool(active)
        throughput = mi.Spectrum(1)
        total = mi.Spectrum(0)
        bounces = mi.UInt32(0)
        met = mi.Bool(False)
        limit = 2**20 if self.max_bounces < 0 else self.max_bounces
        while active:
            si = scene.ray_intersect(ray, active)
            met |= (bounces == 0) & si.is_valid()
            total += throughput * si.emitter(scene).eval(si, active)
            active &= si.is_valid() & (bounces < limit)

            bs, weight = si.bsdf(ray).sample(
                ctx, si, sampler.next_1d(active), sampler.next_2d(active), active
            )
            throughput *= weight
            ray = si.spawn_ray(si.to_world(bs.wo))
            bounces += 1

            survives = dr.minimum(dr.max(throughput), 0.95)
            roulette = bounces > 2
            active &= (survives > 0) & (~roulette | (sampler.next_1d(active) < survives))
            throughput[roulette & (survives > 0)] /= survives
        return total, met, []


mi.register_integrator("path_tracer_mats", PathTracerMats)
