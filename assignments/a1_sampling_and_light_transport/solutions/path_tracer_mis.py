"""One-sample MIS: a coin chooses the technique, the mean of both densities divides."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class PathTracerMIS(mi.SamplingIntegrator):
    """Path tracing with multiple importance sampling."""

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
        total = si.emitter(scene).eval(si, active)
        throughput = mi.Spectrum(1)
        left = mi.Int32(2**20 if self.max_bounces < 0 else self.max_bounces)
        wander = mi.Bool(self.max_bounces < 0)
        active &= met & (left > 0)
        while active:
            left -= 1
            bsdf = si.bsdf()

            # The light's half: points on lights, over the mean of both densities
            lights = sampler.next_1d(active) < 0.5
            ds, arriving = scene.sample_emitter_direction(
                si, sampler.next_2d(active), True, active & lights
            )
            wo = si.to_local(ds.d)
            reflected = bsdf.eval(ctx, si, wo, active & lights)
            pdf = dr.select(ds.delta, 0, bsdf.pdf(ctx, si, wo, active & lights))
            share = ds.pdf / (0.5 * (ds.pdf + pdf))
            count = active & lights & (ds.pdf > 0)
            total += dr.select(count, throughput * reflected * arriving * share, 0)

            # The material's half; what a mirror shows can come from no light's sample
            bs, weight = bsdf.sample(
                ctx, si, sampler.next_1d(active), sampler.next_2d(active), active
            )
            mirror = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            towards = scene.ray_intersect(si.spawn_ray(si.to_world(bs.wo)), active)
            emitter = towards.emitter(scene)
            seen = emitter.eval(towards, active)
            hit = mi.DirectionSample3f(scene, towards, si)
            smooth = active & ~mirror & ~lights & (emitter != None)  # noqa: E711
            pdf = scene.pdf_emitter_direction(si, hit, smooth)
            share = dr.select(mirror, 1, bs.pdf / (0.5 * (bs.pdf + pdf)))
            count = active & (mirror | (~lights & (bs.pdf > 0)))
            total += dr.select(count, throughput * weight * seen * share, 0)

            # Sample the next direction separately; emission that it hits is already counted
            bs, weight = bsdf.sample(
                ctx, si, sampler.next_1d(active), sampler.next_2d(active), active
            )
            throughput *= weight
            onwards = si.spawn_ray(si.to_world(bs.wo))
            keep = dr.select(wander, dr.clip(dr.max(throughput), 0.05, 0.9), 1)
            active &= (left > 0) & (dr.max(throughput) > 0) & (sampler.next_1d(active) < keep)
            throughput /= keep
            si = scene.ray_intersect(onwards, active)
            active &= si.is_valid()
        return total, met, []


mi.register_integrator("path_tracer_mis", PathTracerMIS)
