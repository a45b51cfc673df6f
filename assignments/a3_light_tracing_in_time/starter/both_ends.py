"""Given: paths from the camera, and how light that lands anywhere is rendered.

You write paths from the light, and what connects both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from tofrender.bidirectional.emission import Emission
from tofrender.films.splats import Splats
from tofrender.paths.camera import sample_camera

LANES = 1 << 18
"""Paths that are traced together."""

Land = Callable[[mi.Color3f, mi.Float, mi.Point2f, mi.Bool], None]
"""Takes (spectrum, opl, position, active): what a path carries, its length [m], where on the film
it lands [pixels], and the lanes that have such a path."""


@dataclass
class Vertex:
    """A surface point of a path, one for each lane.

    Attributes:
        si: The surface point; `si.wi` leads to the vertex before.
        β: What the path carries when it arrives here: the product of all weights so far.
        opl: Optical path length so far [m].
        η: Index of refraction around the segment that led here.
        pdf: Density of the direction in which the path has left the vertex before [1/sr].
        back: Density with which a path that comes from here would go on from the vertex before
            to the one before that [1/sr]; 0 if there is none.
        mirrored: Whether the vertex before had no choice: a mirror, or glass.
        smooth: Lanes in which the vertex can be connected to: its material is more than a mirror.
        active: Lanes that have this vertex.
    """

    si: mi.SurfaceInteraction3f
    β: mi.Color3f
    opl: mi.Float
    η: mi.Float
    pdf: mi.Float
    back: mi.Float
    mirrored: mi.Bool
    smooth: mi.Bool
    active: mi.Bool


def camera_path(
    scene: mi.Scene, sampler: mi.Sampler, camera: Any, density: mi.Float, count: int
) -> list[Vertex]:
    """The surface points that a path from the camera meets.

    Args:
        scene: The scene.
        sampler: Random numbers.
        camera: Camera rays, see `tofrender.paths.camera.CameraSample`.
        density: Density of their directions [1/sr].
        count: Most vertices.

    Returns:
        The vertices, the one next to the camera first.
    """
    ctx = mi.BSDFContext()
    ray, before = mi.Ray3f(camera.ray), mi.Point3f(camera.origin)
    β, opl, η = mi.Color3f(camera.weight), mi.Float(0), mi.Float(1)
    pdf, back, mirrored, active = mi.Float(density), mi.Float(0), mi.Bool(False), mi.Bool(True)
    path: list[Vertex] = []
    for k in range(count):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        opl = opl + η * dr.norm(si.p - before)  # from point to point: `si.t` is a little short
        bsdf = si.bsdf()
        smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        vertex = Vertex(si, β, opl, η, pdf, back, mirrored, smooth, mi.Bool(active))
        path.append(vertex)
        if k + 1 < count:
            bs, weight = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), active)
            β = β * weight
            pdf, mirrored = bs.pdf, mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            other = mi.SurfaceInteraction3f(si)
            other.wi = bs.wo
            back = bsdf.pdf(ctx, other, si.wi, active & ~mirrored)
            ray, before, η = si.spawn_ray(si.to_world(bs.wo)), si.p, η * bs.eta
            active = active & (dr.max(β) > 0)
        dr.eval(vertex, β, pdf, back, mirrored, ray, before, η, active)
    return path


class BothEnds(mi.SamplingIntegrator):
    """Base of integrators whose light lands anywhere: `render` is here, `sample` is yours.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 6 | longest path in segments, those at light and camera included: 2 or more |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", 6)

    def make_lens(self, sensor: mi.Sensor) -> Any:
        """The lens of a camera: yours."""
        from lens import Lens

        return Lens(sensor)

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Trace paths from the light and from the camera; a subclass defines it."""
        raise NotImplementedError("BothEnds.sample: a subclass must define it")

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render with the scene's own film; `mi.render` calls this.

        Args:
            scene: The scene.
            sensor: A sensor, or its number in the scene; its film must have time bins.
            seed: Seed of the random numbers.
            spp: Paths per pixel, from the light and from the camera; 0 takes the sampler's.
            develop: Whether to return the result.
            evaluate: Accepted for Mitsuba's sake.

        Returns:
            Steady image of shape (height, width, 3), and bins of shape (height, width, bins, 3):
            the radiance that arrives in each bin.
        """
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        film, spp = sensor.film(), spp or sensor.sampler().sample_count()
        sampler = mi.load_dict({"type": "independent", "sample_count": spp})
        film.prepare([])
        film.expect_splats()
        picture = Splats(film, 1)
        lens, emission = self.make_lens(sensor), Emission(scene, sensor)
        width, height = (int(n) for n in film.crop_size())
        at_once = min(spp, max(1, LANES // (width * height)))
        lanes = width * height * at_once
        done = dr.opaque(mi.UInt32, 0)
        with dr.suspend_grad():
            for first in range(0, spp, at_once):
                block_seed, _ = mi.sample_tea_32(mi.UInt32(seed), mi.UInt32(first))
                sampler.seed(block_seed[0], lanes)
                pixel = dr.arange(mi.UInt32, lanes) // at_once
                camera = sample_camera(sensor, film, sampler, pixel)
                dr.eval(camera.ray, camera.origin, camera.weight, camera.position)
                # Samples beyond `spp` in the last block land nowhere
                counts = (dr.arange(mi.UInt32, lanes) % at_once) + done < spp

                def land(spectrum, opl, position, active, camera=camera, counts=counts):
                    light = mi.Color3f(spectrum) / spp
                    opl, active = mi.Float(opl), mi.Bool(active) & counts
                    film.add_splat(position, opl, camera.ray.wavelengths, light, active)
                    picture.add(position, [list(light)], 0, active)

                self.sample(scene, sampler, camera, lens, emission, land)
                dr.eval()
                done += at_once
        if not develop:
            return None
        return mi.TensorXf(picture.cells.tensor()[:, :, 0]), film.develop()[1]
