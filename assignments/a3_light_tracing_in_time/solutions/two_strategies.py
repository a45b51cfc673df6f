"""Two strategies by products over whole paths: what one end has chosen, over what the other would.

With surface points 1 to m from one end, all distances but that to the lens cancel out.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from both_ends import BothEnds, Vertex, camera_path


def cosine(si, d):
    """Cosine between a surface and a direction."""
    return dr.abs(dr.dot(si.n, d))


def density_back(si, d, active):
    """Density of the reverse direction: from d, and back to the previous vertex."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = si.to_local(d)
    return si.bsdf().pdf(mi.BSDFContext(), other, si.wi, active)


def light_path(scene, sampler, emitted, count):
    """Surface vertices of a light path, by steps that use only the previous step."""
    ray = mi.Ray3f(emitted.ray)
    before = emitted.origin
    opl = mi.Float(0)
    η = mi.Float(1)
    β = mi.Color3f(emitted.weight)
    chosen = (emitted.density, mi.Float(0), mi.Bool(False))
    active = mi.Bool(emitted.active)
    path = []
    while True:
        si = scene.ray_intersect(ray, active)
        active = active & si.is_valid() & (dr.max(β) > 0)
        opl = opl + η * dr.norm(si.p - before)
        smooth = active & mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
        path.append(Vertex(si, β, opl, η, *chosen, smooth, active))
        dr.eval(path[-1])
        if len(path) == count:
            return path
        bs, weight = si.bsdf().sample(
            mi.BSDFContext(mi.TransportMode.Importance),
            *(si, sampler.next_1d(), sampler.next_2d(), active),
        )
        d = si.to_world(bs.wo)
        mirrored = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        chosen = bs.pdf, density_back(si, d, active & ~mirrored), mirrored
        β = β * weight
        η = η * bs.eta
        before = si.p
        ray = si.spawn_ray(d)


def unoccluded(scene, si, point, active):
    """Lanes in which nothing is between a surface point and another point."""
    return active & ~scene.ray_test(si.spawn_ray_to(point), active)


def chain(path, m, back):
    """Ratio of densities from the other end and from this end, for the points before m."""
    ratio = mi.Float(1)
    for i in range(1, m):
        here = path[i]
        before = path[i - 1]
        d = dr.normalize(here.si.p - before.si.p)
        other = back  # of the last but one, unless a vertex knows better
        if i < m - 1:
            other = dr.select(path[i + 1].mirrored, 1, path[i + 1].back)
        own = dr.select(here.mirrored, 1, here.pdf)
        below = own * cosine(here.si, d)
        ratio *= dr.select(below > 0, other * cosine(before.si, d) / below, 0)
    return ratio


class TransientTwoStrategies(BothEnds):
    """Next-event estimation from the camera, and connections of light to the lens."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.end = str(props.get("end", "both"))

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Both ends, one after the other."""
        if self.end != "camera":
            self.from_light(scene, sampler, camera, lens, emission, land)
        if self.end != "light":
            self.from_camera(scene, sampler, camera, lens, emission, land)

    def from_light(self, scene, sampler, camera, lens, emission, land):
        """Connections to the lens, with the share of this strategy."""
        ctx = mi.BSDFContext(mi.TransportMode.Importance)
        emitted = emission.sample(sampler, camera.ray)
        path = light_path(scene, sampler, emitted, self.max_depth - 1)
        first = path[0]
        ds = dr.zeros(mi.DirectionSample3f, dr.width(first.opl))
        ds.p = emitted.origin
        ds.n = emitted.normal
        ds.uv = emitted.uv
        ds.emitter = emitted.emitter
        ds.d = -emitted.ray.d
        ds.dist = first.opl
        pdf = scene.pdf_emitter_direction(first.si, ds, first.active & ~emitted.delta)
        ratio = emission.ratio(emitted.emitter, ds, pdf, first.opl)
        start = ratio / cosine(first.si, emitted.ray.d)
        start = dr.select(first.smooth, start, 0)
        for m, vertex in enumerate(path, 1):
            si = vertex.si
            arrival = lens.arrive(si.p, lens.sample(sampler))
            active = unoccluded(scene, si, arrival.near, vertex.smooth & arrival.seen)
            f = si.bsdf().eval(ctx, si, si.to_local(arrival.direction), active)
            back = density_back(si, arrival.direction, active)
            seen = arrival.density / dr.square(arrival.distance)
            rival = start * chain(path, m, back) * seen * cosine(si, arrival.direction)
            light = vertex.β * f * seen / (1 + rival * rival)
            opl = vertex.opl + vertex.η * arrival.distance
            land(light, opl, arrival.position, active)
            dr.eval()

    def from_camera(self, scene, sampler, camera, lens, emission, land):
        """Next-event estimation, with the share of that."""
        ctx = mi.BSDFContext()
        density = lens.density(camera.ray.d)
        path = camera_path(scene, sampler, camera, density, self.max_depth - 1)
        first = path[0]
        seen = density * cosine(first.si, camera.ray.d) / dr.square(first.opl)
        end = dr.select(first.smooth & (seen > 0), 1 / seen, 0)
        for m, vertex in enumerate(path, 1):
            si = vertex.si
            active = vertex.smooth
            ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, active)
            active = active & (ds.pdf > 0)
            f = si.bsdf().eval(ctx, si, si.to_local(ds.d), active)
            ratio = emission.ratio(ds.emitter, ds, ds.pdf, ds.dist)
            back = density_back(si, ds.d, active)
            rival = end * chain(path, m, back) * cosine(si, ds.d) / ratio
            light = vertex.β * f * weight / (1 + rival * rival)
            land(light, vertex.opl + vertex.η * ds.dist, camera.position, active)
            dr.eval()
