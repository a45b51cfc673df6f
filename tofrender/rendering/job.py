"""A render that is decided to the last detail, and carrying it out."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.exposure import profile as seen_pulse
from ..films.histogram import MAX_ADDED, TAKEN_COPIES
from ..films.recording import Recording, recording, warn_not_finite
from ..films.windowed import transient_film
from ..integrators.plan import Plan
from ..integrators.user_defined import is_user_defined
from ..labels import FILM, read
from ..runtime import checks, memory, plugins
from ..runtime.settings import SAMPLERS
from ..runtime.versions import versions
from ..scenes.fingerprint import fingerprint
from .arrivals import LAST_OPL, Arrivals, Look, looking_once
from .dataset import coordinates, require_finite, transient_dataset
from .errors import batches_of
from .settings import RenderSettings, is_auto
from .window import (
    ARRIVALS_SEED,
    WINDOW_OPTION,
    check_window,
    enlarged,
    warn_of_losses,
    windowed_film,
)

if TYPE_CHECKING:
    import xarray as xr

    from ..films.transient import TransientHDRFilm
    from ..integrators.base import TransientIntegrator
    from ..signals.pulses import Pulse

DEFAULT_SAMPLER = "padded_sobol"

DENOISING = 7  # Films that the filter works on besides the one that is rendered


@dataclass(frozen=True, order=True)
class WorkItem:
    """Some samples of some pixels."""

    y: int  # first row of the pixels in the film's crop window
    x: int  # first column
    height: int  # rows
    width: int  # columns
    first: int  # samples per pixel before the first of these
    count: int  # samples per pixel

    def pixels(self, array: np.ndarray) -> np.ndarray:
        """The item's pixels of an array of the whole film, (height, width, ...), as a view."""
        return array[self.y : self.y + self.height, self.x : self.x + self.width]


@dataclass
class WorkResult:
    """Result of a work item."""

    # `transient` (height, width, temporal_bins, channels), `steady` (height, width, channels), and
    # their standard errors, `transient_error` and `steady_error`, if wanted
    arrays: dict[str, np.ndarray]
    done: int  # samples per pixel that were taken: fewer than the item's if it was stopped
    not_finite: int = 0  # contributions that were left out
    seconds: float = 0.0  # time that it took [s]


@dataclass
class Job:
    """A render, decided."""

    plan: Plan
    integrator: TransientIntegrator  # Whose plan that is
    scene: mi.Scene
    settings: RenderSettings
    film: TransientHDRFilm  # With its window, empty
    profile: Pulse | None  # Pulse that the film sees light with
    arrivals: Arrivals | None  # When light arrives, None if that was decided elsewhere
    # Function that makes the same job in a worker, and its arguments but the time axis
    origin: tuple[Callable[..., Job], Mapping[str, object]]
    more: Mapping[str, object] = field(default_factory=dict)  # What else the result depends on
    window_option: str = WINDOW_OPTION  # What decides on the window, for a warning

    @property
    def camera(self) -> mi.Sensor:
        """The sensor."""
        return self.scene.sensors()[self.settings.sensor]

    def points(self, first: int = 0) -> mi.Sampler:
        """The sampler for what is missing after `first` samples per pixel."""
        return sampler_for(self.camera, self.settings.sampler, self.settings.spp, first)

    def recording(self, film: TransientHDRFilm) -> Recording:
        """Recording of the integrator's light on a film."""
        record = recording(film, self.integrator.exposure())
        if is_user_defined(self.integrator):
            record.require_no_lengths(type(self.integrator).__name__)
        return record

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """All that the picture depends on, but for the number of samples."""
        film, integrator, points = self.film, self.integrator, self.points()
        own = type(points) is not mi.Sampler
        return {
            "quantity": "radiance per bin",
            "units": "W m^-2 sr^-1",
            "start_opl": film.start_opl,
            "bin_width_opl": film.bin_width_opl,
            "pulse": str(integrator.pulse or "none"),
            "temporal_filter": integrator.temporal_filter or film.temporal_filter or "as rfilter",
            "sensor": self.settings.sensor,
            "integrator": type(integrator).__name__,
            "max_depth": integrator.max_depth,
            "camera_unwarp": int(integrator.camera_unwarp),
            "sampler": type(points).__name__ if own else points.class_name(),
            "seed": self.settings.seed,
            "variant": mi.variant(),
            "fingerprint": fingerprint(self.scene, self.camera, integrator),
            "versions": versions(),
        }

    @property
    def full_recipe(self) -> dict[str, Any]:
        """All that the result depends on: the recipe, the film's pixels, and more."""
        named = {**self.more, **self.recipe, "film": str(self.film)}
        return named | {"fingerprint": named.pop("fingerprint")}  # What has a name is told first

    def add(self, arrays: dict[str, np.ndarray], item: WorkItem, result: WorkResult) -> None:
        """Add the result of a work item to the arrays of the whole film."""
        fraction = np.float32(item.count / self.points().sample_count())
        for name, part in result.arrays.items():
            pixels = item.pixels(arrays[name])
            pixels += part if fraction == 1 else fraction * part
        arrays["not_finite"] += result.not_finite

    def require_memory(self, spp: int) -> None:
        """Refuse a film that does not fit."""
        channels = self.film.shape[3]
        flushed = 2 if spp > MAX_ADDED else 1
        films = 2 if self.plan.splats else 1
        copies = flushed * films
        packed = channels / memory.stride(channels)  # Of an array in a film's memory
        more = 2 * packed if self.settings.errors else DENOISING * packed * self.settings.denoise
        memory.require_film(
            *self.film.shape,
            copies=copies + more,
            device_copies=copies,
            host_copies=TAKEN_COPIES + films - 1 + more,
        )


