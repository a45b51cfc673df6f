"""`render`: from a scene to a labelled Dataset, with everything checked before work starts."""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..films.cells import MAX_ADDED
from ..films.recording import profile as seen_pulse, recording
from ..integrators.own_sample import brings_sample
from ..integrators.passes import steps
from ..integrators.plan import Plan
from ..runtime import backend, checks, memory, plugins
from ..runtime.progress import deferred_stop, progress_bar
from ..runtime.withheld import Withheld
from ..scenes.checking import check_scene
from ..scenes.loading import load_plugin, load_scene, require_light, require_sensor
from ..scenes.settings import INTEGRATORS, SAMPLERS
from .arrivals import Arrivals, find_arrivals
from .dataset import check_dataset, coordinates, require_finite, transient_dataset
from .fingerprint import fingerprint
from .window import check_window, is_auto, start_and_width, warn_of_losses, windowed_film

if TYPE_CHECKING:
    import xarray as xr

    from ..signals.pulses import Pulse


DEFAULT_SAMPLER = "padded_sobol"


def render(
    scene: mi.Scene | Mapping[str, Any] | str | PathLike[str],
    *,
    spp: int | None = None,
    seed: int = 0,
    integrator: Any = None,
    sensor: int = 0,
    sampler: str | mi.Sampler | None = None,
    window: str | tuple[float, float] | None = None,
    temporal_bins: int | None = None,
    resume: xr.Dataset | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Render a scene in time.

    Args:
        scene: A built-in name, the path of a Mitsuba XML file, a dict as for `mi.load_dict`, or a
            loaded scene.
        spp: Samples per pixel, 1 to 2^24; by default the scene's. Powers of two suit the default
            sampler best; Mitsuba's samplers round to what they can do.
        seed: Seed of all random numbers. Two renders with the same seed agree to float rounding.
        integrator: A plugin name, a dict or an integrator; by default the scene's. By name or dict
            it takes the place of the scene's while that is loaded, and what it does not say of
            `max_depth`, `rr_depth` and `hide_emitters` stays as it is there.
        sensor: Number of the sensor.
        sampler: `padded_sobol` by default, whatever the scene says: on the Cornell box, its steady
            picture has about half the variance of Mitsuba's default. A name picks another; an
            object is cloned, and its own `sample_count` counts if `spp` is not given.
        window: (start, stop) of the time bins, in metres of path; "auto" finds what holds 99.9 %
            of the light; by default the film's.
        temporal_bins: Number of bins; by default the film's.
        resume: A Dataset of the same render with fewer samples, stopped or complete, to go on
            from: only the samples that are missing are taken. `padded_sobol` goes on in the same
            point set.
        progress: Whether to show a bar for work that takes more than two seconds.

    Returns:
        A Dataset with `transient (y, x, opl, channel)`, the radiance that arrives in each bin, and
        `steady (y, x, channel)`, that of all time [W m^-2 sr^-1]. Coordinates are pixels and bin
        centres [m]; attributes say how it was made, among them `energy_outside_window`, the
        fraction of the steady energy that no bin holds. Ctrl-C returns what is finished, with
        `complete` = 0 and `spp` as far as it got.

    Raises:
        ValueError: An argument or the scene is wrong, or no light can reach the window.
        MemoryError: The bins do not fit; the message says what would.
        BackendError: The active variant cannot render in time.

    Warns:
        UserWarning: More than 1 % of the energy is outside the window, or the render was stopped.

    Example:
        >>> dataset = render("cornell_box", spp=1, window=(3.5, 15.0))
        >>> dict(dataset.sizes)
        {'y': 256, 'x': 256, 'opl': 300, 'channel': 3}
    """
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    name = scene_name(scene)
    scene, sensor, integrator = opened(scene, sensor, integrator, window, temporal_bins)
    camera = scene.sensors()[sensor]
    tracer = _integrator(scene, integrator)
    if tracer.needs_lights:
        require_light(scene)
    return carry_out(
        tracer.plan(scene, camera),
        tracer,
        scene,
        name=name,
        spp=spp,
        seed=seed,
        sensor=sensor,
        sampler=sampler,
        window=window,
        temporal_bins=temporal_bins,
        resume=resume,
        progress=progress,
    )


def carry_out(
    plan: Plan,
    tracer: Any,
    scene: mi.Scene,
    *,
    name: str,
    spp: int | None,
    seed: int,
    sensor: int,
    sampler: str | mi.Sampler | None = None,
    window: str | tuple[float, float] | None = None,
    temporal_bins: int | None = None,
    resume: xr.Dataset | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Carry out the plan of an integrator, `tracer`, on a film with bins.

    The Dataset calls the scene `name`; all else, result and errors, is as for `render`.
    """
    camera = scene.sensors()[sensor]
    film, profile, arrivals = film_of_light(plan, tracer, camera, window, temporal_bins, seed)
    check_window(film, arrivals, profile)
    first = 0 if resume is None else _samples_of(resume)
    points = sampler_for(camera, sampler, spp, first)
    folds = points.sample_count() > MAX_ADDED
    memory.require_film(*film.shape, copies=(2 if folds else 1) * (2 if plan.splats else 1))
    recipe = {
        "quantity": "radiance per bin",
        "units": "W m^-2 sr^-1",
        "start_opl": film.start_opl,
        "bin_width_opl": film.bin_width_opl,
        "pulse": str(tracer.pulse or "none"),
        "temporal_filter": tracer.temporal_filter or "as rfilter",
        "sensor": sensor,
        "fingerprint": fingerprint(scene, camera, tracer),
        "integrator": type(tracer).__name__,
        "max_depth": tracer.max_depth,
        "camera_unwarp": int(tracer.camera_unwarp),
        "sampler": _sampler_name(points),
        "seed": seed,
        "variant": mi.variant(),
        "versions": _versions(),
    }
    if resume is not None:
        _check_resume(resume, recipe, film)

    start = time.perf_counter()
    record = recording(film, tracer.exposure())
    if brings_sample(tracer):
        record.require_no_lengths(type(tracer).__name__)
    done = _run(plan, record, camera, points, seed, first, progress)
    seconds = time.perf_counter() - start

    record.report()
    before = 0 if resume is None else int(resume.attrs.get("contributions_not_finite", 0))
    steady, transient = film.take()
    if resume is not None:
        part = first / (first + done)
        steady += part * (resume["steady"].values - steady)
        transient += part * (resume["transient"].values - transient)
        seconds += resume.attrs["render_seconds"]
    complete = done == points.sample_count()
    total = float(np.sum(steady, dtype=np.float64))
    outside = 1 - float(np.sum(transient, dtype=np.float64)) / total if total else 0.0
    outside = min(max(outside, 0.0), 1.0)
    if complete:
        warn_of_losses(film, arrivals, profile, outside)
    attrs = recipe | {
        "scene": name,
        "spp": first + done,
        "energy_outside_window": outside,
        "complete": int(complete),
        "contributions_not_finite": record.not_finite + before,
        "render_seconds": seconds,
    }
    return transient_dataset(steady, transient, film, attrs)


# ------------------------------------------------------------------------ before rendering


def scene_name(scene: Any) -> str:
    """What a Dataset calls a scene: its name or path, else "scene"."""
    return os.fspath(scene) if isinstance(scene, str | PathLike) else "scene"


def opened(
    scene: Any, sensor: Any, integrator: Any, window: Any, temporal_bins: int | None
) -> tuple[mi.Scene, int, Any]:
    """Load and check a scene: gives it, the sensor's number, and the integrator if it is apart.

    The arguments are those of `render`.
    """
    backend.require_vectorised()
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, **_settings(integrator, window, temporal_bins))
        if isinstance(integrator, str | Mapping):
            integrator = None  # It is the scene's now
    require_sensor(scene)
    sensors = scene.sensors()
    sensor = checks.integer("sensor", sensor, 0, len(sensors) - 1)
    check_scene(scene, sensors[sensor])
    windowed_film(sensors[sensor].film(), window, temporal_bins)  # Refuses a wrong window first
    return scene, sensor, integrator


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


