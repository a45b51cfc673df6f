"""What all transient integrators share: parameters, steps over the pixels, the way into a film."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from .. import backend, checks, memory
from ..camera import behind_emitters, pixel_corner, sample_camera, sampled_size
from ..films.cells import MAX_ADDED
from ..films.deposit import FilmDeposit
from ..lights import EmitterHits, SceneLights
from ..pulses import Pulse
from ..sampling.padded_sobol import mix
from ..walk import Radiance, walk

STEP_SAMPLES = 1 << 22
"""Camera rays of one kernel launch: about a second's work on two cores."""

LANES = {"llvm": 1 << 12, "cuda": 1 << 20}
"""Lanes that keep a device busy; in films with fewer pixels, many lanes share one."""

PRIVATE_LANES = 4
"""Lanes of a pixel that never run on two threads: the narrowest vector of the LLVM backend."""

LOOPING_SAMPLERS = ("IndependentSampler", "PaddedSobolSampler")
"""Samplers that can go on to their next sample within a symbolic loop."""


class TransientIntegrator(mi.SamplingIntegrator):
    """Base of the integrators that render into a transient film.

    A few lanes follow each pixel through all samples of a step. On a CPU, the lanes of a pixel are
    neighbours in one vector, which one thread works on: each pixel has a single writer, and what
    it deposits need not be atomic. Memory does not depend on the number of samples.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 6 | longest path in segments, camera's included; -1 is unlimited |
    | `rr_depth` | 5 | surface vertices from which on Russian roulette may end a path |
    | `hide_emitters` | false | emitters are invisible to the camera |
    | `camera_unwarp` | false | leave out the segment from the camera to the first surface |
    | `discard_direct_light` | false | drop light that comes straight from an emitter |
    | `emitter_sampling` | true | connect to emitters; if false, paths must run into them |
    """

    def __init__(self, props: mi.Properties) -> None:
        depth, roulette = props.get("max_depth", 6), props.get("rr_depth", 5)
        self.max_depth = checks.depth("max_depth", depth)
        self.rr_depth = checks.integer("rr_depth", roulette, 1, checks.MAX_DEPTH)
        if props.get("timeout", -1.0) > 0:
            raise ValueError(
                f"timeout = {props['timeout']}: must be left out; Ctrl-C stops a render"
            )
        super().__init__(props)
        self.camera_unwarp, self.discard_direct_light, self.emitter_sampling = (
            checks.boolean(name, props.get(name, default))
            for name, default in (
                ("camera_unwarp", False),
                ("discard_direct_light", False),
                ("emitter_sampling", True),
            )
        )

    # ------------------------------------------------------------------ for subclasses

    pulse: Pulse | None = None
    temporal_filter: str = "box"

    def temporal_profile(self, film: Any) -> Any:
        """The pulse that each contribution is spread by, None for an instant.

        Raises:
            ValueError: This film or filter cannot be used; one line.
        """
        return self.pulse

    # ------------------------------------------------------------------------- paths

    def lights(self, scene: mi.Scene, sensor: mi.Sensor | None = None) -> SceneLights:
        """What paths connect to."""
        return (SceneLights if self.emitter_sampling else EmitterHits)(scene, sensor)

    def trace(self, scene, sampler, ray, origin, measurement, lights, active=True):
        """Follow camera rays; returns the measurement and the lanes that met a surface."""
        if self.hide_emitters:
            ray = behind_emitters(scene, ray)
        return walk(
            scene,
            sampler,
            ray,
            measurement,
            lights,
            max_depth=self.max_depth,
            rr_depth=self.rr_depth,
            origin=origin,
            unwarp=self.camera_unwarp,
            first_emission=not self.discard_direct_light,
            hide_emitters=self.hide_emitters,
            active=active,
        )

    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Steady radiance along rays, as every sampling integrator of Mitsuba returns it.

        Returns:
            Spectrum, lanes that met a surface, and no AOVs.
        """
        radiance, valid = self.trace(
            scene, sampler, ray, ray.o, Radiance.zero(), self.lights(scene), active
        )
        return mi.Spectrum(radiance.total), valid, []

    # --------------------------------------------------------------------- rendering

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        """Render with the scene's own film and sampler; `mi.render` calls this.

        Args:
            scene: The scene.
            sensor: A sensor, or its number in the scene.
            seed: Seed of the random numbers.
            spp: Samples per pixel; 0 takes the sampler's.
            develop: Whether to return the picture.
            evaluate: Accepted for Mitsuba's sake; the film is always evaluated.

        Returns:
            `(steady, transient)` as the film develops them, None if `develop` is false.
        """
        sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
        film, sampler = sensor.film(), sensor.sampler().clone()
        if spp:
            sampler.set_sample_count(spp)
        if develop and hasattr(film, "shape"):  # The bins, and the tensor that is returned
            memory.require_film(*film.shape, 1 + film.shape[3] / memory.stride(film.shape[3]))
        with dr.suspend_grad():
            for _ in self.steps(scene, sensor, film, sampler, seed):
                pass
            return film.develop() if develop else None

    def render_forward(self, *args, **kwargs):
        """Refused: there are no derivatives yet."""
        raise RuntimeError("transient integrators have no derivatives; use mi.render without")

    render_backward = render_forward

    def steps(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        film: Any,
        sampler: mi.Sampler,
        seed: Any,
        first: int = 0,
    ) -> Iterator[int]:
        """Render in steps of about a second, all from one point set.

        Args:
            scene: The scene.
            sensor: The camera.
            film: A transient film of the same size as the sensor's; it is emptied first.
            sampler: Its `sample_count` is the number of samples per pixel.
            seed: Seed of the random numbers.
            first: Number of samples per pixel that an earlier render with this seed has taken.
                `padded_sobol` goes on in the same point set, other samplers start another one.

        Yields:
            Samples per pixel that the film holds so far.

        Raises:
            BackendError: The active variant cannot render in time.
            TypeError: The film is not a transient one.
            ValueError: The film and the integrator's parameters do not fit.
            MemoryError: The film does not fit.
        """
        backend.require_vectorised()
        if sensor.class_name() == "BatchSensor":
            raise ValueError(
                "sensor: is a batch of sensors; must be one, e.g. a perspective camera"
            )
        if not hasattr(film, "add_transient_data"):
            raise TypeError(
                f"film: is a {film.class_name()}; must be a transient_hdr_film or another film "
                "with time"
            )
        profile = self.temporal_profile(film)
        film.prepare([])
        width, height = sampled_size(film)
        spp = sampler.sample_count()
        lanes, per_step, private = _plan(sampler, width * height, spp)
        film.samples_per_pixel = spp
        film.one_writer_per_pixel = private and film.rfilter().is_box_filter()
        sampler.set_samples_per_wavefront(lanes)
        skip = getattr(sampler, "skip", None)
        if first and skip is None:  # Other points, by another seed
            seed = mix(mi.UInt32(seed), mi.UInt32(first))
        sampler.seed(seed, width * height * lanes)
        if first and skip is not None:
            skip(first)
        lights = self.lights(scene, sensor)

        def shot(pixel):
            """One sample of each pixel, deposited; returns its position, colour and coverage."""
            camera = sample_camera(sensor, film, sampler, pixel)
            wavelengths = camera.ray.wavelengths
            weight = camera.weight / spp
            deposit = FilmDeposit.into(film, camera.position, wavelengths, weight, profile)
            deposit, valid = self.trace(scene, sampler, camera.ray, camera.origin, deposit, lights)
            return camera.position, _rgb(deposit.total * camera.weight, wavelengths), valid

        done = folded = 0
        while done < spp:
            count = min(per_step, (spp - done) // lanes)
            lane = dr.arange(mi.UInt32, width * height * lanes)
            _step(film, sampler, shot, lane // dr.opaque(mi.UInt32, lanes), count)
            done += count * lanes
            film.partial = done < spp
            if spp > done >= folded + MAX_ADDED and hasattr(film, "fold"):
                film.fold()
                folded = done
            yield done


def _plan(sampler: mi.Sampler, pixels: int, spp: int) -> tuple[int, int, bool]:
    """Lanes per pixel, samples that each lane takes in a step, and whether pixels are private."""
    most = max(1, min(STEP_SAMPLES // pixels, MAX_ADDED))
    if not {sampler.class_name(), type(sampler).__name__} & {*LOOPING_SAMPLERS}:
        return _divisor(spp, most), 1, False
    if (mi.variant() or "").startswith("cuda"):
        lanes, private = _divisor(spp, LANES["cuda"] // pixels), False
    elif pixels * PRIVATE_LANES < LANES["llvm"]:
        lanes, private = _divisor(spp, LANES["llvm"] // pixels), False
    else:
        # One channel is added by a whole vector at once, whose lanes must be of different pixels
        lanes, private = 1 if mi.is_monochromatic else math.gcd(spp, PRIVATE_LANES), True
    return lanes, max(1, most // lanes), private


def _divisor(number: int, bound: int) -> int:
    """The largest divisor of `number` that is at most `bound`, 1 if there is none."""
    return next((k for k in range(min(bound, number), 0, -1) if number % k == 0), 1)


@dr.syntax
def _step(film, sampler, shot, pixel, count):
    """Take `count` samples in every lane, one after the other, and evaluate the film."""
    block = film.steady.create_block()
    if dr.hint(count == 1, mode="scalar"):
        position, colour, valid = shot(pixel)
        _splat(block, film, position, colour, valid, 1)
        sampler.advance()
    elif dr.hint(film.rfilter().is_box_filter(), mode="scalar"):
        left = dr.opaque(mi.UInt32, count) + dr.zeros(mi.UInt32, dr.width(pixel))
        colour, covered = mi.Color3f(0), mi.Float(0)
        while left > 0:
            _, one, valid = shot(pixel)
            colour += one
            covered += dr.select(valid, 1.0, 0.0)
            sampler.advance()
            left -= 1
        _splat(block, film, pixel_corner(film, pixel), colour, covered, count)
    else:
        left = dr.opaque(mi.UInt32, count) + dr.zeros(mi.UInt32, dr.width(pixel))
        while left > 0:
            position, one, valid = shot(pixel)
            _splat(block, film, position, one, valid, 1)
            sampler.advance()
            left -= 1
    film.steady.put_block(block)
    sampler.schedule_state()
    film.steady.schedule_storage()
    dr.eval()
    dr.sync_thread()


def _splat(block, film, position, colour, covered, weight):
    """Put a sample, or the sum of several, into the steady image."""
    values = [colour.x, colour.y, colour.z]
    if mi.has_flag(film.steady.flags(), mi.FilmFlags.Alpha):
        values.append(mi.Float(covered))
    block.put(position, [*values, mi.Float(weight)])


def _rgb(spectrum, wavelengths) -> mi.Color3f:
    """Colour of a spectrum, in whatever way the variant stores it."""
    if mi.is_monochromatic:
        return mi.Color3f(spectrum[0])
    if mi.is_spectral:
        return mi.spectrum_to_srgb(spectrum, wavelengths)
    return mi.Color3f(spectrum)