def whole(job: Job, first: int = 0) -> WorkItem:
    """All pixels, and all samples after the `first` ones."""
    height, width, _, _ = job.film.shape
    return WorkItem(0, 0, height, width, first, job.points(first).sample_count())


def decide(
    plan: Plan,
    integrator: TransientIntegrator,
    scene: mi.Scene,
    settings: RenderSettings,
    origin: tuple[Callable[..., Job], Mapping[str, object]],
    axis: tuple[int, float, float] | None = None,
    may_be_dark: bool = False,
    look: Look | None = None,
) -> Job:
    """Find the window, and refuse what makes no sense in it, unless it `may_be_dark`.

    The arguments are as a `Job` has them; `axis` is the number, start and width [m] of the bins, if
    they were decided elsewhere. `look` makes test renders, if there is such a function already.
    """
    camera = scene.sensors()[settings.sensor]
    if axis is not None:
        film, profile, arrivals = transient_film(camera.film(), *axis), None, None
    else:
        film, profile, arrivals = film_of_light(plan, integrator, camera, settings, look)
        if not may_be_dark:
            check_window(film, arrivals, profile)
    job = Job(plan, integrator, scene, settings, film, profile, arrivals, origin)
    if settings.errors:
        batches_of(whole(job).count)
    if settings.denoise:
        points, count = job.points(), whole(job).count
        points.set_sample_count(max(count // 2, 1))
        halves = "even with denoise, each half one for the sampler"
        checks.require("spp", count, 2 * points.sample_count() == count, halves)
    return job


def remaining(job: Job, resume: xr.Dataset | None = None) -> WorkItem:
    """All pixels, and the samples that an earlier render lacks; refuses what cannot be resumed."""
    earlier, first = (None, 0) if resume is None else _read_earlier(resume)
    item = whole(job, first)
    job.require_memory(item.count)
    if earlier is not None:
        check_resume(earlier, job)
        if job.settings.denoise:
            raise ValueError("resume: must be left out with denoise")
    return item


def dataset_of(job: Job, result: WorkResult, resume: xr.Dataset | None = None) -> xr.Dataset:
    """The Dataset of a whole film and of an earlier render; warns of what is missing in it."""
    earlier, first = (None, 0) if resume is None else _read_earlier(resume)
    count = whole(job, first).count
    if result.done < count:
        what = f"returning {result.done} of {count} samples per pixel"
        warnings.warn(f"interrupted: {what}", stacklevel=3)
    arrays = result.arrays
    seconds, not_finite = result.seconds, result.not_finite
    if earlier is not None:
        earlier_part = np.float32(first / (first + result.done))
        for name, array in arrays.items():
            before = earlier[name].values.reshape(array.shape)
            if name.endswith("_error"):
                array[:] = np.hypot(earlier_part * before, (1 - earlier_part) * array)
            else:
                array += earlier_part * (before - array)
        seconds += earlier.attrs["render_seconds"]
        not_finite += int(earlier.attrs.get("contributions_not_finite", 0))
    colours = job.film.base_channels_count()  # Of S0, the others may be negative
    steady, transient = (
        float(np.sum(arrays[name][..., :colours], dtype=np.float64))
        for name in ("steady", "transient")
    )
    attrs = render_attributes(job, steady, transient) | {
        "spp": first + result.done,
        "complete": int(result.done == count),
        "contributions_not_finite": not_finite,
        "render_seconds": seconds,
    }
    warn_of_missing(job, attrs, stacklevel=4)
    dataset = transient_dataset(arrays, job.film, attrs)
    if not job.settings.denoise:
        return dataset
    from .denoised import denoised  # Imports much of SciPy

    return denoised(dataset, job.scene, job.camera, job.film)


def render_attributes(job: Job, steady: float, transient: float) -> dict[str, Any]:
    """Attributes of a Dataset, by the sums of its variables, but for what its samples took."""
    outside = 1 - transient / steady if steady else 0.0
    return job.recipe | {
        "scene": job.settings.scene_label,
        "energy_outside_window": min(max(outside, 0.0), 1.0),
    }


def warn_of_missing(job: Job, attrs: Mapping[str, Any], stacklevel: int) -> None:
    """Warn of contributions and of energy that are missing in a render with these attributes."""
    warn_not_finite(attrs["contributions_not_finite"], stacklevel=stacklevel + 1)
    if attrs["complete"] and job.arrivals is not None:
        outside = attrs["energy_outside_window"]
        warn_of_losses(
            job.film,
            outside,
            job.arrivals,
            job.profile,
            window_option=job.window_option,
            automatic=is_auto(job.settings.window),
            stacklevel=stacklevel + 1,
        )


def film_of_light(
    plan: Plan,
    integrator: TransientIntegrator,
    camera: mi.Sensor,
    settings: RenderSettings,
    look: Look | None = None,
) -> tuple[TransientHDRFilm, Pulse | None, Arrivals]:
    """The film with its window, the pulse that it sees, and when light arrives."""
    exposure = integrator.exposure()
    film = windowed_film(camera.film(), *settings.time_axis)
    profile = seen_pulse(film, exposure)  # Refuses what does not fit together
    look = look or looking_once(plan, camera, film)
    arrivals = look(ARRIVALS_SEED)
    if is_auto(settings.window):
        allowed = "must be (start, stop) in metres"
        if not arrivals.any:
            raise ValueError(f"window = 'auto': no light found; {allowed}")
        if arrivals.energy[-1] > 0:
            late = f"light arrives after more than {LAST_OPL:g} m, which no window holds"
            raise ValueError(f"window = 'auto': {late}; {allowed}")
        arrivals = enlarged(arrivals, profile, look)
        film = windowed_film(camera.film(), arrivals.window(integrator.pulse), settings.bins)
        profile = seen_pulse(film, exposure)  # A filter's width is known when that of a bin is
        film = windowed_film(camera.film(), arrivals.window(profile), settings.bins)
    return film, profile, arrivals


def sampler_for(camera: mi.Sensor, sampler: object, spp: int | None, first: int = 0) -> mi.Sampler:
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


def _read_earlier(resume: object) -> tuple[xr.Dataset, int]:
    """Read a Dataset to continue from. Return it with its samples per pixel."""
    earlier = read(resume, FILM, "resume")
    try:
        require_finite(earlier)
        return earlier, checks.integer("spp", earlier.attrs.get("spp"), 1, checks.MAX_SPP)
    except ValueError as error:
        raise ValueError(f"resume: {error}") from None


def check_resume(resume: xr.Dataset, job: Job) -> None:
    """Refuse to go on with a render that was made in another way."""
    for name, value in job.recipe.items():
        its = resume.attrs.get(name)
        if its != value:
            raise ValueError(f"resume: was rendered with {name} = {its!r}; must be {value!r}")
    for name, value in coordinates(job.film).items():
        if not np.array_equal(resume[name].values, value):
            raise ValueError(f"resume: its coordinate {name} differs; must be that of this render")
    found = {"errors": "transient_error" in resume, "denoise": bool(resume.attrs.get("denoised"))}
    for name, its in found.items():
        wanted = getattr(job.settings, name)
        if wanted != its:
            raise ValueError(f"resume: was rendered with {name} = {its}; must be {wanted}")
