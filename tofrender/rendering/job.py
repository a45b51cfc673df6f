"""A render that is decided to the last detail, and carrying it out."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from os import PathLike
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.cells import MAX_ADDED
from ..films.exposure import profile as seen_pulse
from ..films.image import transient_film
from ..films.recording import Recording, recording, tell_not_finite
from ..integrators.own_sample import brings_sample
from ..integrators.plan import Plan
from ..runtime import checks, memory, plugins
from ..runtime.backend import versions
from ..runtime.checkpoints import Checkpoint
from ..scenes.fingerprint import fingerprint
from ..scenes.settings import SAMPLERS
from .arrivals import LAST_OPL, Arrivals, find_arrivals
from .asked import Asked, is_auto
from .dataset import check_dataset, components_of, coordinates, require_finite, transient_dataset
from .errors import parts_of
from .pieces import (
    TILE_BYTES,
    Piece,
    Taken,
    collect_pieces,
    ranges,
    take,
    tile_size,
    tiles,
    whole,
)
from .window import MEND, check_window, warn_of_losses, windowed_film
from .workers import check_client, pieces_by_workers

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

    from ..signals.pulses import Pulse

DEFAULT_SAMPLER = "padded_sobol"

LOOKING = 0
"""Seed with which light is looked for: renders of all seeds have one window, and can be joined."""


@dataclass
class Job:
    """A render, decided.

    Attributes:
        plan: What is done with camera rays.
        tracer: The integrator whose plan that is.
        scene: The scene.
        asked: What is asked of it.
        film: The film with its window, empty.
        profile: The pulse that it sees light with.
        arrivals: When light arrives, None if nobody looked.
        origin: The function that decides it again in a worker, and its arguments but for the
            time axis.
        more: What else the result depends on.
        mend: What decides on the window, for a warning.
    """

    plan: Plan
    tracer: Any
    scene: mi.Scene
    asked: Asked
    film: Any
    profile: Pulse | None
    arrivals: Arrivals | None
    origin: tuple[Callable[..., Job], Mapping[str, Any]] | None = None
    more: Mapping[str, Any] = field(default_factory=dict)
    mend: str = MEND

    @property
    def camera(self) -> mi.Sensor:
        """The sensor."""
        return self.scene.sensors()[self.asked.sensor]

    def points(self, first: int = 0) -> mi.Sampler:
        """The sampler for what is missing after `first` samples per pixel."""
        return sampler_for(self.camera, self.asked.sampler, self.asked.spp, first)

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
    def recipe(self) -> dict[str, Any]:
        """All that the picture depends on, but for the number of samples."""
        film, tracer = self.film, self.tracer
        return {
            "quantity": "radiance per bin",
            "units": "W m^-2 sr^-1",
            "start_opl": film.start_opl,
            "bin_width_opl": film.bin_width_opl,
            "pulse": str(tracer.pulse or "none"),
            "temporal_filter": tracer.temporal_filter or "as rfilter",
            "sensor": self.asked.sensor,
            "integrator": type(tracer).__name__,
            "max_depth": tracer.max_depth,
            "camera_unwarp": int(tracer.camera_unwarp),
            "sampler": _sampler_name(self.points()),
            "seed": self.asked.seed,
            "variant": mi.variant(),
            "fingerprint": fingerprint(self.scene, self.camera, tracer),
            "versions": versions(),
        }

    @property
    def all_of_it(self) -> dict[str, Any]:
        """All that the result depends on: the recipe, the film's pixels, and more."""
        named = {**self.more, **self.recipe, "film": str(self.film)}
        return named | {"fingerprint": named.pop("fingerprint")}  # What has a name is told first

    def take(self, piece: Piece, **options: Any) -> Taken:
        """Render a piece, see `pieces.take`."""
        return take(self, piece, **options)

    def require_memory(self, spp: int) -> None:
        """Refuse a film that does not fit.

        Raises:
            MemoryError: One line with its size and what would fit.
        """
        channels = self.film.shape[3]
        folds = 2 if spp > MAX_ADDED else 1
        copies = folds * (2 if self.plan.splats else 1)
        scatter = 2 * channels / memory.stride(channels) if self.asked.errors else 0
        memory.require_film(*self.film.shape, copies=copies + scatter)


