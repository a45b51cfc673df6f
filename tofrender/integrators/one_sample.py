"""One-sample multiple importance sampling of emitters and BSDFs."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..paths.endpoints.emitters import EmitterEndpoint
from ..paths.records import Connection, Hit, Path, Vertex
from ..paths.surfaces import Boundaries, first_surface
from ..runtime import checks


class OneSampleLights(EmitterEndpoint):
    """Light along one ray, whose direction is sampled from the emitters or from the BSDF.

    Each is chosen half of the time, and the light that the ray finds is divided by the density of
    the mixture, (p_emitter + p_bsdf) / 2: the one-sample model with the balance heuristic (Veach
    1997, section 9.2.4). It is as good as `SceneLights` at the first surface with half the samples,
    but has to trace another ray to go on. Arguments as for `SceneLights`.

    With `passes_boundaries`, rays pass index-matched boundaries. Emitters on such boundaries are
    then found by emitter samples alone.
    """

    finds_all = True

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        hide_emitters: bool = False,
        discard_direct_light: bool = False,
        passes_boundaries: bool = False,
    ) -> None:
        super().__init__(scene, sensor, hide_emitters, discard_direct_light)
        self.passes_boundaries = checks.boolean("passes_boundaries", passes_boundaries)
        self.boundaries = Boundaries(scene)

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return 1 after delta lobes, else 0."""
        return dr.select(path.specular, mi.Float(1), 0)

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample a direction from either technique, and the light that comes from there."""
        si = vertex.si
        to_light = sampler.next_1d() < 0.5
        connection = self.sample_emitter(vertex, sampler.next_2d(), active & to_light)

        # The path itself follows samples of delta lobes
        ctx, bsdf = mi.BSDFContext(), si.bsdf()
        by_material = active & ~to_light
        bs, _ = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), by_material)
        by_material &= (bs.pdf > 0) & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Smooth)
        ray = si.spawn_ray(si.to_world(bs.wo))
        if self.passes_boundaries:
            seen = first_surface(self.scene, ray, by_material)
        else:
            seen = self.scene.ray_intersect(ray, by_material)
        ahead = Path.start(ray, si.p, by_material)
        ahead.depth = mi.UInt32(1)  # Not what the sensor sees directly
        ahead.valid_ray = mi.Bool(True)
        found = self.emitted_radiance(Vertex(seen, dr.norm(seen.p - si.p), seen.is_valid()), ahead)

        # Emitters that cannot be hit are found by emitter samples alone
        pdf_material = bsdf.pdf(ctx, si, si.to_local(connection.direction), connection.active)
        cannot_be_hit = connection.delta
        if self.passes_boundaries:
            assert connection.emitter is not None
            shape = connection.emitter.get_shape()
            on_boundary = self.boundaries.have(shape.bsdf(), connection.active)
            cannot_be_hit = cannot_be_hit | on_boundary
        pdf_material = dr.select(cannot_be_hit, 0, pdf_material)
        by_light = connection.weight * connection.pdf
        pdf = 0.5 * dr.select(to_light, connection.pdf + pdf_material, found.pdf + bs.pdf)
        return Connection(
            point=dr.select(to_light, connection.point, dr.fma(ray.d, found.length, si.p)),
            direction=dr.select(to_light, connection.direction, ray.d),
            weight=dr.select(pdf > 0, dr.select(to_light, by_light, found.radiance) / pdf, 0),
            pdf=pdf,
            length=dr.select(to_light, connection.length, found.length),
            active=dr.select(to_light, connection.active, by_material),
            unoccluded=~to_light,
        )
