"""A render that is decided to the last detail, and carrying it out."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.cells import MAX_ADDED
from ..films.recording import Recording, profile as seen_pulse, recording
from ..integrators.own_sample import brings_sample
from ..integrators.passes import Part, steps
from ..integrators.plan import Plan
from ..integrators.running import UNIT, run
from ..runtime import checks, memory, plugins
from ..runtime.checkpoints import Checkpoint
from ..scenes.fingerprint import fingerprint
from ..scenes.settings import SAMPLERS
from .arrivals import Arrivals, find_arrivals
from .dataset import check_dataset, coordinates, require_finite, transient_dataset
from .window import check_window, is_auto, warn_of_losses, windowed_film

if TYPE_CHECKING:
    import xarray as xr

    from ..signals.pulses import Pulse

DEFAULT_SAMPLER = "padded_sobol"


@dataclass
class Job:
    """A render, decided.

    Attributes:
        plan: What is done with camera rays.
        tracer: The integrator whose plan that is.
        scene: The scene.
        name: What the Dataset calls it.
        sensor: Number of the sensor.
        film: The film with its window, empty.
        profile: The pulse that it sees light with.
        arrivals: When light arrives.
        sampler: The sampler that was asked for, see `sampler_for`.
        spp: Samples per pixel that were asked for, None for the scene's.
        seed: Seed of all random numbers.
    """

    plan: Plan
    tracer: Any
    scene: mi.Scene
    name: str
    sensor: int
    film: Any
    profile: Pulse | None
    arrivals: Arrivals
    sampler: str | mi.Sampler | None
    spp: int | None
    seed: int

    @property
    def camera(self) -> mi.Sensor:
        """The sensor."""
        return self.scene.sensors()[self.sensor]

    def points(self, first: int = 0) -> mi.Sampler:
        """The sampler for what is missing after `first` samples per pixel."""
        return sampler_for(self.camera, self.sampler, self.spp, first)

    def recording(self, film: Any = None) -> Recording:
        """How light is recorded on the job's film, or on another one.

        Raises:
            TypeError: The integrator does not say when light arrives; one line.
        """
        record = recording(self.film if film is None else film, self.tracer.exposure())
        if brings_sample(self.tracer):
            record.require_no_lengths(type(self.tracer).__name__)
        return record

    @cached_property
    def recipe(self) -> dict[str, str | int | float]:
        """All that the picture depends on, but for the number of samples."""
        film, tracer = self.film, self.tracer
        return {
            "quantity": "radiance per bin",
            "units": "W m^-2 sr^-1",
            "start_opl": film.start_opl,
            "bin_width_opl": film.bin_width_opl,
            "pulse": str(tracer.pulse or "none"),
            "temporal_filter": tracer.temporal_filter or "as rfilter",
            "sensor": self.sensor,
            "integrator": type(tracer).__name__,
            "max_depth": tracer.max_depth,
            "camera_unwarp": int(tracer.camera_unwarp),
            "sampler": _sampler_name(self.points()),
            "seed": self.seed,
            "variant": mi.variant(),
            "fingerprint": fingerprint(self.scene, self.camera, tracer),
            "versions": _versions(),
        }

    def require_memory(self, spp: int) -> None:
        """Refuse a film that does not fit.

        Raises:
            MemoryError: One line with its size and what would fit.
        """
        folds = 2 if spp > MAX_ADDED else 1
        memory.require_film(*self.film.shape, copies=folds * (2 if self.plan.splats else 1))


def decide(
    plan: Plan,
    tracer: Any,
    scene: mi.Scene,
    *,
    name: str,
    sensor: int,
    spp: int | None,
    seed: int,
    sampler: str | mi.Sampler | None = None,
    window: str | tuple[float, float] | None = None,
    temporal_bins: int | None = None,
) -> Job:
    """Find the window, and refuse what makes no sense in it.

    Raises:
        ValueError: No light can reach the window; one line.
    """
    camera = scene.sensors()[sensor]
    film, profile, arrivals = film_of_light(plan, tracer, camera, window, temporal_bins, seed)
    check_window(film, arrivals, profile)
    return Job(plan, tracer, scene, name, sensor, film, profile, arrivals, sampler, spp, seed)


def carry_out(
    job: Job,
    resume: xr.Dataset | None = None,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
    made: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Take all samples of a job; arguments, result and errors are as for `render`.

    `made` is what else a checkpoint compares.
    """
    film, checkpoint = job.film, Checkpoint.of(checkpoint)
    first = 0 if resume is None else _samples_of(resume)
    points = job.points(first)
    spp = points.sample_count()
    job.require_memory(spp)
    if resume is not None:
        _check_resume(resume, job.recipe, film)
    record = job.recording()
    kept = None
    if checkpoint is not None:
        made = {**job.recipe, "film": str(film), "resume": first, **(made or {})}
        kept = checkpoint.begin(made, spp, UNIT, first)

    part = Part(first=first, kept=kept)
    start = time.perf_counter()
    done = run(
        steps(job.plan, record, job.camera, points, job.seed, part),
        *(record, spp),
        done=part.done,
        before=first,
        checkpoint=checkpoint,
        progress=progress,
    )
    seconds = time.perf_counter() - start + (kept.seconds if kept else 0.0)
    if done < spp:
        warnings.warn(f"interrupted: returning {done} of {spp} samples per pixel", stacklevel=3)

    record.report()
    before = 0 if resume is None else int(resume.attrs.get("contributions_not_finite", 0))
    steady, transient = film.take()
    if resume is not None:
        share = first / (first + done)
        steady += share * (resume["steady"].values - steady)
        transient += share * (resume["transient"].values - transient)
        seconds += resume.attrs["render_seconds"]
    total = float(np.sum(steady, dtype=np.float64))
    outside = 1 - float(np.sum(transient, dtype=np.float64)) / total if total else 0.0
    outside = min(max(outside, 0.0), 1.0)
    if done == spp:
        warn_of_losses(film, job.arrivals, job.profile, outside)
    attrs = job.recipe | {
        "scene": job.name,
        "spp": first + done,
        "energy_outside_window": outside,
        "complete": int(done == spp),
        "contributions_not_finite": record.not_finite + before,
        "render_seconds": seconds,
    }
    return transient_dataset(steady, transient, film, attrs)


