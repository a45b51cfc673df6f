"""Next-event estimation; the next direction is sampled before the light."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class PathTracerNEE(mi.SamplingIntegrator):
    """Path tracing with next-event estimation alone."""

    def __init__(self, props):
        super().__init__(props)
        self.max_bounces = props.get("max_bounces", -1)

    @dr.syntax
    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Estimate the radiance along camera rays."""
        ctx = mi.BSDFContext()
        si = scene.ray_intersect(ray, active)
        met = si.is_valid()
        active = mi.Bool(active)
        throughput = mi.Spectrum(1)
        total = mi.Spectrum(0)
        unconnected = mi.Bool(True)
        left = mi.Int32(2**20 if self.max_bounces < 0 else self.max_bounces)
        wander = mi.Bool(self.max_bounces < 0)
        while active:
            seen = si.emitter(scene).eval(si, active & unconnected)
            total += dr.select(unconnected, throughput * seen, 0)
            active &= si.is_valid() & (left > 0)
            left -= 1

            bsdf = si.bsdf()
            bs, weight = bsdf.sample(
                ctx, si, sampler.next_1d(active), sampler.next_2d(active), active
            )

            ds, arriving = scene.sample_emitter_direction(si, sampler.next_2d(active), True, active)
            reflected = bsdf.eval(ctx, si, si.to_local(ds.d), active)
            total += dr.select(active & (ds.pdf != 0), throughput * reflected * arriving, 0)

            throughput *= weight
            unconnected = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            keep = dr.select(wander, dr.clip(dr.max(throughput), 0.05, 0.9), 1)
            active &= (dr.max(throughput) > 0) & (sampler.next_1d(active) < keep)
            throughput /= keep
            si = scene.ray_intersect(si.spawn_ray(si.to_world(bs.wo)), active)
        return total, met, []


mi.register_integrator("path_tracer_nee", PathTracerNEE)
