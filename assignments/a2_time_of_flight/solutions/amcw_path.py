"""Correlation with one-sample MIS: a coin chooses between two strategies for emitters.

At each vertex, either the connection or the next ray counts, with the balance heuristic of the two
strategies that the coin chooses between. (Point lights and mirrors are found by one only.)
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from amcw_pulse import AMCWPulse

from tofrender.paths.camera import sample_camera
from tofrender.signals.units import SPEED_OF_LIGHT


class AMCWTransientPath(mi.SamplingIntegrator):
    """Path tracer for amplitude-modulated light."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", 8)
        self.rr_depth = props.get("rr_depth", 5)
        self.modulation: Any = None

    def set_modulation(self, modulation: Any) -> None:
        """Set the modulation."""
        self.modulation = modulation

    def sample(self, scene, sampler, ray, medium=None, active=True, origin=None):
        """Correlation along rays."""
        start = mi.Point3f(ray.o if origin is None else origin)
        return (*_follow(self, scene, sampler, ray, start, self.modulation, active), [])


@dr.syntax
def _follow(tracer, scene, sampler, ray, start, modulation, active):
    ctx = mi.BSDFContext()
    ray = mi.Ray3f(ray)
    depth = mi.UInt32(0)
    total = mi.Color3f(0)
    throughput = mi.Color3f(1)
    opl = mi.Float(0)
    here = mi.Point3f(start)
    before = dr.zeros(mi.SurfaceInteraction3f)
    ray_pdf = mi.Float(0)
    only_rays = mi.Bool(True)  # Can nothing but a ray find the light from the last vertex?
    rays_count = mi.Bool(True)  # Result of the coin there
    active = mi.Bool(active)
    valid = mi.Bool(False)

    while active:
        si = scene.ray_intersect(ray, active)
        found = active & si.is_valid()
        valid |= found
        opl += dr.norm(si.p - here)
        ds = mi.DirectionSample3f(scene, si, before)
        light_pdf = scene.pdf_emitter_direction(before, ds, found & ~only_rays)
        share = dr.select(rays_count, 2 * ray_pdf / (ray_pdf + light_pdf), 0)
        share = dr.select(only_rays, 1, share)
        Le = si.emitter(scene).eval(si, found)
        m = modulation.eval(opl)
        total += dr.select(found, throughput * share * Le * m, 0)

        found &= depth + 1 < tracer.max_depth
        bsdf = si.bsdf(ray)
        heads = sampler.next_1d() < 0.5
        ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, found)
        f, pdf = bsdf.eval_pdf(ctx, si, si.to_local(ds.d), found)
        share = dr.select(heads, 2 * ds.pdf / (ds.pdf + pdf), 0)
        share = dr.select(ds.delta, 1, share)
        m = modulation.eval(opl + dr.norm(ds.p - si.p))
        total += dr.select(found & (ds.pdf > 0), throughput * share * f * weight * m, 0)

        bs, weight = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), found)
        throughput *= weight
        ray = si.spawn_ray(si.to_world(bs.wo))
        here = mi.Point3f(si.p)
        before = si
        ray_pdf = mi.Float(bs.pdf)
        only_rays = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        rays_count = ~heads
        depth += 1
        brightest = dr.max(throughput)
        survival = dr.select(depth >= tracer.rr_depth, dr.minimum(brightest, 0.95), 1)
        throughput *= dr.select(survival > 0, dr.rcp(survival), 0)
        active = found & (brightest > 0) & (sampler.next_1d() < survival)

    return total, valid


def render_single_amcw(
    scene: mi.Scene, integrator: AMCWTransientPath, sensor: mi.Sensor, spp: int = 64, seed: int = 0
) -> np.ndarray:
    """Render one correlation image."""
    film = sensor.film()
    width, height = (int(size) for size in film.crop_size())
    sampler = mi.load_dict({"type": "independent", "sample_count": spp})
    sampler.seed(seed, width * height * spp)
    lane = dr.arange(mi.UInt32, width * height * spp)
    camera = sample_camera(sensor, film, sampler, lane // spp)
    value, _, _ = integrator.sample(scene, sampler, camera.ray, origin=camera.origin)
    value = mi.Color3f(value * camera.weight)
    dr.eval(value)
    channels = [np.array(c, np.float64).reshape(height, width, spp).mean(axis=2) for c in value]
    return np.stack(channels, axis=-1).astype(np.float32)


def render_amcw_phasor(
    scene: mi.Scene, sensor: mi.Sensor, frequency_hz: float, spp: int = 64, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """I and Q by two renders of the same paths."""
    integrator = AMCWTransientPath(mi.Properties())
    parts = []
    for offset in (0.0, -np.pi / 2):
        integrator.set_modulation(AMCWPulse(frequency_hz, offset))
        parts.append(render_single_amcw(scene, integrator, sensor, spp, seed).astype(np.float64))
    phase = np.arctan2(parts[1], parts[0])
    turns = np.where(phase < 0, phase + 2 * np.pi, phase) / (2 * np.pi)
    depth = turns * SPEED_OF_LIGHT / (2 * frequency_hz)
    return parts[0], parts[1], np.hypot(*parts), phase, depth