# ------------------------------------------------------------------------------- its parts


def film_of_light(
    plan: Plan, tracer: Any, camera: mi.Sensor, window: Any, temporal_bins: int | None, seed: int
) -> tuple[Any, Pulse | None, Arrivals]:
    """The film with its window.

    Returns:
        The film, the pulse that it sees, and when light arrives.
    """
    exposure = tracer.exposure()
    film = windowed_film(camera.film(), window, temporal_bins)
    profile = seen_pulse(film, exposure)  # Refuses what does not fit together
    arrivals = find_arrivals(plan, camera, film, seed)
    if is_auto(window):
        if not arrivals.any:
            raise ValueError("window = 'auto': no light found; must be (start, stop) in metres")
        film = windowed_film(camera.film(), arrivals.window(tracer.pulse), temporal_bins)
        profile = seen_pulse(film, exposure)  # A filter's width is known when that of a bin is
        film = windowed_film(camera.film(), arrivals.window(profile), temporal_bins)
    return film, profile, arrivals


def sampler_for(camera: mi.Sensor, sampler: Any, spp: int | None, first: int = 0) -> mi.Sampler:
    """The sampler to use, its sample count set to what is missing after `first` samples."""
    given = sampler if isinstance(sampler, mi.Sampler) else camera.sampler()
    count = given.sample_count() if spp is None else spp
    count = checks.integer("spp", count, 1, checks.MAX_SPP)
    if count <= first:
        raise ValueError(f"spp = {count}: must be above {first}, which resume has already")
    if isinstance(sampler, mi.Sampler):
        points = sampler.clone()
        points.set_sample_count(count - first)
        return points
    kind = DEFAULT_SAMPLER if sampler is None else checks.one_of("sampler", sampler, SAMPLERS)
    return mi.load_dict({"type": plugins.own_name(kind), "sample_count": count - first})


def _sampler_name(sampler: mi.Sampler) -> str:
    return sampler.class_name() if type(sampler) is mi.Sampler else type(sampler).__name__


def _samples_of(resume: Any) -> int:
    """Samples per pixel of a Dataset to go on from."""
    try:
        check_dataset(resume)
        require_finite(resume)
        return checks.integer("spp", resume.attrs.get("spp"), 1, checks.MAX_SPP)
    except ValueError as error:
        raise ValueError(f"resume: {error}") from None


def _check_resume(resume: xr.Dataset, recipe: Mapping[str, Any], film: Any) -> None:
    """Refuse to go on with a render that was made in another way."""
    for name, value in recipe.items():
        its = resume.attrs.get(name)
        if its != value:
            raise ValueError(f"resume: was rendered with {name} = {its!r}; must be {value!r}")
    for name, value in coordinates(film).items():
        if not np.array_equal(resume[name].values, value):
            raise ValueError(f"resume: its coordinate {name} differs; must be that of this render")


def _versions() -> str:
    """Versions of what made the picture, as JSON."""
    from importlib.metadata import version

    from .. import __version__

    found = {"tofrender": __version__, "mitsuba": mi.__version__, "drjit": version("drjit")}
    return json.dumps(found)
