"""Given: paths from the camera, and rendering of contributions to any pixel.

You write the paths from the light, and the connections.
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
"""Number of paths that are traced together."""

Land = Callable[[mi.Color3f, mi.Float, mi.Point2f, mi.Bool], None]
"""Function of (spectrum, opl, position, active): contribution and length [m] of a path, position
on the film [pixels], and mask of the lanes."""


@dataclass
class Vertex:
    """A surface point of a path, one for each lane.

    Attributes:
        si: The surface point; `si.wi` leads to the previous vertex.
        β: Throughput of the path on arrival here: the product of all weights so far.
        opl: Optical path length so far [m].
        η: Index of refraction of the medium between the previous vertex and this vertex.
        pdf: Density of the direction from the previous vertex to this vertex [1/sr].
        back: Density of the reverse direction at the previous vertex [1/sr]: of a path from this
            vertex that continues from the previous vertex to the vertex before it; 0 at the ends.
        mirrored: Whether the direction at the previous vertex was a delta component (mirror,
            glass).
        smooth: Lanes in which the vertex can be connected, because its BSDF is not only delta.
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
    """Trace paths from the camera, and return their surface vertices.

    Args:
        scene: The scene.
        sampler: Random numbers.
        camera: Camera rays, see `tofrender.films.contribution.CameraSample`.
        density: Density of their directions [1/sr].
        count: Largest number of vertices.

    Returns:
        The vertices, in their order from the camera.
    """
    ctx = mi.BSDFContext()

    # State of the path; the fields of `Vertex` describe it
    ray = mi.Ray3f(camera.ray)
    before = mi.Point3f(camera.origin)
    β = mi.Color3f(camera.weight)
    opl = mi.Float(0)
    η = mi.Float(1)
    pdf = mi.Float(density)
    back = mi.Float(0)
    mirrored = mi.Bool(False)
    active = mi.Bool(True)
    path: list[Vertex] = []
    for k in range(count):
        # Find the next vertex. Its length is measured from point to point; `si.t` is a bit shorter
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        opl = opl + η * dr.norm(si.p - before)
        bsdf = si.bsdf()
        smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        vertex = Vertex(si, β, opl, η, pdf, back, mirrored, smooth, mi.Bool(active))
        path.append(vertex)

        # Sample the next direction, and evaluate the density of the reverse direction
        if k + 1 < count:
            bs, weight = bsdf.sample(ctx, si, sampler.next_1d(), sampler.next_2d(), active)
            β = β * weight
            pdf = bs.pdf
            mirrored = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            other = mi.SurfaceInteraction3f(si)
            other.wi = bs.wo
            back = bsdf.pdf(ctx, other, si.wi, active & ~mirrored)
            ray = si.spawn_ray(si.to_world(bs.wo))
            before = si.p
            η = η * bs.eta
            active = active & (dr.max(β) > 0)
        dr.eval(vertex, β, pdf, back, mirrored, ray, before, η, active)
    return path


class BothEnds(mi.SamplingIntegrator):
    """Base of integrators that contribute to any pixel: provides `render`; you write `sample`.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 6 | longest path in segments, from light to camera: 2 or more |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", 6)

    def make_lens(self, sensor: mi.Sensor) -> Any:
        """Return your lens of a camera."""
        from lens import Lens

        return Lens(sensor)

    def sample(self, scene, sampler, camera, lens, emission, land):
        """Trace paths from the light and from the camera; a subclass defines it."""
        raise NotImplementedError("BothEnds.sample: a subclass must define it")

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render with the scene's own film; `mi.render` calls this.

        Args:
            scene: The scene.
            sensor: A sensor, or its index in the scene; its film must have time bins.
            seed: Seed of the random numbers.
            spp: Paths per pixel, from the light and from the camera; 0 uses the sampler's number.
            develop: Whether to return the result.
            evaluate: Ignored; Mitsuba passes it.

        Returns:
            Steady image of shape (height, width, 3), and bins of shape (height, width, bins, 3):
            the radiance that arrives in each bin.
        """
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        film = sensor.film()
        spp = spp or sensor.sampler().sample_count()
        sampler = mi.load_dict({"type": "independent", "sample_count": spp})
        film.prepare([])
        film.expect_splats()
        picture = Splats(film, 1)
        lens = self.make_lens(sensor)
        emission = Emission(scene, sensor)
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
                # Samples beyond `spp` in the last block are ignored
                counts = (dr.arange(mi.UInt32, lanes) % at_once) + done < spp

                def land(spectrum, opl, position, active, camera=camera, counts=counts):
                    light = mi.Color3f(spectrum) / spp
                    opl = mi.Float(opl)
                    active = mi.Bool(active) & counts
                    film.add_splat(position, opl, camera.ray.wavelengths, light, active)
                    picture.add(position, [list(light)], 0, active)

                self.sample(scene, sampler, camera, lens, emission, land)
                dr.eval()
                done += at_once
        if not develop:
            return None
        return mi.TensorXf(picture.cells.tensor()[:, :, 0]), film.develop()[1]
