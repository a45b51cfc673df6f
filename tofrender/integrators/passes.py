"""Rendering loop over samples: tracing camera rays, and adding their values to a film.

A render is split into steps. In each step, a few lanes per pixel compute several samples, one after
another. On a CPU, the lanes of a pixel are neighbors in one vector of one thread. Each pixel
therefore has a single writer, which does not need atomic additions. The memory does not depend on
the number of samples.
"""

from __future__ import annotations

import math
import operator
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..films.channels import color_count, to_rgb
from ..films.histogram import MAX_ADDED
from ..films.recording import Recording
from ..films.sums import AsSplats
from ..paths.camera import Tile, pixel_corner, sample_camera, sampled_size
from ..paths.path_kinds import Kind
from ..runtime import backend, checks, gpu, plugins, variants
from ..runtime.checkpoints import SavedState
from ..samplers.padded_sobol import mix
from .caustic_techniques import Caustics
from .extra_rays import DeltaChains, ExtraRays, VisibleEmitters
from .shared_paths import SharedPaths
from .user_defined import Tracer

if TYPE_CHECKING:
    from ..bidirectional.caustic_photons import CausticPhotons

STEP_SAMPLES = 1 << 22  # Largest number of camera rays in one kernel launch
FIRST_SAMPLES = 1 << 20  # Number of camera rays in the first kernel launch

# Target time of a step [s]. Progress, stops and checkpoints are handled between steps
STEP_S = 1.0

# Factor for the camera rays of a kernel launch on a GPU. Tracing a kernel is slower there than
# running it
CUDA_STEP = 16

LANES = {"llvm": 1 << 12, "cuda": 1 << 20}
"""Number of lanes that keep a device busy. On films with fewer pixels, several lanes share a pixel.
"""

# Number of paths of a film below which pilots are slower than the paths
FEW_PATHS = 1 << 15

# Number of paths of a film below which paths are not shared by pixels, because another kernel is
# slower than the paths
FEW_SHARED_PATHS = 1 << 18

# Number of pixels of a film below which paths are not shared, because neighboring pixels see points
# that are far from each other
FEW_SHARED_PIXELS = 1 << 10

PHOTON_RATE = 0.5  # Photons per sample of a pixel; photons are much less noisy than paths
LEAST_PHOTONS = 256  # Smallest number of photons for one sample of all pixels
PHOTON_SEED = 0xF070
SHARED_SEED = 0x711E

BLOCKS = 2  # Number of shifts of tiles in a render, more if blocks have `MOST_IN_BLOCK` samples
MOST_IN_BLOCK = 64  # Largest number of samples of a tile between two shifts

# Number of lanes that always run on the same thread: the narrowest vector of the LLVM backend
PRIVATE_LANES = 4

LOOPING_SAMPLERS = ("IndependentSampler", "PaddedSobolSampler")
"""Samplers that can advance to the next sample within a symbolic loop."""


@dataclass(frozen=True)
class SampleRange:
    """Range of samples and pixels of a render, by default all samples and pixels."""

    # Samples per pixel of an earlier render with the same seed. `padded_sobol` continues the point
    # set of this render, other samplers start a new point set
    first: int = 0

    # Position of the film's pixels in a larger film, None for a whole film. `padded_sobol` uses the
    # same points as for the whole film, other samplers use different points
    tile: Tile | None = None

    # State of a render of this range that was stopped, None for a new render
    saved: SavedState | None = None

    @property
    def done(self) -> int:
        """Samples per pixel that the film contains from the start."""
        return 0 if self.saved is None else self.saved.done


WHOLE = SampleRange()


