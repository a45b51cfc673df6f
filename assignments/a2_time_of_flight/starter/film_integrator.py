"""Given: rendering into a film with time bins. You write the paths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from tofrender.paths.camera import sample_camera

RAYS = 1 << 20
"""Number of camera rays that are traced together."""

Put = Callable[[mi.Color3f, mi.Float, mi.Bool], None]
"""Function of (spectrum, opl, active): radiance and length [m] of a path, and mask of the lanes."""


class FilmIntegrator(mi.SamplingIntegrator):
    """Base of integrators for a `transient_hdr_film`: provides `render`; you write `sample`.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 8 | longest path in segments, including the camera's segment |
    | `rr_depth` | 5 | surface vertices from which on Russian roulette may end a path |

    Attributes:
        pulse: Pulse that spreads the light over time: an object with the methods of
            `GaussianPulse`, or None for an instantaneous pulse.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", 8)
        self.rr_depth = props.get("rr_depth", 5)
        self.pulse: Any = None

    def sample(self, scene, sampler, ray, deposit, origin, active=True):
        """Trace paths from camera rays; a subclass defines it."""
        raise NotImplementedError("FilmIntegrator.sample: a subclass must define it")

    def spread(self, film, put, sampler, spectrum, opl, active):
        """Spread a contribution over the film's bins by the pulse; a subclass defines it."""
        raise NotImplementedError("FilmIntegrator.spread: a subclass must define it")

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render with the scene's own film and sampler; `mi.render` calls this.

        Args:
            scene: The scene.
            sensor: A sensor, or its index in the scene; its film must have time bins.
            seed: Seed of the random numbers.
            spp: Samples per pixel, up to 65536; 0 uses the sampler's number.
            develop: Whether to return the result.
            evaluate: Ignored; Mitsuba passes it.

        Returns:
            Steady image of shape (height, width, 3), and bins of shape (height, width, bins, 3):
            the radiance that arrives in each bin.
        """
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        film = sensor.film()
        sampler = sensor.sampler().clone()
        if not hasattr(film, "add_transient_data"):
            raise TypeError(f"film: is a {film.class_name()}; must be a transient_hdr_film")
        spp = spp or sampler.sample_count()
        if spp > 1 << 16:
            raise ValueError(f"spp = {spp}: must be at most 65536; average several renders instead")
        sampler.set_sample_count(spp)
        sampler.set_samples_per_wavefront(spp)
        film.prepare([])
        pixels = film.crop_size()[0] * film.crop_size()[1]
        block = max(1, RAYS // spp)
        with dr.suspend_grad():
            for first in range(0, pixels, block):
                number = min(block, pixels - first)
                block_seed, _ = mi.sample_tea_32(mi.UInt32(seed), mi.UInt32(first))
                sampler.seed(block_seed[0], number * spp)
                self._render_block(scene, sensor, film, sampler, first, number, spp)
        return film.develop() if develop else None

    def _render_block(self, scene, sensor, film, sampler, first, number, spp) -> None:
        """Trace all camera rays of some pixels."""
        pixel = dr.opaque(mi.UInt32, first) + dr.arange(mi.UInt32, number * spp) // spp
        camera = sample_camera(sensor, film, sampler, pixel)
        weight = camera.weight / spp

        def put(spectrum: mi.Color3f, opl: mi.Float, active: mi.Bool) -> None:
            film.add_transient_data(
                camera.position, opl, camera.ray.wavelengths, spectrum * weight, mi.Float(1), active
            )

        def deposit(spectrum: mi.Color3f, opl: mi.Float, active: mi.Bool) -> None:
            if self.pulse is None:
                put(spectrum, opl, active)
            else:
                self.spread(film, put, sampler, spectrum, opl, active)

        L, _ = self.sample(scene, sampler, camera.ray, deposit, camera.origin)
        color = L * camera.weight
        image = film.steady.create_block()
        image.put(camera.position, [color.x, color.y, color.z, mi.Float(1)])
        film.steady.put_block(image)
        film.steady.schedule_storage()
        dr.eval(film.bins.sums)
