"""`render`: from a scene to a labelled Dataset, with everything checked before work starts."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from . import backend, checks, memory
from .arrivals import Arrivals, find_arrivals
from .loading import load_scene, require_light, require_sensor
from .progress import deferred_stop, progress_bar
from .settings import INTEGRATORS, SAMPLERS

if TYPE_CHECKING:
    import xarray as xr

DEFAULT_SAMPLER = "owen_sobol"
LOST_ENERGY = 0.01
"""Energy outside the window, as a fraction, above which `render` warns."""


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
        integrator: A plugin name, a dict or an integrator; by default the scene's.
        sensor: Number of the sensor.
        sampler: `owen_sobol` by default, whatever the scene says: its error is a fraction of that
            of Mitsuba's default. A name picks another, an object is used as it is.
        window: (start, stop) of the time bins, in metres of path; "auto" finds what holds 99.9 %
            of the light; by default the film's.
        temporal_bins: Number of bins; by default the film's.
        resume: A Dataset of the same render with fewer samples, stopped or complete, to go on
            from: only the samples that are missing are taken. `owen_sobol` goes on in the same
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
    checks.integer("seed", seed, 0, checks.MAX_SEED)
    name = scene if isinstance(scene, str) else "scene"
    scene = load_scene(scene)
    require_sensor(scene)
    require_light(scene)
    sensors = scene.sensors()
    camera = sensors[checks.integer("sensor", sensor, 0, len(sensors) - 1)]
    film = _film(camera.film(), window, temporal_bins)
    tracer = _integrator(scene, integrator)
    tracer.temporal_profile(film)  # Refuses what does not fit together
    arrivals = find_arrivals(tracer, scene, camera, film, tracer.pulse, seed)
    if window == "auto":
        film = _film(camera.film(), _auto_window(arrivals), temporal_bins)
    _check_window(film, arrivals)
    memory.require_film(*film.shape)
    first = 0 if resume is None else int(resume.attrs.get("spp", 0))
    points = _sampler(camera, sampler, spp, first)
    recipe = {
        "quantity": "radiance per bin",
        "units": "W m^-2 sr^-1",
        "start_opl": film.start_opl,
        "bin_width_opl": film.bin_width_opl,
        "pulse": str(tracer.pulse or "none"),
        "temporal_filter": tracer.temporal_filter or "as rfilter",
        "scene": name,
        "integrator": type(tracer).__name__,
        "max_depth": tracer.max_depth,
        "sampler": _sampler_name(points),
        "seed": seed,
        "variant": mi.variant(),
        "versions": _versions(),
    }
    if resume is not None:
        _check_resume(resume, recipe, film)

    start = time.perf_counter()
    done = _run(tracer, scene, camera, film, points, seed, first, progress)
    seconds = time.perf_counter() - start

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
        _warn_of_losses(film, arrivals, outside)
    attrs = recipe | {
        "spp": first + done,
        "energy_outside_window": outside,
        "complete": int(complete),
        "render_seconds": seconds,
    }
    return _dataset(steady, transient, film, attrs)


# ------------------------------------------------------------------------ before rendering


def _integrator(scene: mi.Scene, integrator: Any) -> Any:
    """The integrator to use."""
    if isinstance(integrator, str):
        checks.one_of("integrator", integrator, INTEGRATORS)
        integrator = {"type": backend.own_name(integrator)}
    if isinstance(integrator, Mapping):
        integrator = mi.load_dict(dict(integrator))
    found = scene.integrator() if integrator is None else integrator
    if not hasattr(found, "steps"):
        kind = "None" if found is None else found.class_name()
        raise ValueError(
            f"integrator = {kind}: cannot render in time; must be one of {', '.join(INTEGRATORS)}"
        )
    return found


def _sampler(camera: mi.Sensor, sampler: Any, spp: int | None, first: int) -> mi.Sampler:
    """The sampler to use, its sample count set to what is missing after `first` samples."""
    count = camera.sampler().sample_count() if spp is None else spp
    count = checks.integer("spp", count, 1, checks.MAX_SPP)
    if count <= first:
        raise ValueError(f"spp = {count}: must be above {first}, which resume has already")
    if isinstance(sampler, mi.Sampler):
        points = sampler.clone()
        points.set_sample_count(count - first)
        return points
    kind = DEFAULT_SAMPLER if sampler is None else checks.one_of("sampler", sampler, SAMPLERS)
    return mi.load_dict({"type": backend.own_name(kind), "sample_count": count - first})


def _sampler_name(sampler: mi.Sampler) -> str:
    return sampler.class_name() if type(sampler) is mi.Sampler else type(sampler).__name__


def _film(film: Any, window: Any, temporal_bins: int | None) -> Any:
    """An empty film of the same pixels as `film`, with the window that is asked for."""
    timed = hasattr(film, "temporal_bins")
    if not timed and (window is None or temporal_bins is None):
        raise ValueError(
            f"film = {film.class_name()}: has no time bins; must be transient_hdr_film, or give "
            "both window and temporal_bins"
        )
    bins = film.temporal_bins if temporal_bins is None else temporal_bins
    bins = checks.integer("temporal_bins", bins, 1, checks.MAX_BINS)
    if window == "auto":
        start, width = 0.0, 1.0  # Until the light was looked at
    elif window is not None:
        start, width = _window(window, bins)
    else:
        start, width = float(film.start_opl), float(film.bin_width_opl)
    size, crop, offset = film.size(), film.crop_size(), film.crop_offset()
    return mi.load_dict(
        {
            "type": backend.own_name("transient_hdr_film"),
            "width": size.x,
            "height": size.y,
            "crop_width": crop.x,
            "crop_height": crop.y,
            "crop_offset_x": offset.x,
            "crop_offset_y": offset.y,
            "sample_border": film.sample_border(),
            "rfilter": film.rfilter(),
            "temporal_bins": bins,
            "start_opl": start,
            "bin_width_opl": width,
        }
    )


def _window(window: Any, bins: int) -> tuple[float, float]:
    """Start and bin width of a window given as (start, stop)."""
    try:
        start, stop = window
    except (TypeError, ValueError):
        raise ValueError(
            f"window = {window!r}: must be 'auto' or (start, stop) in metres"
        ) from None
    start, stop = checks.metres("window[0]", start), checks.metres("window[1]", stop)
    if stop <= start:
        raise ValueError(f"window = {window!r}: must end after it starts")
    return start, (stop - start) / bins


def _check_resume(resume: xr.Dataset, recipe: Mapping[str, Any], film: Any) -> None:
    """Refuse to go on with a render that was made in another way."""
    for name, value in recipe.items():
        if resume.attrs.get(name) != value:
            its = resume.attrs.get(name)
            raise ValueError(f"resume: was rendered with {name} = {its!r}; must be {value!r}")
    if resume["transient"].shape != film.shape:
        its = resume["transient"].shape
        raise ValueError(f"resume: has shape {its}; must be {film.shape}")


def _auto_window(arrivals: Arrivals) -> tuple[float, float]:
    if not arrivals.any:
        raise ValueError("window = 'auto': no light found in the scene; must be (start, stop)")
    return arrivals.window()


def _check_window(film: Any, arrivals: Arrivals) -> None:
    """Refuse a window that no light reaches."""
    start, stop = film.start_opl, film.end_opl()
    if not arrivals.any:
        warnings.warn("no light found on 65536 test paths: the picture may be black", stacklevel=3)
    elif not arrivals.between(start, stop):
        first, last = arrivals.window(1.0)
        raise ValueError(
            f"start_opl, end = {start:g} m, {stop:g} m: no light arrives in this window; "
            f"it must overlap {first:.4g} m to {last:.4g} m"
        )


# --------------------------------------------------------------------------- the render


def _run(tracer, scene, camera, film, points, seed, first, progress) -> int:
    """Take all steps; returns the samples per pixel that the film holds, fewer after Ctrl-C."""
    spp = points.sample_count()
    done = 0
    with (
        progress_bar("Rendering", spp, unit="spp", enabled=progress) as bar,
        deferred_stop() as stop,
    ):
        for done in tracer.steps(scene, camera, film, points, seed, first):
            bar.update(done - bar.n)
            if stop.requested:
                break
    if done < spp:
        warnings.warn(f"interrupted: returning {done} of {spp} samples per pixel", stacklevel=3)
    return done


def _warn_of_losses(film: Any, arrivals: Arrivals, outside: float) -> None:
    """Say when light is missing, and which window would hold it."""
    if outside > LOST_ENERGY:
        first, last = arrivals.window()
        warnings.warn(
            f"{100 * outside:.1f} % of the energy arrives outside the window {film.start_opl:g} to "
            f"{film.end_opl():g} m; {first:.4g} to {last:.4g} m would hold 99.9 % (window='auto')",
            stacklevel=3,
        )


def _versions() -> str:
    """Versions of what made the picture, as JSON."""
    from importlib.metadata import version

    from . import __version__

    found = {"tofrender": __version__, "mitsuba": mi.__version__, "drjit": version("drjit")}
    return json.dumps(found)


def _dataset(steady: np.ndarray, transient: np.ndarray, film: Any, attrs: dict) -> xr.Dataset:
    """Label the arrays."""
    import xarray as xr

    height, width, bins, channels = transient.shape
    x, y = (int(v) for v in film.crop_offset())
    centres = film.start_opl + (np.arange(bins) + 0.5) * film.bin_width_opl
    full = {"film_width": int(film.size().x), "film_height": int(film.size().y)}
    return xr.Dataset(
        {
            "transient": (("y", "x", "opl", "channel"), transient),
            "steady": (("y", "x", "channel"), steady),
        },
        coords={
            "y": np.arange(y, y + height),
            "x": np.arange(x, x + width),
            "opl": ("opl", centres, {"units": "m", "long_name": "optical path length"}),
            "channel": ["L"] if channels == 1 else ["R", "G", "B"],
        },
        attrs=attrs | full,
    )
