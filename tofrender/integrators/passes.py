"""Rendering loop over samples: lanes, steps, and their values in a film.

A few lanes follow each pixel through all samples of a step. On a CPU, the lanes of a pixel are
neighbours in one vector of one thread: each pixel has a single writer, which needs no atomic
additions. Memory does not depend on the number of samples.
"""

from __future__ import annotations

import math
import operator
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..bidirectional.caustic_photons import CausticPhotons
from ..films.colors import color_count
from ..films.histogram import MAX_ADDED
from ..films.recording import Recording
from ..films.sums import AsSplats
from ..paths.camera import Tile, pixel_corner, sample_camera, sampled_size
from ..paths.kinds import Kind
from ..runtime import backend, checks, gpu, plugins, variants
from ..runtime.checkpoints import SavedState
from ..samplers.padded_sobol import mix
from .caustics import Caustics
from .extra_rays import DeltaChains, ExtraRays, VisibleEmitters
from .user_defined import Tracer

STEP_SAMPLES, FIRST_SAMPLES = 1 << 22, 1 << 20  # Camera rays of one kernel launch: most, first
STEP_S = 1.0  # Time that a step should take [s]; progress, stops and checkpoints come in between
CUDA_STEP = 16  # Times as many on a GPU, where tracing the kernel takes longer than running it

LANES = {"llvm": 1 << 12, "cuda": 1 << 20}
"""Lanes that keep a device busy; in films with fewer pixels, many lanes share one."""

FEW_PATHS = 1 << 15  # Paths of a film below which pilots take longer than the paths
PHOTON_RATE = 0.5  # Photons for each sample of a pixel; they are much less noisy than paths
LEAST_PHOTONS = 256  # Photons for one sample of all pixels, at least
PHOTON_SEED = 0xF070

PRIVATE_LANES = 4  # Lanes that never run on two threads: the narrowest vector of the LLVM backend

LOOPING_SAMPLERS = ("IndependentSampler", "PaddedSobolSampler")
"""Samplers that can go on to their next sample within a symbolic loop."""


@dataclass(frozen=True)
class SampleRange:
    """Range of samples and pixels that a render takes, by default all of them."""

    # samples per pixel of an earlier render with the same seed, whose point set `padded_sobol` goes
    # on with; other samplers start another one
    first: int = 0
    # where the film's pixels are in the sensor's film, if that has more. `padded_sobol` takes the
    # same points as for the whole, other samplers take others
    tile: Tile | None = None
    saved: SavedState | None = None  # state of a render of this range that was stopped

    @property
    def done(self) -> int:
        """Samples per pixel that the film has from the start."""
        return 0 if self.saved is None else self.saved.done


WHOLE = SampleRange()


class PixelSampler:
    """Samples pixels: camera rays, their paths, and the values that go into the film.

    The render takes `spp` samples per pixel, with `rate` rays for each; `splats` says that all
    contributions are splats.
    """

    def __init__(
        self,
        tracer: Tracer | ExtraRays | CausticPhotons,
        record: Recording,
        sensor: mi.Sensor,
        sampler: mi.Sampler,
        spp: int,
        tile: Tile | None,
        rate: float = 1,
        splats: bool = False,
    ) -> None:
        self.tracer, self.record, self.sensor, self.sampler = tracer, record, sensor, sampler
        self.spp, self.tile, self.rate, self.splats = spp, tile, rate, splats

    def sample(
        self, pixel: mi.UInt32
    ) -> tuple[mi.Point2f, list[mi.Float], list[mi.Float], mi.UInt32]:
        """Trace one camera ray through each of some pixels.

        Returns film positions [pixels], channels before and after the weight channel, and how
        many contributions were not finite.
        """
        record = self.record
        camera = sample_camera(
            self.sensor, record.film, self.sampler, pixel, self.tile, scene=self.tracer.scene
        )
        if self.rate != 1:
            camera = replace(camera, weight=camera.weight / self.rate)
        measurement = record.measurement(camera, self.spp)
        target = AsSplats(measurement, camera.position) if self.splats else measurement
        traced, path = self.tracer.trace(
            self.sampler, camera.ray, camera.origin, target, frame=camera.frame
        )
        measured = measurement if self.splats else traced
        channels = record.channels(camera, measured, path.valid_ray)
        return camera.position, *channels, path.not_finite


