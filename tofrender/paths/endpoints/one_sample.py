# pyright: reportArgumentType=false
"""Multiple importance sampling with one sample: of the lights, or of the material."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..records import Connection, Path, Vertex
from ..surfaces import first_surface
from .scene_lights import SceneLights


class OneSampleLights(SceneLights):
    """Light by one ray, whose direction comes from the lights or from the material.

    Each is asked half of the time, and the light that the ray finds is divided by the density of
    the mixture, (p_light + p_material) / 2: the one-sample model with the balance heuristic (Veach
    1997, section 9.2.4). It is as good as `SceneLights` at the first surface with half the samples,
    but has to trace another ray to go on.
    """

    finds_all = True

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """A direction from either technique, and the light that comes from there."""
        si = vertex.si
        to_light = sampler.next_1d() < 0.5
        link = super().connect(vertex, path, sampler, active & to_light)

        # A sample of a mirror's or glass's only direction is left to the path itself
        ctx, bsdf = mi.BSDFContext(), si.bsdf()
        by_material = active & ~to_light
        bs, _ = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), by_material)
        by_material &= (bs.pdf > 0) & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Smooth)
        ray = si.spawn_ray(si.to_world(bs.wo))
        seen = first_surface(self.scene, ray, by_material)
        ahead = Path.start(ray, si.p, by_material)
        ahead.depth = mi.UInt32(1)  # No longer what the sensor sees directly
        found = self.hit(Vertex(seen, dr.norm(seen.p - si.p), seen.is_valid()), ahead)

        # A point light cannot be hit: the lights' half of the samples has all of it
        pdf_material = bsdf.pdf(ctx, si, si.to_local(link.direction), link.active)
        pdf_material = dr.select(link.delta, 0, pdf_material)
        by_light = link.weight * link.pdf
        pdf = 0.5 * dr.select(to_light, link.pdf + pdf_material, found.pdf + bs.pdf)
        return Connection(
            point=dr.select(to_light, link.point, dr.fma(ray.d, found.length, si.p)),
            direction=dr.select(to_light, link.direction, ray.d),
            weight=dr.select(pdf > 0, dr.select(to_light, by_light, found.radiance) / pdf, 0),
            pdf=pdf,
            delta=mi.Bool(True),
            length=dr.select(to_light, link.length, found.length),
            active=dr.select(to_light, link.active, by_material),
            clear=~to_light,
        )