def _integrator(scene: mi.Scene, integrator: Any) -> Any:
    """The integrator to use."""
    if isinstance(integrator, str):
        integrator = {"type": checks.one_of("integrator", integrator, INTEGRATORS)}
    if isinstance(integrator, Mapping):
        integrator = load_plugin("integrator", integrator)
    found = scene.integrator() if integrator is None else integrator
    withheld = getattr(found, "withheld", None)
    if withheld is not None:
        raise Withheld(f"integrator = {withheld}")
    if not getattr(found, "fills_bins", False):
        cls = type(found)
        foreign = cls.__module__.partition(".")[0] not in ("mitsuba", "builtins", "tofrender")
        if foreign:
            kind = f"{cls.__module__}.{cls.__name__}"
        elif cls.__module__ == "mitsuba":
            kind = found.class_name()
        else:
            kind = repr(found) if isinstance(found, int | str | None) else cls.__name__
        raise ValueError(
            f"integrator = {kind}: cannot render in time; must be one of {', '.join(INTEGRATORS)}"
            + (", as this package has it: give the scene as a dict or file" if foreign else "")
        )
    return found


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


def _settings(integrator: Any, window: Any, temporal_bins: int | None) -> Any:
    """What makes a steady scene transient while it loads, where enough is given.

    An integrator takes the place of the scene's, which need not even load; for an object that is
    at hand any other keeps the place.
    """
    by_name = integrator is None or isinstance(integrator, str | Mapping)
    given = {"integrator": integrator if by_name else INTEGRATORS[0]}
    if window is None or temporal_bins is None:
        return given
    bins = checks.integer("temporal_bins", temporal_bins, 1, checks.MAX_BINS)
    start, width = (0.0, 1.0) if is_auto(window) else start_and_width(window, bins)
    return given | {"temporal_bins": bins, "start_opl": start, "bin_width_opl": width}


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


# --------------------------------------------------------------------------- the render


def _run(plan, record, camera, points, seed, first, progress) -> int:
    """Take all steps; returns the samples per pixel that the film holds, fewer after Ctrl-C."""
    spp = points.sample_count()
    done = 0
    with (
        progress_bar("Rendering", spp, unit="spp", enabled=progress) as bar,
        deferred_stop() as stop,
    ):
        for done in steps(plan, record, camera, points, seed, first):
            bar.update(done - bar.n)
            if stop.requested:
                break
    if done < spp:
        warnings.warn(f"interrupted: returning {done} of {spp} samples per pixel", stacklevel=4)
    return done


def _versions() -> str:
    """Versions of what made the picture, as JSON."""
    from importlib.metadata import version

    from .. import __version__

    found = {"tofrender": __version__, "mitsuba": mi.__version__, "drjit": version("drjit")}
    return json.dumps(found)