def decide(
    plan: Plan,
    tracer: Any,
    scene: mi.Scene,
    asked: Asked,
    origin: tuple[Callable[..., Job], Mapping[str, Any]],
    axis: tuple[int, float, float] | None = None,
) -> Job:
    """Find the window, and refuse what makes no sense in it.

    The arguments are as a `Job` has them; `axis` is the number, start and width [m] of the bins, if
    they were decided elsewhere.

    Raises:
        ValueError: No light can reach the window; one line.
    """
    camera = scene.sensors()[asked.sensor]
    if axis is not None:
        film, profile, arrivals = transient_film(camera.film(), *axis), None, None
    else:
        film, profile, arrivals = film_of_light(plan, tracer, camera, asked)
        check_window(film, arrivals, profile)
    job = Job(plan, tracer, scene, asked, film, profile, arrivals, origin)
    if asked.errors:
        parts_of(whole(job).count)
    return job


def carry_out(
    job: Job,
    resume: xr.Dataset | None = None,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Take all samples of a job; arguments, result and errors are as for `render`."""
    first = 0 if resume is None else _samples_of(resume)
    piece = whole(job, first)
    job.require_memory(piece.count)
    if resume is not None:
        check_resume(resume, job)
    taken = take(job, piece, checkpoint=Checkpoint.of(checkpoint), resumed=first, progress=progress)
    if taken.done < piece.count:
        said = f"returning {taken.done} of {piece.count} samples per pixel"
        warnings.warn(f"interrupted: {said}", stacklevel=3)
    return told(job, labelled(job, taken, taken.done == piece.count, resume))


def collect(
    job: Job,
    client: Client,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Have a job done by workers, and its film put together here.

    Raises:
        KeyboardInterrupt: It was stopped; one line.
        ConnectionError: The scheduler was lost; likewise.
    """
    workers = check_client(client)
    if job.plan.splats and job.asked.errors:
        raise ValueError("errors = True: must be False with a client for light that lands anywhere")
    all_of_it, checkpoint = whole(job), Checkpoint.of(checkpoint)
    job.require_memory(all_of_it.count)
    if checkpoint is not None:  # The pieces are those that were begun with
        workers = int(checkpoint.recipe().get("workers", workers))
    if job.plan.splats:
        pieces = ranges(job, workers)
    else:
        pieces = tiles(job, tile_size(job.film.shape, TILE_BYTES, workers))
    height, width, _, channels = job.film.shape
    shapes = {"transient": job.film.shape, "steady": (height, width, channels)}
    names = [*shapes, *(f"{name}_error" for name in shapes)] if job.asked.errors else list(shapes)
    films: dict[str, np.ndarray] = {
        n: np.zeros(shapes[n.removesuffix("_error")], np.float32) for n in names
    }
    films["not_finite"] = np.zeros(1, int)
    start = time.perf_counter()

    def place(piece: Piece, taken: Taken) -> None:
        share = np.float32(piece.count / all_of_it.count)
        for name, part in taken.arrays.items():
            its = piece.of(films[name])
            its += part if share == 1 else share * part
        films["not_finite"] += taken.not_finite

    collect_pieces(
        partial(pieces_by_workers, client, job),
        pieces,
        place,
        films,
        recipe=job.all_of_it | {"spp": all_of_it.count, "workers": workers},
        unit="pieces",
        checkpoint=checkpoint,
        progress=progress,
    )
    seconds = time.perf_counter() - start
    errors = {name: films[f"{name}_error"] for name in shapes} if job.asked.errors else {}
    found = films["steady"], films["transient"]
    taken = Taken(*found, all_of_it.count, int(films["not_finite"][0]), seconds, errors)
    return told(job, labelled(job, taken, True))


def told(job: Job, dataset: xr.Dataset) -> xr.Dataset:
    """The same, with a warning of what is missing in it."""
    tell_not_finite(dataset.attrs["contributions_not_finite"], stacklevel=5)
    if dataset.attrs["complete"] and job.arrivals is not None:
        outside = dataset.attrs["energy_outside_window"]
        warn_of_losses(job.film, outside, job.arrivals, job.profile, job.mend, stacklevel=5)
    return dataset


def labelled(
    job: Job, taken: Taken, complete: bool, resume: xr.Dataset | None = None
) -> xr.Dataset:
    """The Dataset of what was taken of a whole film, and of what an earlier render had."""
    first = 0 if resume is None else _samples_of(resume)
    arrays = taken.arrays
    seconds, not_finite = taken.seconds, taken.not_finite
    if resume is not None:
        share = np.float32(first / (first + taken.done))
        for name, array in arrays.items():
            earlier = resume[name].values.reshape(array.shape)
            if name.endswith("_error"):
                array[:] = np.hypot(share * earlier, (1 - share) * array)
            else:
                array += share * (earlier - array)
        seconds += resume.attrs["render_seconds"]
        not_finite += int(resume.attrs.get("contributions_not_finite", 0))
    colours = job.film.base_channels_count()  # Of S0, the others may be negative
    steady, transient = (arrays[name][..., :colours] for name in ("steady", "transient"))
    total = float(np.sum(steady, dtype=np.float64))
    outside = 1 - float(np.sum(transient, dtype=np.float64)) / total if total else 0.0
    outside = min(max(outside, 0.0), 1.0)
    attrs = job.recipe | {
        "scene": job.asked.name,
        "spp": first + taken.done,
        "energy_outside_window": outside,
        "complete": int(complete),
        "contributions_not_finite": not_finite,
        "render_seconds": seconds,
    }
    return transient_dataset(arrays, job.film, attrs)


# ------------------------------------------------------------------------------- its parts


def film_of_light(
    plan: Plan, tracer: Any, camera: mi.Sensor, asked: Asked
) -> tuple[Any, Pulse | None, Arrivals]:
    """The film with its window.

    Returns:
        The film, the pulse that it sees, and when light arrives.
    """
    exposure = tracer.exposure()
    film = windowed_film(camera.film(), *asked.timing)
    profile = seen_pulse(film, exposure)  # Refuses what does not fit together
    arrivals = find_arrivals(plan, camera, film, LOOKING)
    if is_auto(asked.window):
        if not arrivals.any:
            raise ValueError("window = 'auto': no light found; must be (start, stop) in metres")
        if arrivals.energy[-1] > 0:
            said = f"light arrives after more than {LAST_OPL:g} m, which no window holds"
            raise ValueError(f"window = 'auto': {said}; must be (start, stop) in metres")
        film = windowed_film(camera.film(), arrivals.window(tracer.pulse), asked.bins)
        profile = seen_pulse(film, exposure)  # A filter's width is known when that of a bin is
        film = windowed_film(camera.film(), arrivals.window(profile), asked.bins)
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
    return mi.load_dict({"type": plugins.qualified_name(kind), "sample_count": count - first})


def _sampler_name(sampler: mi.Sampler) -> str:
    return sampler.class_name() if type(sampler) is mi.Sampler else type(sampler).__name__


def _samples_of(resume: Any) -> int:
    """Samples per pixel of a Dataset to go on from."""
    try:
        for component in components_of(resume):
            check_dataset(component)
        require_finite(resume)
        return checks.integer("spp", resume.attrs.get("spp"), 1, checks.MAX_SPP)
    except ValueError as error:
        raise ValueError(f"resume: {error}") from None


def check_resume(resume: xr.Dataset, job: Job) -> None:
    """Refuse to go on with a render that was made in another way.

    Raises:
        ValueError: One line that names what differs.
    """
    for name, value in job.recipe.items():
        its = resume.attrs.get(name)
        if its != value:
            raise ValueError(f"resume: was rendered with {name} = {its!r}; must be {value!r}")
    for name, value in coordinates(job.film).items():
        if not np.array_equal(resume[name].values, value):
            raise ValueError(f"resume: its coordinate {name} differs; must be that of this render")
    errors = job.asked.errors
    if errors != ("transient_error" in resume):
        has = "no errors" if errors else "errors"
        raise ValueError(f"resume: has {has}; must be as asked for, errors = {errors}")
