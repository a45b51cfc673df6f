"""Taking many samples in every pixel: lanes, steps, and the way into a film.

A few lanes follow each pixel through all samples of a step. On a CPU, the lanes of a pixel are
neighbours in one vector, which one thread works on: each pixel has a single writer, and what it
deposits need not be atomic. Memory does not depend on the number of samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.cells import MAX_ADDED
from ..paths.camera import pixel_corner, sampled_size
from ..runtime import checks, plugins
from ..samplers.padded_sobol import mix

STEP_SAMPLES = 1 << 22
"""Camera rays of one kernel launch: about a second's work on two cores."""

LANES = {"llvm": 1 << 12, "cuda": 1 << 20}
"""Lanes that keep a device busy; in films with fewer pixels, many lanes share one."""

PRIVATE_LANES = 4
"""Lanes of a pixel that never run on two threads: the narrowest vector of the LLVM backend."""

LOOPING_SAMPLERS = ("IndependentSampler", "PaddedSobolSampler")
"""Samplers that can go on to their next sample within a symbolic loop."""

Shot = Callable[[mi.UInt32], tuple[mi.Point2f, list[mi.Float], list[mi.Float]]]
"""Takes a sample of each of some pixels: its film position, its colour (and coverage), the rest."""


def steps(film: Any, sampler: mi.Sampler, seed: Any, first: int, shot: Shot) -> Iterator[int]:
    """Take all samples, in steps of about a second and from one point set.

    Args:
        film: A prepared film. A transient one has its image in `film.steady`.
        sampler: Its `sample_count` is the number of samples per pixel.
        seed: Seed of the random numbers.
        first: Number of samples per pixel that an earlier render with this seed has taken.
            `padded_sobol` goes on in the same point set, other samplers start another one.
        shot: Takes a sample; its values go to the channels of the film's image.

    Yields:
        Samples per pixel that the film holds so far.
    """
    width, height = sampled_size(film)
    spp = sampler.sample_count()
    lanes, per_step, private = _plan(sampler, width * height, spp)
    has_cells = hasattr(film, "add_transient_data")
    if has_cells:
        film.samples_per_pixel = spp
        film.one_writer_per_pixel = private and film.rfilter().is_box_filter()
    sampler.set_samples_per_wavefront(lanes)
    skip = getattr(sampler, "skip", None)
    if first and skip is None:  # Other points, by another seed
        seed = mix(mi.UInt32(seed), mi.UInt32(first))
    sampler.seed(seed, width * height * lanes)
    if first and skip is not None:
        skip(first)

    done = folded = 0
    while done < spp:
        count = min(per_step, (spp - done) // lanes)
        lane = dr.arange(mi.UInt32, width * height * lanes)
        _step(film, sampler, shot, lane // dr.opaque(mi.UInt32, lanes), count)
        done += count * lanes
        if has_cells:
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
    image = getattr(film, "steady", film)
    block = image.create_block()
    left = dr.opaque(mi.UInt32, count) + dr.zeros(mi.UInt32, dr.width(pixel))
    if dr.hint(count == 1, mode="scalar"):
        position, colour, rest = shot(pixel)
        block.put(position, [*colour, mi.Float(1), *rest])
        sampler.advance()
    elif dr.hint(film.rfilter().is_box_filter(), mode="scalar"):
        sums = [mi.Float(0) for _ in range(block.channel_count() - 1)]
        while left > 0:
            _, colour, rest = shot(pixel)
            sums = _added(sums, [*colour, *rest])
            sampler.advance()
            left -= 1
        n = _colour_count(image)
        block.put(pixel_corner(film, pixel), [*sums[:n], mi.Float(count), *sums[n:]])
    else:
        while left > 0:
            position, colour, rest = shot(pixel)
            block.put(position, [*colour, mi.Float(1), *rest])
            sampler.advance()
            left -= 1
    image.put_block(block)
    sampler.schedule_state()
    image.schedule_storage()
    dr.eval()
    dr.sync_thread()


def _colour_count(image: mi.Film) -> int:
    """Channels of an image before its weight."""
    return 4 if mi.has_flag(image.flags(), mi.FilmFlags.Alpha) else 3


def _added(sums: list[mi.Float], values: list[mi.Float]) -> list[mi.Float]:
    return [total + value for total, value in zip(sums, values, strict=True)]


def image_channels(film: Any, colour: mi.Color3f, covered: mi.Bool) -> list[mi.Float]:
    """A colour as the channels of a film's image, coverage included if it has alpha."""
    channels = [colour.x, colour.y, colour.z]
    if _colour_count(getattr(film, "steady", film)) == 4:
        channels.append(dr.select(covered, mi.Float(1), mi.Float(0)))
    return channels


def to_rgb(spectrum: Any, wavelengths: Any) -> mi.Color3f:
    """Colour of a spectrum, in whatever way the variant stores it."""
    if mi.is_monochromatic:
        return mi.Color3f(spectrum[0])
    if mi.is_spectral:
        return mi.spectrum_to_srgb(spectrum, wavelengths)
    return mi.Color3f(spectrum)


def take(
    scene: mi.Scene, integrator: Any, sensor: mi.Sensor, film: Any, spp: int, seed: int
) -> None:
    """Render into a film, with the sampler that leaves the least noise.

    Raises:
        ValueError: `spp` or `seed` is out of range; one line.
    """
    count = checks.integer("spp", spp, 1, checks.MAX_SPP)
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    sampler = mi.load_dict({"type": plugins.own_name("padded_sobol"), "sample_count": count})
    for _ in integrator.steps(scene, sensor, film, sampler, seed):
        pass
