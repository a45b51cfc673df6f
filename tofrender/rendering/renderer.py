"""Function `render`, which renders a scene and returns a labeled Dataset.

All arguments and the scene are checked before the work starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import mitsuba as mi

from ..integrators.user_defined import follows_beams
from ..runtime import checks, variants
from ..runtime.checkpoints import Checkpoint
from ..runtime.editions import LeftOut
from ..runtime.parameters import filled, takes
from ..runtime.progress import status, without_bars
from ..runtime.settings import INTEGRATORS
from ..scenes.checking import check_scene
from ..scenes.loading import is_steady, load_plugin, load_scene, require_light, require_sensor
from ..scenes.packing import packed
from ..signals.pulses import GaussianPulse
from .arrivals import Look, looking_once
from .collecting import collect
from .job import Job, dataset_of, decide, remaining
from .settings import RenderArguments, RenderSettings, is_auto
from .stored_film import check_film
from .streaming import stream
from .time_window import BINS, pulse_width_for, windowed_film
from .work_items import render_item
from .workers import check_workers, workers_for

if TYPE_CHECKING:
    import xarray as xr

    from ..integrators.base import TransientIntegrator

# Changes of a scene, in the argument `settings`, that set time bins
WINDOW_CHANGES = {"temporal_bins", "start_opl", "bin_width_opl"}


@takes(RenderArguments)
def render(*args: Any, **options: Any) -> xr.Dataset:  # noqa: D417, the record has them
    """Render a scene in time.

    The arguments have the names of the options of the command `tofrender render`. Arguments up to
    `denoise` define the picture. Arguments from `resume` on are the execution: they define how the
    work is done, with the earlier result, the place of the film, and the processes. The result does
    not support derivatives. Call `mi.render(scene, params)` for derivatives.
    See also `load_scene`, `merge`, `explore`, `report`.

    Args:
        scene: Built-in name or path of a Mitsuba XML file; or a dict as for `mi.load_dict`, or a
            loaded scene.
        spp: Samples per pixel, 1 to 2^24; by default the scene's. Powers of two suit the default
            sampler best; Mitsuba's samplers round to what they can do.
        seed: Seed of all random numbers. Two renders with the same seed agree to float rounding.
        size: Width and height of the picture [pixels]; by default the film's.
        bins: Number of time bins; by default the film's. A scene with a steady film becomes
            transient, with 300 bins by default. Its window is "auto" by default. Its pulse is
            "auto" if neither a window nor a pulse is given.
        start_opl: Start of the first time bin, optical path length [m]; by default the film's.
        bin_width: Width of a time bin, optical path length [m]; by default the film's.
        window: Start of the first and stop of the last time bin [m], instead of `start_opl` and
            `bin_width`. "auto" looks for the window that contains 99.9 % of the light.
        pulse_width: Standard deviation of the Gaussian pulse [m]; by default the integrator's.
            "auto" is 1/128 of the window, unless the integrator has a pulse.
        max_depth: Longest path in segments, -1 for no limit; by default the integrator's.
        integrator: Integrator plugin: a name, a dict or an integrator; by default the scene's. A
            name or a dict keeps the scene's values of `max_depth`, `rr_depth` and `hide_emitters`
            unless it changes them. For a loaded scene it has its own defaults.
        sampler: Plugin of random numbers: a name or a sampler, by default `padded_sobol`, even if
            the scene contains a sampler. The steady picture of the Cornell box has about half the
            variance of Mitsuba's default sampler. A sampler is cloned, and its `sample_count` is
            used if `spp` is not given.
        sensor: Index of the sensor.
        define: Values of an XML file's parameters, by name.
        settings: More changes of the scene while it is loaded, as keyword arguments of `load_scene`
            by name.
        errors: Estimate the standard error of each bin from 16 independent batches of samples, or
            from 8 or 4 batches if `spp` is not a multiple of 16.
        denoise: Remove noise from the film by the difference of two renders with half of the
            samples each, see `denoise`. `spp` must be even, and the memory must hold seven more
            films. The variable `raw` is the noisy film.
        resume: A Dataset of the same render with fewer samples, stopped or complete. Only the
            missing samples are rendered, with `padded_sobol` from the same point set. With a film
            filter other than box, the result differs from the result of one render by at most 1/20
            of the noise.
        checkpoint: A `Checkpoint`, or the name of its file. The film is saved there every 30 s and
            when the render is stopped. A call with equal arguments, except `spp`, continues from
            the file and gives the same result.
        out: Name of a folder that ends in .zarr. The film is written there tile by tile, and may be
            larger than the memory. The same call continues a render that was stopped.
        workers: Number of local worker processes. They render tiles, or parts of the samples for
            light tracing. The scene must be a name, a file or a dict.
        scheduler: Address of a Dask scheduler. Its workers render.
        client: A `distributed.Client` of a scheduler.
        progress: Show progress bars of long work.

    Returns:
        A Dataset with `transient (y, x, opl, channel)`, the radiance that arrives in each bin, and
        `steady (y, x, channel)`, the radiance over all time [W m^-2 sr^-1]. Coordinates are pixels
        and bin centers, as `opl` [m] and as `time` [ns]. In polarized variants, both variables have
        an axis `stokes` before the channels, with S0, S1, S2 and S3. The attributes describe the
        render. `energy_outside_window` is the fraction of the steady energy outside all bins. With
        `errors`, `transient_error` and `steady_error` are standard errors: in bins that many paths
        reach, the error is below one standard error in 2 of 3 bins. After Ctrl-C, SIGTERM or
        SIGHUP, the Dataset contains the finished samples, with `complete` = 0 and the number of
        finished samples in `spp`. A second signal ends the render at once.

    Raises:
        ValueError: An argument or the scene is wrong, or no light can reach the window.
        MemoryError: The bins do not fit into memory. The message names settings that fit.
        BackendError: The active variant does not support transient rendering.
        KeyboardInterrupt: A render with `out` or workers was stopped.

    Warns:
        UserWarning: More than 1 % of the energy is outside the window, or the render was stopped.

    Example:
        >>> dataset = render("cornell_box", spp=1, size=(64, 64), window=(3.5, 15.0))
        >>> dict(dataset.sizes)
        {'y': 64, 'x': 64, 'opl': 300, 'channel': 3}
        >>> dataset["transient"].sel(time=20.0, method="nearest").dims
        ('y', 'x', 'channel')
    """
    # Check the settings, and which arguments may occur together
    variants.require_vectorized()
    given = filled(RenderArguments, render, args, options)
    checks.boolean("progress", given.progress)
    wanted = RenderSettings(**given.values)
    out = given.out
    checkpoint = given.checkpoint
    resume = given.resume
    client = given.client
    by_workers = check_workers(workers=given.workers, scheduler=given.scheduler, client=client)
    if out is not None:
        check_film(out)
    if out is not None and checkpoint is not None:
        raise ValueError("checkpoint: must be left out with `out`, which keeps all tiles")
    if wanted.denoise and (out is not None or by_workers):
        raise ValueError("denoise = True: must be False with `out` or with workers")
    if resume is not None and (out is not None or by_workers):
        raise ValueError("resume: must be left out with `out` or with workers; see `merge`")

    # Can the scene be sent to workers?
    if by_workers:
        packed("scene", wanted.scene)

    with without_bars(not given.progress), status("Rendering"):
        job = make_job(wanted)
        if client is None:
            processes = workers_for(given.workers, given.scheduler)
        else:
            processes = nullcontext(client)
        with processes as client:
            # Render to disk, by workers or in this process
            if out is not None:
                return stream(job, out, client=client)
            if client is not None:
                result = collect(job, client, checkpoint)
            else:
                item = remaining(job, resume)
                checkpoint = Checkpoint.of(checkpoint)
                result = render_item(job, item, checkpoint=checkpoint)
            return dataset_of(job, result, resume)


def make_job(
    settings: RenderSettings,
    axis: tuple[int, float, float] | None = None,
    may_be_dark: bool = False,
) -> Job:
    """Load the scene, find its window and pulse, and return the job.

    The scene is loaded once, and each test render is made once.

    Args:
        settings: Settings of the render.
        axis: Number, start and width [m] of the time bins, if the caller has chosen them.
        may_be_dark: Accept a window that no light reaches.
    """
    # Load the scene. Without an automatic pulse, the settings define the job
    settings = with_default_window(settings)
    scene, integrator = open_scene(settings)
    if not is_auto(settings.pulse_width):
        return _job_of(settings, scene, integrator, axis, may_be_dark)

    # Find the window of a render without a pulse, and the pulse that suits this window
    without_pulse = replace(settings, pulse_width=None)
    camera = scene.sensors()[settings.sensor]
    empty = windowed_film(camera.film(), *settings.time_axis)
    look = looking_once(integrator.plan(scene, camera), camera, empty)
    job = _job_of(without_pulse, scene, integrator, axis, may_be_dark, look)
    width = pulse_width_for(job.film, job.integrator.pulse)
    if width is None:
        return job

    # Give the scene's integrator the pulse. A second load could change objects of the caller
    _require_own_integrator(settings, integrator)
    integrator.pulse = GaussianPulse(width)
    with_pulse = replace(settings, pulse_width=width)
    return _job_of(with_pulse, scene, integrator, axis, may_be_dark, look)


def _job_of(
    settings: RenderSettings,
    scene: mi.Scene,
    integrator: TransientIntegrator,
    axis: tuple[int, float, float] | None,
    may_be_dark: bool,
    look: Look | None = None,
) -> Job:
    """Return the job of a loaded scene. See `decide` for the arguments."""
    plan = integrator.plan(scene, scene.sensors()[settings.sensor])
    origin = _job_in_worker, settings.values
    return decide(plan, integrator, scene, settings, origin, axis, may_be_dark, look)


def _require_own_integrator(settings: RenderSettings, integrator: TransientIntegrator) -> None:
    """Raise a ValueError if the integrator is an object that the caller put into a dict."""
    parts = settings.scene.values() if isinstance(settings.scene, Mapping) else ()
    if any(part is integrator for part in parts):
        raise ValueError(
            "pulse_width = 'auto': the integrator of the scene is a ready-made object, whose "
            "pulse is not changed. Describe the integrator by a dict, or set its pulse"
        )


def _job_in_worker(axis: tuple[int, float, float], **settings: Any) -> Job:
    """Make the job of these settings in a worker, with the given time axis."""
    return make_job(RenderSettings(**settings), axis)


def with_default_window(settings: RenderSettings) -> RenderSettings:
    """Add the missing settings of the time axis of a steady scene.

    By default, the number of bins is 300 and the window is "auto". The pulse is "auto" if the
    settings contain neither a window nor a pulse.
    """
    # Does the scene have time bins?
    changes = set(settings.settings or ())
    if changes & WINDOW_CHANGES or not _is_steady(settings):
        return settings

    # If only one of start and width is given, loading the scene fails and names the missing setting
    has_start = settings.start_opl is not None
    has_width = settings.bin_width is not None
    if has_start != has_width:
        return settings

    # Set the bins, and the window if it is missing
    settings = replace(settings, bins=settings.bins or BINS)
    if has_start or settings.window is not None:
        return settings
    settings = replace(settings, window="auto")

    # Set the pulse, unless a pulse is given or the caller made the integrator
    has_pulse = settings.pulse_width is not None or "pulse_width_opl" in changes
    is_fixed = isinstance(settings.scene, mi.Scene) or not isinstance(
        settings.integrator, str | Mapping | None
    )
    return settings if has_pulse or is_fixed else replace(settings, pulse_width="auto")


def _is_steady(settings: RenderSettings) -> bool:
    """Return whether the films of a scene lack time bins; the scene need not be loaded."""
    if isinstance(settings.scene, mi.Scene):
        return {sensor.film().class_name() for sensor in settings.scene.sensors()} == {"HDRFilm"}
    return is_steady(settings.scene, settings.define or {})


def open_scene(settings: RenderSettings) -> tuple[mi.Scene, TransientIntegrator]:
    """Load and check the scene and the integrator of the settings, and return both.

    Raises:
        ValueError: The scene, the sensor, the time axis or the integrator is wrong.
    """
    variants.require_vectorized()
    scene = settings.scene
    integrator = settings.integrator

    # Load the scene, with the integrator if it is given by a name or a dict
    if not isinstance(scene, mi.Scene):
        # Check a dict first, as Mitsuba's message for a whole scene depends on earlier loads
        if isinstance(integrator, Mapping):
            load_plugin("integrator", integrator, mi.Integrator)
        try:
            scene = load_scene(scene, **settings.scene_changes)
        except ValueError as error:
            error.args = (settings.translate(str(error)),)
            raise
        # The scene now contains the integrator
        if isinstance(integrator, str | Mapping):
            integrator = None

    # Does the integrator support all parts of the scene? Foreign integrators are refused later
    camera = require_sensor(scene, settings.sensor)
    own = None if integrator is None else _integrator(scene, integrator)
    chosen = scene.integrator() if own is None else own
    does = {name: getattr(chosen, f"follows_{name}", True) for name in ("media", "polarization")}
    does["beams"] = follows_beams(chosen)
    check_scene(scene, camera, **does)

    # Is the window valid?
    windowed_film(camera.film(), *settings.time_axis)

    # Is the integrator supported, and does the scene have a light?
    own = _integrator(scene, own)
    if own.needs_lights:
        require_light(scene)
    return scene, own


def _integrator(scene: mi.Scene, integrator: Any) -> TransientIntegrator:
    """Return the given integrator, or the integrator of the scene if `integrator` is None.

    Args:
        scene: The scene.
        integrator: Name, dict, integrator or None.

    Raises:
        ValueError: The integrator does not support transient rendering.
    """
    # Load the integrator
    if isinstance(integrator, str):
        integrator = {"type": checks.one_of("integrator", integrator, INTEGRATORS)}
    if isinstance(integrator, Mapping):
        integrator = load_plugin("integrator", integrator)
    found: Any = scene.integrator() if integrator is None else integrator

    # Is the integrator part of this edition of the package?
    left_out = getattr(found, "left_out", None)
    if left_out is not None:
        raise LeftOut(f"integrator = {left_out}")

    # Does the integrator fill time bins?
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
