"""Fully specified render jobs, their work items and their results."""

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
from ..labels import FILM, read, require_same_labels
from ..runtime import checks, memory, plugins
from ..runtime.settings import SAMPLERS
from ..runtime.versions import versions
from ..scenes.fingerprint import fingerprint
from .arrivals import LAST_OPL, Arrivals, Look, looking_once
from .dataset import coordinates, require_finite, transient_dataset
from .errors import batches_of
from .settings import RenderSettings, is_auto
from .time_window import (
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

# Plugin of the sampler, if the settings do not contain a sampler
DEFAULT_SAMPLER = "padded_sobol"

# Films that the denoising filter needs in memory, in addition to the rendered film
DENOISING = 7


@dataclass(frozen=True, order=True)
class WorkItem:
    """Rectangle of pixels and range of samples that are rendered together."""

    # First row and first column of the pixels in the film's crop window
    y: int
    x: int

    # Number of rows and columns
    height: int
    width: int

    # Number of samples per pixel that precede the item's samples
    first: int

    # Number of samples per pixel
    count: int

    def pixels(self, array: np.ndarray) -> np.ndarray:
        """Return a view of the item's pixels in an array (height, width, ...) of the whole film."""
        return array[self.y : self.y + self.height, self.x : self.x + self.width]


@dataclass
class WorkResult:
    """Result of a work item."""

    # `transient` (height, width, temporal_bins, channels), `steady` (height, width, channels), and
    # optionally their standard errors `transient_error` and `steady_error`
    arrays: dict[str, np.ndarray]

    # Number of rendered samples per pixel; smaller than the item's count after an interruption
    done: int

    # Number of ignored contributions, which were NaN or infinite
    not_finite: int = 0

    # Duration of the work [s]
    seconds: float = 0.0


@dataclass
class Job:
    """A fully specified render job."""

    # The integrator and its plan for the scene and the sensor
    plan: Plan
    integrator: TransientIntegrator

    scene: mi.Scene
    settings: RenderSettings

    # Empty film with the final window
    film: TransientHDRFilm

    # Temporal profile of a contribution on the film; None for an instantaneous contribution
    profile: Pulse | None

    # Energy over path length; None if the caller has chosen the window
    arrivals: Arrivals | None

    # Function that makes the same job in a worker, and its arguments without the time axis
    origin: tuple[Callable[..., Job], Mapping[str, object]]

    # Further values that the result depends on, by name
    more: Mapping[str, object] = field(default_factory=dict)

    # Setting that finds a better window, for warnings
    window_option: str = WINDOW_OPTION

    @property
    def camera(self) -> mi.Sensor:
        """Sensor of the job."""
        return self.scene.sensors()[self.settings.sensor]

    def points(self, first: int = 0) -> mi.Sampler:
        """Return a sampler for the samples that remain after `first` samples per pixel."""
        return sampler_for(self.camera, self.settings.sampler, self.settings.spp, first)

    def recording(self, film: TransientHDRFilm) -> Recording:
        """Return the measurement that records the integrator's light on a film."""
        record = recording(film, self.integrator.exposure())
        if is_user_defined(self.integrator):
            record.require_no_lengths(type(self.integrator).__name__)
        return record

    @cached_property
    def recipe(self) -> dict[str, Any]:
        """All values that determine the picture, without the number of samples."""
        film = self.film
        integrator = self.integrator
        points = self.points()

        # Samplers in Python are named by their class, samplers of Mitsuba by their plugin
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
        """All values that determine the result: `more`, the recipe and the film."""
        named = {**self.more, **self.recipe, "film": str(self.film)}

        # Report settings with a name before the fingerprint
        return named | {"fingerprint": named.pop("fingerprint")}

    def add(self, arrays: dict[str, np.ndarray], item: WorkItem, result: WorkResult) -> None:
        """Add the result of a work item to the arrays of the whole film."""
        # Weight the item by its fraction of the samples
        fraction = np.float32(item.count / self.points().sample_count())
        for name, part in result.arrays.items():
            pixels = item.pixels(arrays[name])
            pixels += part if fraction == 1 else fraction * part
        arrays["not_finite"] += result.not_finite

    def require_memory(self, spp: int) -> None:
        """Raise a MemoryError if a render of `spp` samples per pixel does not fit into memory."""
        # Copies of the bins on the device. Long renders also need sums of flushed samples
        channels = self.film.shape[3]
        flushed = 2 if spp > MAX_ADDED else 1
        films = 2 if self.plan.splats else 1
        copies = flushed * films

        # Further arrays on the host, in units of a film. The channels of a film are padded
        packed = channels / memory.stride(channels)
        more = 2 * packed if self.settings.errors else DENOISING * packed * self.settings.denoise
        memory.require_film(
            *self.film.shape,
            copies=copies + more,
            device_copies=copies,
            host_copies=TAKEN_COPIES + films - 1 + more,
        )


def whole(job: Job, first: int = 0) -> WorkItem:
    """Return the work item of all pixels and of all samples after the `first` samples."""
    height, width, _, _ = job.film.shape
    return WorkItem(
        y=0,
        x=0,
        height=height,
        width=width,
        first=first,
        count=job.points(first).sample_count(),
    )


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
    """Find the window of a render and return the job.

    Args:
        plan: Plan of the integrator for the scene.
        integrator: The integrator.
        scene: The scene.
        settings: Settings of the render.
        origin: Function that makes the same job in a worker, and its arguments.
        axis: Number, start and width [m] of the time bins, if the caller has chosen them.
        may_be_dark: Accept a window that no light reaches.
        look: Function for test renders. If it is missing, a new function is made.
    """
    # Find the window
    camera = scene.sensors()[settings.sensor]
    if axis is not None:
        film = transient_film(camera.film(), *axis)
        profile = None
        arrivals = None
    else:
        film, profile, arrivals = film_of_light(plan, integrator, camera, settings, look)
        if not may_be_dark:
            check_window(film, arrivals, profile)

    # Is the number of samples suitable for batches, or for two halves?
    job = Job(
        plan=plan,
        integrator=integrator,
        scene=scene,
        settings=settings,
        film=film,
        profile=profile,
        arrivals=arrivals,
        origin=origin,
    )
    if settings.errors:
        batches_of(whole(job).count)
    if settings.denoise:
        points = job.points()
        count = whole(job).count
        points.set_sample_count(max(count // 2, 1))
        halves = "even with denoise, each half one for the sampler"
        checks.require("spp", count, 2 * points.sample_count() == count, halves)
    return job


def remaining(job: Job, resume: xr.Dataset | None = None) -> WorkItem:
    """Return the work item of all pixels and of the samples that an earlier render lacks.

    Raises:
        ValueError: The earlier render does not match the job.
        MemoryError: The film does not fit into memory.
    """
    earlier, first = (None, 0) if resume is None else _read_earlier(resume)
    item = whole(job, first)
    job.require_memory(item.count)

    # Is the earlier render a part of this render?
    if earlier is not None:
        check_resume(earlier, job)
        if job.settings.denoise:
            raise ValueError("resume: must be left out with denoise")
    return item


def dataset_of(job: Job, result: WorkResult, resume: xr.Dataset | None = None) -> xr.Dataset:
    """Return the Dataset of a rendered film, combined with an earlier render.

    Warns of missing samples, contributions and energy.
    """
    # Are all samples finished?
    earlier, first = (None, 0) if resume is None else _read_earlier(resume)
    count = whole(job, first).count
    if result.done < count:
        what = f"returning {result.done} of {count} samples per pixel"
        warnings.warn(f"interrupted: {what}", stacklevel=3)

    # Average with the earlier render, weighted by samples; errors add in quadrature
    arrays = result.arrays
    seconds = result.seconds
    not_finite = result.not_finite
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

    # Find the energy of the intensity S0; the other Stokes components may be negative
    colors = job.film.base_channels_count()
    steady, transient = (
        float(np.sum(arrays[name][..., :colors], dtype=np.float64))
        for name in ("steady", "transient")
    )

    # Make the Dataset
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

    # The import of SciPy is slow, so import only when needed
    from .denoised import denoised

    return denoised(dataset, job.scene, job.camera, job.film)


def render_attributes(job: Job, steady: float, transient: float) -> dict[str, Any]:
    """Return the attributes of a Dataset that do not depend on the number of samples.

    Args:
        job: The job.
        steady: Sum of the steady picture.
        transient: Sum of all time bins.
    """
    outside = 1 - transient / steady if steady else 0.0
    return job.recipe | {
        "scene": job.settings.scene_label,
        "energy_outside_window": min(max(outside, 0.0), 1.0),
    }


def warn_of_missing(job: Job, attrs: Mapping[str, Any], stacklevel: int) -> None:
    """Warn of ignored contributions and of energy outside the window, given the attributes."""
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
    """Return the film with its final window, its temporal profile, and the energy over path length.

    Raises:
        ValueError: The film does not suit the integrator, or an automatic window finds no light.
    """
    # Make the film of the settings. This step also checks that film and integrator fit together
    exposure = integrator.exposure()
    film = windowed_film(camera.film(), *settings.time_axis)
    profile = seen_pulse(film, exposure)

    # Make a test render
    look = look or looking_once(plan, camera, film)
    arrivals = look(ARRIVALS_SEED)

    # Choose an automatic window
    if is_auto(settings.window):
        allowed = "pass window = (start, stop) in meters"
        if not arrivals.any:
            raise ValueError(f"window = 'auto': no light found; {allowed}")
        if arrivals.energy[-1] > 0:
            late = f"light arrives after more than {LAST_OPL:g} m, too late for an automatic window"
            raise ValueError(f"window = 'auto': {late}; {allowed}")
        arrivals = enlarged(arrivals, profile, look)
        film = windowed_film(camera.film(), arrivals.window(integrator.pulse), settings.bins)

        # The width of a temporal filter depends on the width of a bin, so choose the window again
        profile = seen_pulse(film, exposure)
        film = windowed_film(camera.film(), arrivals.window(profile), settings.bins)
    return film, profile, arrivals


def sampler_for(camera: mi.Sensor, sampler: object, spp: int | None, first: int = 0) -> mi.Sampler:
    """Return a sampler for the samples that remain after `first` samples per pixel.

    Args:
        camera: The sensor.
        sampler: A sampler, the name of a plugin, or None for the default plugin.
        spp: Samples per pixel, including the `first` samples. None uses the number of the
            sampler that was passed, or of the sensor's sampler.
        first: Samples per pixel of an earlier render.
    """
    # Find the number of samples
    given = sampler if isinstance(sampler, mi.Sampler) else camera.sampler()
    count = given.sample_count() if spp is None else spp
    count = checks.integer("spp", count, 1, checks.MAX_SPP)
    if count <= first:
        raise ValueError(f"spp = {count}: must be above {first}, which resume has already")

    # Clone a given sampler, or load a plugin
    if isinstance(sampler, mi.Sampler):
        points = sampler.clone()
        points.set_sample_count(count - first)
        return points
    kind = DEFAULT_SAMPLER if sampler is None else checks.one_of("sampler", sampler, SAMPLERS)
    return mi.load_dict({"type": plugins.qualified_name(kind), "sample_count": count - first})


def _read_earlier(resume: object) -> tuple[xr.Dataset, int]:
    """Read the Dataset of an earlier render. Return the Dataset and its samples per pixel."""
    earlier = read(resume, FILM, "resume")
    try:
        require_finite(earlier)
        return earlier, checks.integer("spp", earlier.attrs.get("spp"), 1, checks.MAX_SPP)
    except ValueError as error:
        raise ValueError(f"resume: {error}") from None


def check_resume(resume: xr.Dataset, job: Job) -> None:
    """Raise a ValueError if an earlier render has other settings or coordinates than the job."""
    for name, value in job.recipe.items():
        its = resume.attrs.get(name)
        if its != value:
            raise ValueError(f"resume: was rendered with {name} = {its!r}; must be {value!r}")
    require_same_labels(resume, coordinates(job.film), "resume", "this render")
    found = {"errors": "transient_error" in resume, "denoise": bool(resume.attrs.get("denoised"))}
    for name, its in found.items():
        wanted = getattr(job.settings, name)
        if wanted != its:
            raise ValueError(f"resume: was rendered with {name} = {its}; must be {wanted}")
