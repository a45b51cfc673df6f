"""Given: a steady-state path tracer, which your integrators extend. It does not measure lengths."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def mis_weight(pdf_a: mi.Float, pdf_b: mi.Float) -> mi.Float:
    """MIS weight of a sample with density `pdf_a` by the power heuristic; `pdf_b` is the other."""
    a2 = pdf_a * pdf_a
    return dr.select(pdf_a > 0, a2 / dr.fma(pdf_b, pdf_b, a2), 0)


class PathTracer(mi.SamplingIntegrator):
    """Path tracing with next-event estimation and multiple importance sampling.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 8 | longest path in segments: 1 shows emitters only, 2 adds direct light |
    | `rr_depth` | 5 | surface vertices from which on Russian roulette may end a path |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", 8)
        self.rr_depth = props.get("rr_depth", 5)

    @dr.syntax
    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Estimate radiance along rays; return spectrum, mask of hits, and an empty list."""
        bsdf_ctx = mi.BSDFContext()

        # --------------------- Configure loop state ----------------------

        # fmt: off
        ray = mi.Ray3f(ray)            # Current ray
        depth = mi.UInt32(0)           # Number of surface vertices so far
        L = mi.Color3f(0)              # Radiance of the path so far
        β = mi.Color3f(1)              # Path throughput
        active = mi.Bool(active)       # Lanes that are still traced
        valid = mi.Bool(False)         # Has the camera ray hit a surface?
        # fmt: on

        # Previous vertex, and density and type of the direction from there
        prev_si = dr.zeros(mi.SurfaceInteraction3f)
        prev_pdf = mi.Float(1)
        prev_delta = mi.Bool(True)

        while dr.hint(active, max_iterations=self.max_depth, label="Path tracer"):
            si = scene.ray_intersect(ray, active)
            valid |= active & si.is_valid()

            # ------------------- Emission at the ray's hit -------------------

            ds = mi.DirectionSample3f(scene, si, prev_si)
            em_pdf = scene.pdf_emitter_direction(prev_si, ds, active & ~prev_delta)
            Le = ds.emitter.eval(si, active)
            L += dr.select(active, β * mis_weight(prev_pdf, em_pdf) * Le, 0)

            # Does the path reach one more vertex? (`max_iterations` does not end the loop.)
            active_next = active & si.is_valid() & (depth + 1 < self.max_depth)

            # --------------------- Next-event estimation ---------------------

            bsdf = si.bsdf(ray)
            active_em = active_next & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            ds, em_weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, active_em)
            active_em &= ds.pdf != 0
            wo = si.to_local(ds.d)
            f, bsdf_pdf = bsdf.eval_pdf(bsdf_ctx, si, wo, active_em)  # f includes the cosine
            mis_em = dr.select(ds.delta, 1, mis_weight(ds.pdf, bsdf_pdf))
            L += dr.select(active_em, β * mis_em * f * em_weight, 0)

            # ---------------- BSDF sample: the next direction ----------------

            bs, bsdf_weight = bsdf.sample(
                bsdf_ctx, si, sampler.next_1d(), sampler.next_2d(), active_next
            )
            ray = si.spawn_ray(si.to_world(bs.wo))
            β *= bsdf_weight
            prev_si = dr.detach(si, True)
            prev_pdf = bs.pdf
            prev_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            depth[active_next] += 1

            # ------------------------ Russian roulette -----------------------

            survival = dr.minimum(dr.max(β), 0.95)
            roulette = depth >= self.rr_depth
            β[roulette] *= dr.rcp(survival)
            active_next &= ~roulette | (sampler.next_1d() < survival)
            active = active_next & (dr.max(β) > 0)

        return L, valid, []


mi.register_integrator("a2_path_tracer", PathTracer)