class PixelSampler:
    """Sampling of pixels: camera rays, their paths, and the values for the film.

    Args:
        tracer: Tracer of the camera rays.
        record: Recording on the film.
        sensor: The sensor.
        sampler: Sampler of the camera rays and paths.
        tile: Position of the film in a larger film, None for a whole film.
        rate: Number of rays per sample of a pixel.
        splats: Whether all contributions are added as splats.
        one_writer: Whether only one thread writes to each pixel.
    """

    def __init__(
        self,
        tracer: Tracer | ExtraRays | CausticPhotons,
        record: Recording,
        sensor: mi.Sensor,
        sampler: mi.Sampler,
        tile: Tile | None,
        rate: float = 1,
        splats: bool = False,
        one_writer: bool = False,
    ) -> None:
        self.tracer = tracer
        self.record = record
        self.sensor = sensor
        self.sampler = sampler
        self.tile = tile
        self.rate = rate
        self.splats = splats
        self.one_writer = one_writer

    def sample(
        self, pixel: mi.UInt32
    ) -> tuple[mi.Point2f, list[mi.Float], list[mi.Float], mi.UInt32]:
        """Trace one camera ray through each pixel of an array of pixel indices.

        Returns:
            Film positions [pixels], channels before the weight channel, channels after the weight
            channel, and the number of contributions that are not finite.
        """
        # Sample the camera rays
        record = self.record
        camera = sample_camera(
            self.sensor, record.film, self.sampler, pixel, self.tile, scene=self.tracer.scene
        )
        if self.rate != 1:
            camera = replace(camera, weight=camera.weight / self.rate)

        # Trace the paths
        measurement = record.measurement(camera, self.one_writer)
        target = AsSplats(measurement, camera.position) if self.splats else measurement
        traced, path = self.tracer.trace(
            self.sampler, camera.ray, camera.origin, target, frame=camera.frame
        )

        # Convert the measured light to channels
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
    """Render in steps of about one second, which use one point set.

    The film is cleared first.

    | loop state | meaning |
    |---|---|
    | `done` | samples per pixel that the film contains |
    | `flushed` | samples per pixel at the last flush of the film |
    | `per_step` | samples per lane in the next step |

    Args:
        tracer: Tracer of the camera rays.
        record: Recording on the film.
        sensor: The sensor, which has the size of the film.
        sampler: The sampler, with a `sample_count` equal to the samples per pixel of the render.
        seed: Seed of the sampler.
        samples: Range of samples and pixels.

    Yields:
        Samples per pixel that the film contains so far.

    Raises:
        BackendError: The active variant does not support rendering in time.
        ValueError: The sensor is a batch of sensors.
        MemoryError: The film does not fit into memory.
    """
    variants.require_vectorized()
    if sensor.class_name() == "BatchSensor":
        raise ValueError(
            "sensor: batches of sensors are not supported. Use one sensor, for example a "
            "perspective camera"
        )
    tracer = tracer.for_bin_width(record.width_opl)
    film = record.film
    tile = samples.tile

    # --------------------- Choose the techniques ---------------------

    # Choose techniques for some kinds of paths, and exclude these kinds from the main paths
    extra_rays: list[ExtraRays] = []
    photons = None
    shared = None
    if record.emitters_apart:
        # Caustics need pilots, which are too slow for renders with few paths
        whole_width, whole_height = sampled_size(film if tile is None else tile.whole)
        paths = whole_width * whole_height * (samples.first + sampler.sample_count())
        if paths >= FEW_PATHS:
            caustics = Caustics.of(tracer, sensor, tile)
            tracer = caustics.tracer
            photons = caustics.photons

        # Extra rays find emitters that the camera sees directly or through delta lobes
        for technique in (VisibleEmitters, DeltaChains):
            rays = technique.of(tracer, sensor, film, tile)
            if rays is not None:
                extra_rays.append(rays)
                tracer = rays.remaining_plan

        # Neighboring pixels share paths, unless a kernel for them takes longer than the paths
        enough = paths >= FEW_SHARED_PATHS and whole_width * whole_height >= FEW_SHARED_PIXELS
        if enough and _loops(sampler):
            shared = SharedPaths.of(tracer, sensor, record, tile)
            if shared is not None:
                tracer = shared.remaining_plan

    # --------------------- Prepare the film and the samplers ---------------------

    # Clear the film
    width, height = sampled_size(film)
    spp = sampler.sample_count()
    done = samples.done
    lanes, most, private = _lanes(sampler, width * height, spp - done)
    extra_splats = photons is not None or any(rays.splats for rays in extra_rays)
    record.prepare(
        spp, splats=tracer.splats or extra_splats, apart=extra_splats and not tracer.splats
    )

    # Restore the film from a checkpoint
    if samples.saved is not None:
        record.accumulation.restore(samples.saved)

    # Seed the sampler. Several lanes share a pixel, and all lanes continue an earlier render
    lane = dr.arange(mi.UInt32, width * height * lanes)
    pixel = lane // dr.opaque(mi.UInt32, lanes)
    _seed(sampler, seed, lanes, pixel if tile is None else tile.numbers(film, pixel), samples)

    # Prepare the main paths, and passes for the other techniques
    pixels = PixelSampler(
        tracer=tracer,
        record=record,
        sensor=sensor,
        sampler=sampler,
        tile=tile,
        one_writer=private,
    )
    passes: list[_ExtraPixels | _PhotonPass | _SharedPass] = []
    quantum = 1
    reached = np.unique(np.concatenate([rays.pixels for rays in extra_rays] or [np.zeros(0, int)]))
    for rays in extra_rays:
        passes.append(
            _ExtraPixels(
                rays=rays,
                reached=reached,
                record=record,
                sensor=sensor,
                spp=spp,
                seed=seed,
                samples=samples,
                lanes=lanes,
            )
        )
    if photons is not None:
        passes.append(
            _PhotonPass(
                photons=photons,
                record=record,
                sensor=sensor,
                spp=spp,
                seed=seed,
                samples=samples,
            )
        )

    if shared is not None:
        shared_pass = _SharedPass(shared=shared, spp=spp, seed=seed, samples=samples)
        passes.append(shared_pass)

        # Both kinds of light have equal parts of their samples after each step
        quantum = shared_pass.unit // math.gcd(shared_pass.unit, lanes)

    # --------------------- Render the steps ---------------------

    # Choose the size of the first step
    first = step_samples(FIRST_SAMPLES)
    flushed = done
    per_step = min(most, max(1, first // (width * height * lanes)))
    while done < spp:
        # Trace the main paths
        start = time.perf_counter()
        count = max(quantum, per_step // quantum * quantum)
        count = min(count, (spp - done) // lanes)
        with backend.tracing_lock():
            record.accumulation.not_finite += _step(pixels, pixel, count)

        # Trace the other techniques, with the same number of samples per pixel
        for each in passes:
            each.sample(count * lanes)
        done += count * lanes

        # Add splats to the picture, and flush the film before single precision loses small addends
        record.accumulation.update_image(done)
        if spp > done >= flushed + MAX_ADDED:
            record.accumulation.flush()
            flushed = done

        # Adjust the size of the next step. The first step may be slow because of compilation, so
        # it does not reduce the size
        seconds = time.perf_counter() - start
        compiled = done == samples.done + count * lanes
        if seconds < STEP_S / 2 or (seconds > 2 * STEP_S and not compiled):
            per_step = max(1, int(min(most, count * STEP_S / seconds)))
        yield done


def _seed(
    sampler: mi.Sampler, seed: mi.UInt32 | int, lanes: int, pixel: mi.UInt32, samples: SampleRange
) -> None:
    """Seed a sampler so that it starts at the first sample of a range.

    Samplers that cannot skip points or choose pixels get a different seed for each range.

    Args:
        sampler: The sampler.
        seed: Seed of the render.
        lanes: Lanes per pixel.
        pixel: Pixel index of each lane in the whole film.
        samples: Range of samples and pixels.
    """
    sampler.set_samples_per_wavefront(lanes)
    first = samples.first + samples.done
    skip = getattr(sampler, "skip", None)
    set_pixels = getattr(sampler, "place", None)

    # Derive another seed from the range if the sampler cannot skip points
    if skip is None:
        corner = () if samples.tile is None else (1 + samples.tile.x, 1 + samples.tile.y)
        for number in (first, *corner):
            seed = mix(mi.UInt32(seed), mi.UInt32(number)) if number else seed
    sampler.seed(seed, dr.width(pixel))

    # Otherwise select the pixels of the range, and skip earlier points
    if samples.tile is not None and set_pixels is not None:
        set_pixels(pixel)
    if first and skip is not None:
        skip(first)


class _ExtraPixels:
    """Additional samples in the pixels of extra rays, with a separate point set.

    Args:
        rays: The extra rays.
        reached: Pixel indices of all extra rays of the render.
        record: Recording on the film.
        sensor: The sensor.
        spp: Samples per pixel of the render.
        seed: Seed of the render.
        samples: Range of samples and pixels.
        lanes: Divisor of the samples per pixel in each step. On a GPU, several lanes share the
            samples of a ray. The number of these lanes is a divisor of `lanes`.
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
        # Choose the number of lanes of each pixel
        sampler = best_sampler(spp)
        indices = mi.UInt32(rays.pixels.tolist())
        rate = rays.rate
        tile = samples.tile
        self.lanes_per_ray = _shared_by(len(indices) * rate, lanes, MAX_ADDED // rate)
        per_pixel = rate * self.lanes_per_ray
        lane_count = len(indices) * per_pixel
        sampler.set_samples_per_wavefront(per_pixel)

        # Seed the sampler. An opaque seed avoids another kernel for each seed
        pass_seed = mix(mi.UInt32(seed), mi.UInt32(rate))
        if rays.kind is not Kind.VISIBLE:
            pass_seed = mix(pass_seed, mi.UInt32(rays.kind.value))
        dr.make_opaque(pass_seed)
        sampler.seed(pass_seed, lane_count)

        # Use the points of these pixels, and skip the points of earlier samples
        self.pixel = dr.gather(mi.UInt32, indices, dr.arange(mi.UInt32, lane_count) // per_pixel)
        sampler.place(self.pixel if tile is None else tile.numbers(record.film, self.pixel))
        sampler.skip((samples.first + samples.done) * rate)

        self.record = record
        self.rate = rate
        self.reached = _reached_pixels(reached, record.film)
        self.pixels = PixelSampler(
            tracer=rays,
            record=record,
            sensor=sensor,
            sampler=sampler,
            tile=tile,
            rate=rate,
            splats=rays.splats,
        )

    def sample(self, count: int) -> None:
        """Trace the extra rays of `count` samples per pixel."""
        while count:
            # Add `now` samples per lane, and flush the pixels after at most `MAX_ADDED` rays
            most = MAX_ADDED // self.rate // self.lanes_per_ray
            now = min(count // self.lanes_per_ray, most)
            with backend.tracing_lock():
                not_finite = _step(self.pixels, self.pixel, now, weight=0.0)
            self.record.accumulation.not_finite += not_finite
            self.record.accumulation.flush(self.reached)
            count -= now * self.lanes_per_ray


class _PhotonPass:
    """Photons that are traced in addition to the samples of all pixels, with a separate point set.

    Args:
        photons: The photons.
        record: Recording on the film.
        sensor: The sensor.
        spp: Samples per pixel of the render.
        seed: Seed of the render.
        samples: Range of samples and pixels.
    """

    def __init__(
        self,
        photons: CausticPhotons,
        record: Recording,
        sensor: mi.Sensor,
        spp: int,
        seed: int | mi.UInt32,
        samples: SampleRange,
    ) -> None:
        # Choose the number of photons for one sample of all pixels
        width, height = sampled_size(record.film)
        pixels = width * height
        lanes = max(LEAST_PHOTONS, math.ceil(PHOTON_RATE * pixels))

        # Seed the sampler. An opaque seed avoids another kernel for each seed
        sampler = best_sampler(spp)
        sampler.set_samples_per_wavefront(lanes)
        pass_seed = mix(mi.UInt32(seed), mi.UInt32(PHOTON_SEED))
        dr.make_opaque(pass_seed)
        sampler.seed(pass_seed, lanes)
        sampler.skip((samples.first + samples.done) * lanes)

        # Each photon uses the wavelengths and the time of a camera ray. The pixel of this ray does
        # not matter
        self.record = record
        self.pixel = dr.arange(mi.UInt32, lanes) % pixels
        self.photons = PixelSampler(
            tracer=photons,
            record=record,
            sensor=sensor,
            sampler=sampler,
            tile=None,
            rate=lanes / pixels,
        )

    def sample(self, count: int) -> None:
        """Trace the photons of `count` samples per pixel."""
        with backend.tracing_lock():
            not_finite = _step(self.photons, self.pixel, count, weight=0.0)
        self.record.accumulation.not_finite += not_finite


class _SharedPass:
    """Indirect light that the pixels of tiles share, with a separate point set.

    The tiles move after each block of samples. All lanes of a kernel have equal shifts. Therefore,
    only one thread writes to each pixel.

    Args:
        shared: The paths.
        spp: Samples per pixel of the render.
        seed: Seed of the render.
        samples: Range of samples and pixels.
    """

    def __init__(
        self, shared: SharedPaths, spp: int, seed: int | mi.UInt32, samples: SampleRange
    ) -> None:
        # Several samples of a pixel share one sample of a tile, and several lanes share a tile
        self.every = math.gcd(math.gcd(spp, samples.done), shared.every)
        tile_samples = math.gcd(spp // self.every, samples.done // self.every)
        self.lanes = 1 if mi.is_monochromatic else math.gcd(tile_samples, PRIVATE_LANES)
        across, down = shared.tiles()
        lane_count = across * down * self.lanes
        self.tile = dr.arange(mi.UInt32, lane_count) // dr.opaque(mi.UInt32, self.lanes)

        # Seed the sampler. An opaque seed avoids another kernel for each seed
        self.sampler = best_sampler(spp)
        self.sampler.set_samples_per_wavefront(self.lanes)
        self.seed = mix(mi.UInt32(seed), mi.UInt32(SHARED_SEED))
        dr.make_opaque(self.seed)
        self.sampler.seed(self.seed, lane_count)
        self.sampler.skip(samples.first + samples.done // self.every)

        # Choose the number of samples between two shifts
        block = min(MOST_IN_BLOCK, spp // self.every // BLOCKS)
        self.block = self.lanes * max(1, block // self.lanes)
        self.first = samples.first
        self.done = samples.done // self.every
        self.shared = shared

    @property
    def unit(self) -> int:
        """Smallest number of samples per pixel of a step."""
        return self.every * self.lanes

    def sample(self, count: int) -> None:
        """Add `count` samples per pixel, a multiple of `unit`."""
        accumulation = self.shared.record.accumulation
        count //= self.every
        while count > 0:
            # Use one shift until the end of the block
            now = min(count, self.block - self.done % self.block)
            number = mi.UInt32(self.first + self.done // self.block)
            bits = mix(self.seed, number)
            side = self.shared.side
            shift = mi.Point2u(bits % side, (bits >> 16) % side)
            dr.make_opaque(shift)
            with backend.tracing_lock():
                accumulation.not_finite += self._step(shift, now // self.lanes)
            self.done += now
            count -= now

    @dr.syntax
    def _step(self, shift: mi.Point2u, count: int) -> int:
        """Compute `count` samples in every lane, and add them to the film."""
        shared = self.shared
        record = shared.record
        sums, first, not_finite = shared.sample(self.sampler, self.tile, shift, count, self.every)

        # Add the sums of the pixels to the picture
        block = record.image.create_block()
        k = dr.zeros(mi.UInt32, dr.width(self.tile))
        corner = mi.Point2f(first) + mi.Vector2f(record.film.crop_offset())
        zeros = [mi.Float(0)] * (block.channel_count() - color_count(record.image))
        while k < shared.side * shared.side:
            position = corner + mi.Point2f(k % shared.side, k // shared.side)
            light = to_rgb(sums[k] * self.every, [])
            block.put(position, [light.x, light.y, light.z, *zeros])
            k += 1

        # Evaluate all results together
        self.sampler.schedule_state()
        dr.schedule(not_finite)
        record.image.put_block(block)
        record.image.schedule_storage()
        dr.eval()
        dr.sync_thread()
        return int(dr.sum(mi.UInt64(not_finite))[0])


def _reached_pixels(pixels: np.ndarray, film: mi.Film) -> mi.UInt32:
    """Return the film's pixels that receive samples from given pixels of the sampled area.

    The sampled area may include a border around the film. The reconstruction filter spreads each
    sample to neighboring pixels.
    """
    width, _ = sampled_size(film)
    columns, rows = (int(n) for n in film.crop_size())
    border = film.rfilter().border_size()
    shift = border if film.sample_border() else 0

    # Mark all pixels within the radius of the filter, on an array with margins
    chosen = np.zeros((rows + 2 * border + 2 * shift, columns + 2 * border + 2 * shift), bool)
    y, x = np.divmod(pixels, width)
    for down in range(2 * border + 1):
        for across in range(2 * border + 1):
            chosen[y + down, x + across] = True

    # Remove the margins
    inside = chosen[border + shift :, border + shift :][:rows, :columns]
    return mi.UInt32(np.flatnonzero(inside).tolist())


def _lanes(sampler: mi.Sampler, pixels: int, spp: int) -> tuple[int, int, bool]:
    """Choose how lanes share the samples of pixels.

    Args:
        sampler: The sampler.
        pixels: Number of pixels.
        spp: Samples per pixel to render.

    Returns:
        Lanes per pixel, largest number of samples of a lane in a step, and whether only one thread
        writes to each pixel.
    """
    # With other samplers, a kernel launch computes one sample per lane
    looping = _loops(sampler)
    step = step_samples(STEP_SAMPLES) if looping else STEP_SAMPLES
    most = max(1, min(step // pixels, MAX_ADDED))
    if not looping:
        return _divisor(spp, most), 1, False

    if _on_gpu():
        lanes = _divisor(spp, min(LANES["cuda"] // pixels, most))
        private = False
    elif pixels * PRIVATE_LANES < LANES["llvm"]:
        lanes = _divisor(spp, LANES["llvm"] // pixels)
        private = False
    else:
        # A single channel is added by a whole vector at once. The lanes of the vector must then
        # belong to different pixels
        lanes = 1 if mi.is_monochromatic else math.gcd(spp, PRIVATE_LANES)
        private = True
    return lanes, max(1, most // lanes), private


def _loops(sampler: mi.Sampler) -> bool:
    """Return whether a sampler can advance to the next sample within a symbolic loop."""
    return bool({sampler.class_name(), type(sampler).__name__} & {*LOOPING_SAMPLERS})


def _shared_by(rays: int, lanes: int, most: int) -> int:
    """Return the number of lanes that share a ray: a divisor of `lanes`, at most `most`.

    Few rays do not keep a GPU busy. On a CPU, the number is 1.
    """
    if not _on_gpu():
        return 1
    return _divisor(lanes, max(1, min(LANES["cuda"] // rays, most)))


def step_samples(samples: int) -> int:
    """Return the number of camera rays of one kernel launch: `samples` on a CPU, more on a GPU."""
    return samples * CUDA_STEP if _on_gpu() else samples


def _on_gpu() -> bool:
    """Return whether the active variant renders on a GPU."""
    return gpu.is_gpu(mi.variant())


def _divisor(number: int, bound: int) -> int:
    """Return the largest divisor of `number` that is at most `bound`, and 1 if `bound` is 0."""
    return next((k for k in range(min(bound, number), 0, -1) if number % k == 0), 1)


@dr.syntax
def _step(pixels: PixelSampler, pixel: mi.UInt32, count: int, weight: float = 1.0) -> int:
    """Compute `count` samples in every lane, and evaluate the film.

    | loop state | meaning |
    |---|---|
    | `left` | remaining samples of each lane |
    | `sums` | sums of the channels over the samples of each lane |
    | `not_finite` | number of contributions that are not finite |

    Args:
        pixels: Sampling of pixels.
        pixel: Pixel index of each lane.
        count: Samples of each lane.
        weight: Weight of each sample in the picture.

    Returns:
        The number of contributions that are not finite.
    """
    record = pixels.record
    sampler = pixels.sampler
    image = record.image
    block = image.create_block()
    left = dr.opaque(mi.UInt32, count) + dr.zeros(mi.UInt32, dr.width(pixel))
    not_finite = mi.UInt32(0)

    if dr.hint(count == 1, mode="scalar"):
        # Take one sample without a loop
        position, before, after, step_not_finite = pixels.sample(pixel)
        block.put(position, [*before, mi.Float(weight), *after])
        not_finite += step_not_finite
        sampler.advance()
    elif dr.hint(record.film.rfilter().is_box_filter(), mode="scalar"):
        # With a box filter, all samples of a lane reach one pixel. Add the sum once
        n = color_count(image)
        sums = [mi.Float(0) for _ in range(block.channel_count() - 1)]
        while left > 0:
            _, before, after, step_not_finite = pixels.sample(pixel)
            sums = list(map(operator.add, sums, [*before, *after]))
            not_finite += step_not_finite
            sampler.advance()
            left -= 1
        block.put(
            pixel_corner(record.film, pixel), [*sums[:n], mi.Float(count * weight), *sums[n:]]
        )
    else:
        # With other filters, each sample reaches several pixels
        while left > 0:
            position, before, after, step_not_finite = pixels.sample(pixel)
            block.put(position, [*before, mi.Float(weight), *after])
            not_finite += step_not_finite
            sampler.advance()
            left -= 1

    # Evaluate all results together, because the loop would otherwise be traced again
    sampler.schedule_state()
    dr.schedule(not_finite)
    image.put_block(block)
    image.schedule_storage()
    dr.eval()
    dr.sync_thread()
    return int(dr.sum(mi.UInt64(not_finite))[0])


def best_sampler(spp: int) -> mi.Sampler:
    """Create the sampler with the least noise.

    Args:
        spp: Samples per pixel.

    Raises:
        ValueError: `spp` is out of range.
    """
    count = checks.integer("spp", spp, 1, checks.MAX_SPP)
    return mi.load_dict({"type": plugins.qualified_name("padded_sobol"), "sample_count": count})