def steps(
    tracer: Tracer,
    record: Recording,
    sensor: mi.Sensor,
    sampler: mi.Sampler,
    seed: int | mi.UInt32,
    samples: SampleRange = WHOLE,
) -> Iterator[int]:
    """Render in steps of about a second, all from one point set.

    The film is cleared first. The sensor is of the film's size, and the sampler's `sample_count`
    the number of samples per pixel.

    Yields:
        Samples per pixel that the film holds so far.

    Raises:
        BackendError: The active variant cannot render in time.
        ValueError: The sensor is a batch of sensors.
        MemoryError: The film does not fit.
    """
    variants.require_vectorized()
    if sensor.class_name() == "BatchSensor":
        raise ValueError("sensor: is a batch of sensors; must be one, e.g. a perspective camera")
    tracer = tracer.for_bin_width(record.width_opl)
    film, tile = record.film, samples.tile

    # Choose techniques for some kinds of paths, which the main paths leave out
    extra_rays: list[ExtraRays] = []
    photons = None
    if record.emitters_apart:
        whole_width, whole_height = sampled_size(film if tile is None else tile.whole)
        paths = whole_width * whole_height * (samples.first + sampler.sample_count())
        if paths >= FEW_PATHS:
            caustics = Caustics.of(tracer, sensor, tile)
            tracer, photons = caustics.tracer, caustics.photons
        for technique in (VisibleEmitters, DeltaChains):
            rays = technique.of(tracer, sensor, film, tile)
            if rays is not None:
                extra_rays.append(rays)
                tracer = rays.rest

    # Clear the film, or restore it from a checkpoint
    record.prepare()
    width, height = sampled_size(film)
    spp, done = sampler.sample_count(), samples.done
    lanes, most, private = _lanes(sampler, width * height, spp - done)
    apart = photons is not None or any(rays.splats for rays in extra_rays)
    record.begin(spp, tracer.splats or apart, apart and not tracer.splats)
    if samples.saved is not None:
        record.restore(samples.saved.arrays, samples.saved.done, samples.saved.of, spp)

    # Several lanes share a pixel; all go on where an earlier render has ended
    lane = dr.arange(mi.UInt32, width * height * lanes)
    pixel = lane // dr.opaque(mi.UInt32, lanes)
    _seed(sampler, seed, lanes, pixel if tile is None else tile.numbers(film, pixel), samples)
    pixels = PixelSampler(tracer, record, sensor, sampler, spp, tile)
    passes: list[_ExtraPixels | _PhotonPass] = []
    reached = np.unique(np.concatenate([rays.pixels for rays in extra_rays] or [np.zeros(0, int)]))
    for rays in extra_rays:
        passes.append(_ExtraPixels(rays, reached, record, sensor, spp, seed, samples, lanes))
    if photons is not None:
        passes.append(_PhotonPass(photons, record, sensor, spp, seed, samples))

    first = step_samples(FIRST_SAMPLES)
    flushed, per_step = done, min(most, max(1, first // (width * height * lanes)))
    while done < spp:
        start, count = time.perf_counter(), min(per_step, (spp - done) // lanes)
        record.set_one_writer(private)
        with backend.tracing_lock():
            record.not_finite += _step(pixels, pixel, count)
        for each in passes:
            each.sample(count * lanes)
        done += count * lanes
        record.update_image(done, spp)
        if spp > done >= flushed + MAX_ADDED:
            record.flush()
            flushed = done
        seconds = time.perf_counter() - start
        compiled = done == samples.done + count * lanes  # Then the step seems slower than it is
        if seconds < STEP_S / 2 or (seconds > 2 * STEP_S and not compiled):
            per_step = max(1, int(min(most, count * STEP_S / seconds)))
        yield done


def _seed(
    sampler: mi.Sampler, seed: mi.UInt32 | int, lanes: int, pixel: mi.UInt32, samples: SampleRange
) -> None:
    """Start a sampler at the first of some samples; `pixel` is that of the whole for each lane.

    Samplers that cannot skip points or pixels take others, by another seed.
    """
    sampler.set_samples_per_wavefront(lanes)
    first, skip = samples.first + samples.done, getattr(sampler, "skip", None)
    set_pixels = getattr(sampler, "place", None)
    if skip is None:
        corner = () if samples.tile is None else (1 + samples.tile.x, 1 + samples.tile.y)
        for number in (first, *corner):
            seed = mix(mi.UInt32(seed), mi.UInt32(number)) if number else seed
    sampler.seed(seed, dr.width(pixel))
    if samples.tile is not None and set_pixels is not None:
        set_pixels(pixel)
    if first and skip is not None:
        skip(first)


class _ExtraPixels:
    """Samples the pixels of extra rays more often, in a point set of their own.

    `reached` has the pixels of all extra rays of the render. On a GPU, several lanes share the
    samples of a ray. The number of samples per pixel in a step must be a multiple of `lanes`.
    """

    def __init__(
        self,
        rays: ExtraRays,
        reached: np.ndarray,
        record: Recording,
        sensor: mi.Sensor,
        spp: int,
        seed: int | mi.UInt32,
        samples: SampleRange,
        lanes: int,
    ) -> None:
        sampler = best_sampler(spp)
        numbers = mi.UInt32(rays.pixels.tolist())
        rate = rays.rate
        tile = samples.tile
        self.share = _shared_by(len(numbers) * rate, lanes, MAX_ADDED // rate)
        per_pixel = rate * self.share
        own_lanes = len(numbers) * per_pixel
        sampler.set_samples_per_wavefront(per_pixel)
        own_seed = mix(mi.UInt32(seed), mi.UInt32(rate))
        if rays.kind is not Kind.VISIBLE:
            own_seed = mix(own_seed, mi.UInt32(rays.kind.value))
        dr.make_opaque(own_seed)  # One kernel for all seeds
        sampler.seed(own_seed, own_lanes)
        self.pixel = dr.gather(mi.UInt32, numbers, dr.arange(mi.UInt32, own_lanes) // per_pixel)
        sampler.place(self.pixel if tile is None else tile.numbers(record.film, self.pixel))
        sampler.skip((samples.first + samples.done) * rate)
        self.record, self.rate = record, rate
        self.reached = _around(reached, record.film)
        self.pixels = PixelSampler(rays, record, sensor, sampler, spp, tile, rate, rays.splats)

    def sample(self, count: int) -> None:
        """Take `count` samples per pixel."""
        self.record.set_one_writer(False)
        while count:
            most = MAX_ADDED // self.rate // self.share
            now = min(count // self.share, most)  # Samples of each lane
            with backend.tracing_lock():
                self.record.not_finite += _step(self.pixels, self.pixel, now, weight=0.0)
            self.record.flush(self.reached)
            count -= now * self.share


class _PhotonPass:
    """Traces photons along with the samples of all pixels, in one point set of their own."""

    def __init__(
        self,
        photons: CausticPhotons,
        record: Recording,
        sensor: mi.Sensor,
        spp: int,
        seed: int | mi.UInt32,
        samples: SampleRange,
    ) -> None:
        width, height = sampled_size(record.film)
        pixels = width * height
        lanes = max(LEAST_PHOTONS, math.ceil(PHOTON_RATE * pixels))
        sampler = best_sampler(spp)
        sampler.set_samples_per_wavefront(lanes)
        own_seed = mix(mi.UInt32(seed), mi.UInt32(PHOTON_SEED))
        dr.make_opaque(own_seed)  # One kernel for all seeds
        sampler.seed(own_seed, lanes)
        sampler.skip((samples.first + samples.done) * lanes)
        self.record = record
        # Camera rays have a photon's wavelengths and its time; they may be those of any pixel
        self.pixel = dr.arange(mi.UInt32, lanes) % pixels
        self.photons = PixelSampler(photons, record, sensor, sampler, spp, None, lanes / pixels)

    def sample(self, count: int) -> None:
        """Trace the photons of `count` samples per pixel."""
        self.record.set_one_writer(False)
        with backend.tracing_lock():
            self.record.not_finite += _step(self.photons, self.pixel, count, weight=0.0)


def _around(pixels: np.ndarray, film: mi.Film) -> mi.UInt32:
    """Return the film's own pixels that samples of some pixels of the sampled area reach."""
    width, _ = sampled_size(film)
    columns, rows = (int(n) for n in film.crop_size())
    border = film.rfilter().border_size()
    shift = border if film.sample_border() else 0
    chosen = np.zeros((rows + 2 * border + 2 * shift, columns + 2 * border + 2 * shift), bool)
    y, x = np.divmod(pixels, width)
    for down in range(2 * border + 1):
        for across in range(2 * border + 1):
            chosen[y + down, x + across] = True
    own = chosen[border + shift :, border + shift :][:rows, :columns]
    return mi.UInt32(np.flatnonzero(own).tolist())


def _lanes(sampler: mi.Sampler, pixels: int, spp: int) -> tuple[int, int, bool]:
    """Return lanes per pixel, most samples of each in a step, and whether pixels are private."""
    looping = {sampler.class_name(), type(sampler).__name__} & {*LOOPING_SAMPLERS}
    step = step_samples(STEP_SAMPLES) if looping else STEP_SAMPLES
    most = max(1, min(step // pixels, MAX_ADDED))
    if not looping:
        return _divisor(spp, most), 1, False
    if _on_gpu():
        lanes, private = _divisor(spp, min(LANES["cuda"] // pixels, most)), False
    elif pixels * PRIVATE_LANES < LANES["llvm"]:
        lanes, private = _divisor(spp, LANES["llvm"] // pixels), False
    else:
        # One channel is added by a whole vector at once, whose lanes must be of different pixels
        lanes, private = 1 if mi.is_monochromatic else math.gcd(spp, PRIVATE_LANES), True
    return lanes, max(1, most // lanes), private


def _shared_by(rays: int, lanes: int, most: int) -> int:
    """Return the number of lanes that share a ray: a divisor of `lanes`, at most `most`.

    A GPU is not busy with few rays. On a CPU, the number is 1.
    """
    if not _on_gpu():
        return 1
    return _divisor(lanes, max(1, min(LANES["cuda"] // rays, most)))


def step_samples(samples: int) -> int:
    """Return the camera rays of one kernel launch: `samples` on a CPU, and more on a GPU."""
    return samples * CUDA_STEP if _on_gpu() else samples


def _on_gpu() -> bool:
    """Whether the active variant renders on a GPU."""
    return gpu.is_gpu(mi.variant())


def _divisor(number: int, bound: int) -> int:
    """Return the largest divisor of `number` that is at most `bound`, 1 if there is none."""
    return next((k for k in range(min(bound, number), 0, -1) if number % k == 0), 1)


@dr.syntax
def _step(pixels: PixelSampler, pixel: mi.UInt32, count: int, weight: float = 1.0) -> int:
    """Take `count` samples in every lane, each of a `weight` in the picture; evaluate the film.

    Returns the number of contributions that were not finite.
    """
    record, sampler = pixels.record, pixels.sampler
    image = record.image
    block = image.create_block()
    left = dr.opaque(mi.UInt32, count) + dr.zeros(mi.UInt32, dr.width(pixel))
    not_finite = mi.UInt32(0)
    if dr.hint(count == 1, mode="scalar"):  # One sample, without a loop
        position, colour, rest, odd = pixels.sample(pixel)
        block.put(position, [*colour, mi.Float(weight), *rest])
        not_finite += odd
        sampler.advance()
    elif dr.hint(record.film.rfilter().is_box_filter(), mode="scalar"):  # Sums go to one pixel
        n = color_count(image)
        sums = [mi.Float(0) for _ in range(block.channel_count() - 1)]
        while left > 0:
            _, colour, rest, odd = pixels.sample(pixel)
            sums = list(map(operator.add, sums, [*colour, *rest]))
            not_finite += odd
            sampler.advance()
            left -= 1
        block.put(
            pixel_corner(record.film, pixel), [*sums[:n], mi.Float(count * weight), *sums[n:]]
        )
    else:  # Each sample reaches several pixels
        while left > 0:
            position, colour, rest, odd = pixels.sample(pixel)
            block.put(position, [*colour, mi.Float(weight), *rest])
            not_finite += odd
            sampler.advance()
            left -= 1
    # Evaluate all outcomes of the walk together, or it would be traced again
    sampler.schedule_state()
    dr.schedule(not_finite)
    image.put_block(block)
    image.schedule_storage()
    dr.eval()
    dr.sync_thread()
    return int(dr.sum(mi.UInt64(not_finite))[0])


def best_sampler(spp: int) -> mi.Sampler:
    """Create the sampler that leaves the least noise; a `ValueError` if `spp` is out of range."""
    count = checks.integer("spp", spp, 1, checks.MAX_SPP)
    return mi.load_dict({"type": plugins.qualified_name("padded_sobol"), "sample_count": count})
