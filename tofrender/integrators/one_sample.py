"""One-sample multiple importance sampling of emitters and BSDFs."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..paths.endpoints.emitters import EmitterEndpoint
from ..paths.records import Connection, Hit, Path, Vertex
from ..paths.surfaces import Boundaries, first_surface
from ..runtime import checks


class OneSampleLights(EmitterEndpoint):
    """Light along one ray, with a direction from an emitter sample or a BSDF sample.

    Both techniques are chosen with the probability 1/2. The light along the ray is divided by the
    density of the mixture, (p_emitter + p_bsdf) / 2. This is the one-sample model with the balance
    heuristic (Veach 1997, section 9.2.4). At the first surface, the noise is the same as for
    `SceneLights` with half as many samples, but another ray is needed to continue the path.

    Args:
        scene: The scene.
        sensor: As in `SceneLights`.
        hide_emitters: As in `SceneLights`.
        discard_direct_light: As in `SceneLights`.
        passes_boundaries: Whether rays pass index-matched boundaries. Only emitter samples then
            find emitters on such boundaries.
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
        """Return 1 after delta lobes, otherwise 0."""
        return dr.select(path.specular, mi.Float(1), 0)

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample a direction with one of the techniques, and the light from this direction."""
        # Choose a technique, and sample an emitter
        si = vertex.si
        to_light = sampler.next_1d() < 0.5
        connection = self.sample_emitter(vertex, sampler.next_2d(), active & to_light)

        # Sample the BSDF. Delta lobes do not count here, because the path follows them
        ctx = mi.BSDFContext()
        bsdf = si.bsdf()
        by_material = active & ~to_light
        bs, _ = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), by_material)
        by_material &= (bs.pdf > 0) & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Smooth)

        # Find the emitter in the direction of the BSDF sample
        ray = si.spawn_ray(si.to_world(bs.wo))
        if self.passes_boundaries:
            seen = first_surface(self.scene, ray, by_material)
        else:
            seen = self.scene.ray_intersect(ray, by_material)
        ahead = Path.start(ray, si.p, by_material)

        # The sensor does not see this emitter directly
        ahead.depth = mi.UInt32(1)
        ahead.valid_ray = mi.Bool(True)
        found = self.emitted_radiance(Vertex(seen, dr.norm(seen.p - si.p), seen.is_valid()), ahead)

        # BSDF samples do not find emitters that rays cannot hit
        pdf_material = bsdf.pdf(ctx, si, si.to_local(connection.direction), connection.active)
        cannot_be_hit = connection.delta
        if self.passes_boundaries:
            assert connection.emitter is not None
            shape = connection.emitter.get_shape()
            on_boundary = self.boundaries.have(shape.bsdf(), connection.active)
            cannot_be_hit = cannot_be_hit | on_boundary
        pdf_material = dr.select(cannot_be_hit, 0, pdf_material)

        # Divide the light by the density of the mixture
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
