"""Multiple importance sampling with one sample: of the lights, or of the material."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .scene_lights import Connection, PathState, SceneLights


class OneSampleLights(SceneLights):
    """Light by one ray, whose direction comes from the lights or from the material.

    Each is asked half of the time, and the light that the ray finds is divided by the density of
    the mixture, (p_light + p_material) / 2: the one-sample model with the balance heuristic (Veach
    1997, section 9.2.4). It is as good as `SceneLights` at the first surface with half the samples,
    but has to trace another ray to go on.
    """

    finds_all = True

    def connect(
        self,
        si: mi.SurfaceInteraction3f,
        path: PathState,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Sample a direction, from either technique, and take the light that comes from there."""
        to_light = sampler.next_1d() < 0.5
        em = super().connect(si, path, sampler, active & to_light)

        # A sample of a mirror's or glass's only direction is left to the path itself
        ctx, bsdf = mi.BSDFContext(), si.bsdf()
        by_material = active & ~to_light
        bs, _ = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), by_material)
        by_material &= (bs.pdf > 0) & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Smooth)
        ray = si.spawn_ray(si.to_world(bs.wo))
        seen = self.scene.ray_intersect(ray, by_material)
        Le, pdf_light, length = self.hit(seen, si, ray, by_material)

        # A point light cannot be hit: the lights' half of the samples has all of it
        pdf_material = bsdf.pdf(ctx, si, si.to_local(em.direction), em.active)
        pdf_material = dr.select(em.delta, 0, pdf_material)
        by_light = em.weight * em.pdf
        pdf = 0.5 * dr.select(to_light, em.pdf + pdf_material, pdf_light + bs.pdf)
        return Connection(
            direction=dr.select(to_light, em.direction, ray.d),
            weight=dr.select(pdf > 0, dr.select(to_light, by_light, Le) / pdf, 0),
            pdf=pdf,
            delta=mi.Bool(True),
            length=dr.select(to_light, em.length, length),
            active=dr.select(to_light, em.active, by_material),
        )
