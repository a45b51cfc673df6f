"""Gates by a list of contributions: a Python loop over bounces writes down every (light, length).

Paths are evaluated bounce by bounce, without a symbolic loop. The contributions are weighted by the
gates afterwards. Both strategies find emitters, with the balance
heuristic; the material is sampled before the light.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from gaussian_pulse import GaussianPulse

from tofrender.paths.camera import sample_camera


class TimeGatedTransientPath(mi.SamplingIntegrator):
    """Path tracer that sees one instant."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", 8)
        self.rr_depth = props.get("rr_depth", 5)
        self.pulse: Any = GaussianPulse(props.get("pulse_width_opl", 0.03))

    def sample(self, scene, sampler, ray, target_time, medium=None, active=True, origin=None):
        """Radiance per meter along rays at one instant."""
        arrivals, valid = self.arrivals(scene, sampler, ray, active, origin)
        result = mi.Color3f(0)
        for light, opl in arrivals:
            result += light * self.pulse.eval(target_time - opl)
        return result, valid, []

    def arrivals(self, scene, sampler, ray, active=True, origin=None):
        """All contributions of paths, (light, length), and the lanes that met a surface."""
        ctx = mi.BSDFContext()
        ray, active = mi.Ray3f(ray), mi.Bool(active)
        before = dr.zeros(mi.SurfaceInteraction3f)
        before.p = ray.o if origin is None else origin
        throughput = mi.Color3f(1)
        length = mi.Float(0)
        density = mi.Float(0)
        delta = mi.Bool(True)
        arrivals = []
        valid = mi.Bool(False)
        for segment in range(1, self.max_depth + 1):
            si = scene.ray_intersect(ray, active)
            valid |= active & si.is_valid()
            length += dr.norm(si.p - before.p)

            emitter = si.emitter(scene)
            ds = mi.DirectionSample3f(scene, si, before)
            light_density = scene.pdf_emitter_direction(before, ds, active & ~delta)
            share = dr.select(delta, 1, density / (density + light_density))
            light = dr.select(active, throughput * share * emitter.eval(si, active), 0)
            arrivals.append((light, mi.Float(length)))

            active &= si.is_valid()
            if segment == self.max_depth:
                break
            bsdf = si.bsdf(ray)
            bs, weight = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), active)
            ds, em_weight = scene.sample_emitter_direction(si, sampler.next_2d(), True, active)
            f, material_density = bsdf.eval_pdf(ctx, si, si.to_local(ds.d), active)
            share = dr.select(ds.delta, 1, ds.pdf / (ds.pdf + material_density))
            connected = active & (ds.pdf > 0)
            light = dr.select(connected, throughput * share * f * em_weight, 0)
            arrivals.append((light, length + dr.norm(ds.p - si.p)))

            throughput *= weight
            density = mi.Float(bs.pdf)
            delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            before = si
            ray = si.spawn_ray(si.to_world(bs.wo))
            active &= dr.max(throughput) > 0
            if segment >= self.rr_depth:
                survival = dr.clip(dr.max(throughput), 0.05, 0.95)
                active &= sampler.next_1d() < survival
                throughput /= survival
            dr.eval(ray, throughput, density, delta, before, length, active, arrivals)
        return arrivals, valid


def render_at_time(
    scene: mi.Scene,
    integrator: TimeGatedTransientPath,
    sensor: mi.Sensor,
    target_time: float,
    spp: int = 64,
    seed: int = 0,
) -> np.ndarray:
    """Render the scene at one instant."""
    camera, sampler, (height, width) = _camera(sensor, spp, seed)
    value, _, _ = integrator.sample(
        scene, sampler, camera.ray, mi.Float(target_time), origin=camera.origin
    )
    value = mi.Color3f(value * camera.weight)
    dr.eval(value)
    image = np.stack([np.array(channel) for channel in value], axis=-1, dtype=np.float64)
    return image.reshape(height, width, spp, 3).mean(axis=2).astype(np.float32)


def render_transient(
    scene: mi.Scene,
    integrator: TimeGatedTransientPath,
    sensor: mi.Sensor,
    film_config: Mapping[str, Any],
    spp: int = 64,
    seed: int = 0,
) -> np.ndarray:
    """Render many instants: each arrival is seen by the gates that its pulse reaches."""
    bins, start, width_opl = (
        film_config[key] for key in ("temporal_bins", "start_opl", "bin_width_opl")
    )
    camera, sampler, (height, width) = _camera(sensor, spp, seed)
    arrivals, _ = integrator.arrivals(scene, sampler, camera.ray, origin=camera.origin)
    pixel = dr.arange(mi.UInt32, height * width * spp) // spp
    cube = dr.zeros(mi.Float, height * width * bins * 3)
    low, high = integrator.pulse.support
    reach = int(np.ceil((high - low) / width_opl)) + 1
    for light, opl in arrivals:
        light = light * camera.weight / spp
        first = dr.ceil((opl + low - start) / width_opl - 0.5)
        for k in range(reach):
            gate = first + k
            weight = integrator.pulse.eval(start + (gate + 0.5) * width_opl - opl)
            there = (gate >= 0) & (gate < bins) & (dr.max(light) > 0)
            cell = (pixel * bins + mi.UInt32(dr.select(there, gate, 0))) * 3
            for c in range(3):
                dr.scatter_add(cube, light[c] * weight, cell + c, there)
        dr.eval(cube)
    return np.array(cube).reshape(height, width, bins, 3)


def _camera(sensor, spp, seed):
    """A random ray for each sample of each pixel."""
    film = sensor.film()
    width, height = (int(size) for size in film.crop_size())
    sampler = mi.load_dict({"type": "independent", "sample_count": spp})
    sampler.seed(seed, width * height * spp)
    pixel = dr.arange(mi.UInt32, width * height * spp) // spp
    camera = sample_camera(sensor, film, sampler, pixel)
    dr.eval(camera.ray, camera.origin, camera.weight)
    return camera, sampler, (height, width)
