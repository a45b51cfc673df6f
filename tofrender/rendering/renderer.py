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
from ..films.image import time_bins, transient_film
from ..films.recording import profile as seen_pulse
from ..films.recording import recording
from ..integrators.own_sample import brings_sample
from ..integrators.passes import steps
from ..integrators.plan import Plan
from ..runtime import backend, checks, memory, plugins
from ..runtime.progress import deferred_stop, progress_bar
from ..runtime.withheld import Withheld
from ..scenes.checking import check_scene
from ..scenes.loading import load_plugin, load_scene, require_light, require_sensor
from ..scenes.settings import INTEGRATORS, SAMPLERS
from .arrivals import PATHS, Arrivals, find_arrivals
from .dataset import LOST_ENERGY, check_dataset, coordinates, require_finite, transient_dataset
from .fingerprint import fingerprint

if TYPE_CHECKING:
    import xarray as xr

    from ..signals.pulses import Pulse

DEFAULT_SAMPLER = "padded_sobol"
MANY_HITS = 250
"""Contributions near an empty window from which on chance cannot explain that it is empty."""


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
        sampler: `padded_sobol` by default, whatever the scene says: its error is a fraction of that
            of Mitsuba's default. A name picks another; an object is cloned, and its own
            `sample_count` counts if `spp` is not given.
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
    backend.require_vectorised()
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    name = os.fspath(scene) if isinstance(scene, str | PathLike) else "scene"
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, **_settings(integrator, window, temporal_bins))
        if isinstance(integrator, str | Mapping):
            integrator = None  # It is the scene's now
    require_sensor(scene)
    sensors = scene.sensors()
    sensor = checks.integer("sensor", sensor, 0, len(sensors) - 1)
    camera = sensors[sensor]
    check_scene(scene, camera)
    _film(camera.film(), window, temporal_bins)  # Refuses what is wrong with the window first
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
    camera, exposure = scene.sensors()[sensor], tracer.exposure()
    film = _film(camera.film(), window, temporal_bins)
    profile = seen_pulse(film, exposure)  # Refuses what does not fit together
    arrivals = find_arrivals(plan, camera, film, seed)
    if _is_auto(window):
        if not arrivals.any:
            raise ValueError("window = 'auto': no light found; must be (start, stop) in metres")
        film = _film(camera.film(), arrivals.window(tracer.pulse), temporal_bins)
        profile = seen_pulse(film, exposure)  # A filter's width is known when that of a bin is
        film = _film(camera.film(), arrivals.window(profile), temporal_bins)
    _check_window(film, arrivals, profile)
    first = 0 if resume is None else _samples_of(resume)
    points = _sampler(camera, sampler, spp, first)
    folds = points.sample_count() > MAX_ADDED
    memory.require_film(*film.shape, copies=2 if folds else 1)
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
    record = recording(film, exposure)
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
        _warn_of_losses(film, arrivals, profile, outside)
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


def _sampler(camera: mi.Sensor, sampler: Any, spp: int | None, first: int) -> mi.Sampler:
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


def _film(film: Any, window: Any, temporal_bins: int | None) -> Any:
    """An empty film of the same pixels as `film`, with the window that is asked for."""
    own = time_bins(film)
    if own is None and (window is None or temporal_bins is None):
        raise ValueError(
            f"film = {film.class_name()}: has no time bins; must be transient_hdr_film, or give "
            "both window and temporal_bins"
        )
    bins = own[0] if own and temporal_bins is None else temporal_bins
    bins = checks.integer("temporal_bins", bins, 1, checks.MAX_BINS)
    if _is_auto(window):
        start, width = 0.0, 1.0  # Until the light was looked at
    elif window is not None:
        start, width = _window(window, bins)
    else:
        assert own is not None
        _, start, width = own
    return transient_film(film, bins, start, width)


def _window(window: Any, bins: int) -> tuple[float, float]:
    """Start and bin width of a window given as (start, stop)."""
    try:
        start, stop = window
    except (TypeError, ValueError):
        raise ValueError(
            f"window = {window!r}: must be 'auto' or (start, stop) in metres"
        ) from None
    start, stop = checks.metres("window[0]", start), checks.metres("window[1]", stop)
    if not start < stop < start + checks.MAX_OPL:
        raise ValueError(f"window = {window!r}: must end after it starts, and not at infinity")
    return start, (stop - start) / bins


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
    start, width = (0.0, 1.0) if _is_auto(window) else _window(window, bins)
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


def _is_auto(window: Any) -> bool:
    return isinstance(window, str) and window == "auto"


def _check_window(film: Any, arrivals: Arrivals, profile: Pulse | None) -> None:
    """Refuse a window that no light reaches, and doubt one that none of the test paths reached.

    No light reaches a window where none was found while much was nearby, within a quarter of the
    path length, or where there was none nearby either. In between, light may be too rare.
    """
    start, stop = film.start_opl, film.end_opl()
    if not arrivals.any:
        warnings.warn(
            f"no light found on {PATHS} test paths: the picture may be black", stacklevel=4
        )
        return
    if arrivals.between(start, stop, profile):
        return
    first, last = arrivals.window(profile, 1.0)
    if not 0 < arrivals.between(start / 1.25, stop * 1.25, profile) < MANY_HITS:
        raise ValueError(
            f"start_opl, end = {start:g} m, {stop:g} m: no light arrives in this window; "
            f"it must overlap {first:g} m to {last:g} m"
        )
    warnings.warn(
        f"none of {PATHS} test paths arrives between {start:g} m and {stop:g} m: the bins may stay "
        f"empty; light was found from {first:g} m to {last:g} m",
        stacklevel=4,
    )


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


def _warn_of_losses(film: Any, arrivals: Arrivals, profile: Pulse | None, outside: float) -> None:
    """Say when light is missing, and which window would hold it."""
    if outside > LOST_ENERGY:
        first, last = arrivals.window(profile)
        warnings.warn(
            f"{100 * outside:.1f} % of the energy arrives outside the window {film.start_opl:g} to "
            f"{film.end_opl():g} m; {first:g} to {last:g} m would hold 99.9 % (window='auto')",
            stacklevel=4,
        )


def _versions() -> str:
    """Versions of what made the picture, as JSON."""
    from importlib.metadata import version

    from .. import __version__

    found = {"tofrender": __version__, "mitsuba": mi.__version__, "drjit": version("drjit")}
    return json.dumps(found)
