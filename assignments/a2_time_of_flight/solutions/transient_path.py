"""Transient paths with a random moment of emission: each contribution draws its own offset."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from film_integrator import FilmIntegrator
from gaussian_pulse import GaussianPulse
from path_tracer import mis_weight


class TransientPath(FilmIntegrator):
    """Path tracer into a film with time bins."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if "pulse_width_opl" in props:
            self.pulse = GaussianPulse(props["pulse_width_opl"])

    @dr.syntax
    def sample(self, scene, sampler, ray, deposit, origin, active=True):
        """Follow paths; the length of a connection is known before its light."""
        ctx = mi.BSDFContext()
        ray = mi.Ray3f(ray)
        depth = mi.UInt32(0)
        L = mi.Color3f(0)
        β = mi.Color3f(1)
        opl = mi.Float(0)
        active = mi.Bool(active)
        valid = mi.Bool(False)
        prev_si = dr.zeros(mi.SurfaceInteraction3f)
        prev_si.p = mi.Point3f(origin)
        prev_pdf = mi.Float(1)
        prev_delta = mi.Bool(True)

        while dr.hint(active, max_iterations=self.max_depth, label="Transient path"):
            si = scene.ray_intersect(ray, active)
            opl += dr.norm(si.p - prev_si.p)
            valid |= active & si.is_valid()

            ds = mi.DirectionSample3f(scene, si, prev_si)
            em_pdf = scene.pdf_emitter_direction(prev_si, ds, active & ~prev_delta)
            mis = mis_weight(prev_pdf, em_pdf)
            Le = β * mis * ds.emitter.eval(si, active)
            lit = active & (dr.max(Le) > 0)
            L += dr.select(lit, Le, 0)
            deposit(Le, opl, lit)

            active_next = active & si.is_valid() & (depth + 1 < self.max_depth)
            bsdf = si.bsdf(ray)
            ds, em_weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, active_next)
            f, bsdf_pdf = bsdf.eval_pdf(ctx, si, si.to_local(ds.d), active_next)
            mis = dr.select(ds.delta, 1, mis_weight(ds.pdf, bsdf_pdf))
            Lr = β * mis * f * em_weight
            lit = active_next & (ds.pdf != 0) & (dr.max(Lr) > 0)
            L += dr.select(lit, Lr, 0)
            deposit(Lr, opl + dr.norm(ds.p - si.p), lit)

            bs, bsdf_weight = bsdf.sample(
                ctx, si, sampler.next_1d(), sampler.next_2d(), active_next
            )
            ray = si.spawn_ray(si.to_world(bs.wo))
            β *= bsdf_weight
            prev_si = dr.detach(si, True)
            prev_pdf = bs.pdf
            prev_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            depth[active_next] += 1
            survival = dr.minimum(dr.max(β), 0.95)
            roulette = depth >= self.rr_depth
            β[roulette] *= dr.rcp(survival)
            active_next &= ~roulette | (sampler.next_1d() < survival)
            active = active_next & (dr.max(β) > 0)

        return L, valid

    def spread(self, film, put, sampler, spectrum, opl, active):
        """Light that was emitted at the offset t arrives at opl + t."""
        t, weight = self.pulse.sample(sampler.next_1d())
        put(spectrum * weight, opl + t, active)


mi.register_integrator("transient_path", TransientPath)
