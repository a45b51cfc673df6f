"""Light tracing by a list of vertices, which are connected when the path is complete."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from both_ends import BothEnds, Vertex


def light_path(scene, sampler, emitted, count):
    """Surface vertices of a light path, in their order from the light."""
    radiance = mi.BSDFContext()
    importance = mi.BSDFContext(mi.TransportMode.Importance)
    ray = mi.Ray3f(emitted.ray)
    before = mi.Point3f(emitted.origin)
    β, opl, η = mi.Color3f(emitted.weight), mi.Float(0), mi.Float(1)
    pdf = mi.Float(emitted.density)
    back = mi.Float(0)
    mirrored = mi.Bool(False)
    active = mi.Bool(emitted.active)
    path = []
    for k in range(count):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        opl = opl + η * dr.norm(si.p - before)
        bsdf = si.bsdf()
        smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        vertex = Vertex(si, β, opl, η, pdf, back, mirrored, smooth, mi.Bool(active))
        path.append(vertex)
        if k + 1 < count:
            bs, weight = bsdf.sample(importance, si, sampler.next_1d(), sampler.next_2d(), active)
            β = β * weight
            pdf = bs.pdf
            mirrored = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            other = mi.SurfaceInteraction3f(si)
            other.wi = bs.wo
            back = bsdf.pdf(radiance, other, si.wi, active & ~mirrored)
            ray, before, η = si.spawn_ray(si.to_world(bs.wo)), si.p, η * bs.eta
            active = active & (dr.max(β) > 0)
        dr.eval(vertex, β, pdf, back, mirrored, ray, before, η, active)
    return path


def unoccluded(scene, si, point, active):
    """Lanes in which nothing is between a surface point and another point."""
    return active & ~scene.ray_test(si.spawn_ray_to(point), active)


class TransientLightTracer(BothEnds):
    """Light tracing: connect each vertex of a path from the light to the lens."""

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Trace paths from the light, and connect their vertices."""
        ctx = mi.BSDFContext(mi.TransportMode.Importance)
        emitted = emission.sample(sampler, camera.ray)
        for vertex in light_path(scene, sampler, emitted, self.max_depth - 1):
            si = vertex.si
            arrival = lens.arrive(si.p, lens.sample(sampler))
            active = unoccluded(scene, si, arrival.near, vertex.smooth & arrival.seen)
            f = si.bsdf().eval(ctx, si, si.to_local(arrival.direction), active)
            light = vertex.β * f * (arrival.density / dr.square(arrival.distance))
            opl = vertex.opl + vertex.η * arrival.distance
            land(light, opl, arrival.position, active)
            dr.eval()
