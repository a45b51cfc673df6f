"""The command `tofrender render`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..rendering.settings import RenderSettings
from ..runtime import atomic
from ..runtime.progress import deferred_stop
from . import checkpoints, options as opt
from .answers import Json, answer, render_facts
from .frames import Animation, check_single, render_frames
from .writing import write

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

    from ..rendering.job import Job
    from ..runtime.checkpoints import Checkpoint

AUTOMATIC = "auto for built-in scenes and scenes without time bins, otherwise from the scene"
"""Default of --window and --pulse-width, see `_with_time`."""

WINDOW = ("start_opl", "bin_width", "window")
"""Settings of the time bins."""


SPECIAL: dict[str, Any] = {
    "size": opt.Pixels,
    "window": Annotated[
        Any,
        opt.setting(
            "window",
            opt.span,
            "auto looks for the arrival of the light; scene keeps the scene's bins.",
            default=AUTOMATIC,
        ),
    ],
    "pulse_width": Annotated[
        Any,
        opt.setting(
            "pulse_width",
            opt.pulse,
            "auto is 1/128 of the window; scene keeps the scene's pulse.",
            default=AUTOMATIC,
        ),
    ],
    "define": Annotated[
        list[Any] | None,
        opt.checked(
            opt.definition,
            "Value of a parameter of the XML file. Repeat the option for more parameters.",
            "-D",
            "--define",
            metavar="NAME=VALUE",
        ),
    ],
}
"""Options for settings with other values than in Python."""

DEFAULTS = {each.name: each.default for each in fields(RenderSettings)}
OPTIONS = {name: DEFAULTS[name] for name in DEFAULTS if name not in ("scene", "settings")}
"""Settings that are options, with their defaults."""

SETTINGS = opt.Group.of_settings(OPTIONS, SPECIAL)


@opt.with_groups
def render(
    scene: opt.Scene,
    out: opt.Out,
    *,
    options: Annotated[dict[str, Any], SETTINGS],
    variant: opt.Variant = None,
    files: opt.Files,
    animation: Animation,
    processes: opt.Processes,
    stopping: checkpoints.Stopping,
    as_json: Json = False,
) -> None:
    """Render light in flight to a stack of images.

    The command writes the transient image, its sum over time (steady.exr), a video and a summary
    figure. Options that are not given keep the values of the scene.

    Time axis: built-in scenes, and scenes without time bins, get a window that contains their
    light, unless --start-opl, --bin-width or --window is given. Together with this window they get
    a suitable pulse, unless --pulse-width is given. Without --bins, a scene without time bins gets
    300 bins.

    Stopping: DIR appears when all its files are complete. Until then a checkpoint is kept next to
    DIR. Ctrl-C, SIGTERM and SIGHUP write the result so far. With --resume the command continues a
    stopped or killed run, or adds samples to the render in DIR. A complete render is not changed.
    Without --resume the command refuses to replace the checkpoint of a stopped run.

    Memory: a film that does not fit into memory is rendered in tiles on the disk. Tiles are also
    used with --format zarr, --workers and --scheduler.

    Polarization: with a polarized --variant, EXR files contain Stokes vectors in the channels S0.R
    to S3.B. The video, PNG frames and the summary show S0, and a second figure shows the
    polarization.

    Denoising: with --denoise and --format npz, the file also contains the noisy film.

    Animation: with --frames, DIR contains the folders frame_0000, frame_0001 and so on, each with
    the files of a render, and also a video and steady.npy of the steady images of all frames. Frame
    k starts at the time k times --frame-time.

    Examples:
        tofrender render cornell_box --out box --spp 64
        tofrender render scene.xml --out hall --bins 500 --window 2,20 --format npz
    """
    # ------------------------------------------ Check all options before any work starts
    resume = stopping.resume
    denoise = options["denoise"]
    on_disk = files.format == "zarr"
    if denoise and (processes.are_given or on_disk):
        raise ValueError(
            "--denoise cannot be combined with --workers, --scheduler or --format zarr. Remove one "
            "of them"
        )
    if animation.times:
        check_single(out, files, options | vars(processes) | vars(stopping))
    else:
        opt.check_out(out)
    opt.activate(variant, polarized=True)

    from tofrender.rendering.collecting import collect
    from tofrender.rendering.job import dataset_of, remaining
    from tofrender.rendering.renderer import make_job
    from tofrender.rendering.work_items import render_item
    from tofrender.scenes.loading import find_scene

    found = {"scene": find_scene(scene), "define": dict(options["define"] or ())}
    settings = _with_time(options | found)
    if animation.times:
        from tofrender.motion.frames import Shutter, open_frames

        shutter = Shutter(animation.exposure, animation.poses, animation.row_time)
        job, shutter = open_frames(settings, animation.times, shutter)
        if options["window"] is None:
            _report_time(settings, job)
        render_frames(
            job,
            animation.times,
            shutter,
            out=out,
            files=files,
            resume=resume,
            as_json=as_json,
        )
        return
    job = make_job(settings)
    if options["window"] is None:
        _report_time(settings, job)
    height, width, count, channels = job.film.shape
    films = 2 if job.settings.errors else 1
    cells = height * width * films * count
    opt.check_out(out, (height, width, films * count, channels), files.precision)
    if stopping.checkpoint:
        # A checkpoint contains the weight of the samples in each bin as well
        opt.check_disk_space(out, cells * channels, cells * (channels + 1))

    complete = _complete(out, job) if resume and checkpoints.unfinished_work(out) is None else None
    if complete is not None:
        names = sorted(path.name for path in out.iterdir())
        lines = [f"{out}: already complete, {complete.attrs['spp']} samples per pixel"]
        answer("render", as_json, render_facts(complete, out, names), lines)
        return

    # ---------------------------------------------------------------- Render and write
    with (
        checkpoints.checkpointed(out, stopping.checkpoint, resume) as file,
        processes.client() as client,
    ):
        film = checkpoints.film_path(out)
        begun = checkpoints.is_begun(film) and not denoise
        if client is None and not on_disk and not begun and _fits(job):
            earlier = _earlier(out, file) if resume else None
            result = render_item(job, remaining(job, earlier), checkpoint=file)
            dataset = dataset_of(job, result, earlier)
        elif client is not None and job.plan.splats:
            checkpoints.require_begun(resume, file and file.path, out)
            dataset = dataset_of(job, collect(job, client, file))
        else:
            checkpoints.require_begun(resume, film, out)
            dataset = _on_disk(job, film, client, stopping.checkpoint, resume)
        with deferred_stop() as stop:
            names = write(dataset, out, files)
        answer("render", as_json, render_facts(dataset, out, names), _report(dataset, out, names))
        checkpoints.end_if_incomplete(dataset.attrs)
    checkpoints.end_if_stopped(stop)


def _with_time(options: dict[str, Any]) -> RenderSettings:
    """Return the settings of a render with its time axis.

    Built-in scenes, and scenes without time bins, get an automatic window unless one of `WINDOW` is
    given. With this window they get an automatic pulse unless a pulse is given.
    """
    from ..rendering.renderer import with_default_window

    # The value "scene" keeps what the scene defines, as None does in `RenderSettings`
    times = ("window", "pulse_width")
    kept: dict[str, Any] = {name: None for name in times if options[name] == opt.SCENE_TIME}
    settings = RenderSettings(**options | kept)

    # A film without time bins gets an automatic window
    found = with_default_window(settings)
    has_no_bins = found is not settings
    if has_no_bins and options["window"] == opt.SCENE_TIME:
        raise ValueError(
            "--window = scene: must be auto or START,STOP, because the film of the scene is "
            "steady, without time bins"
        )
    if has_no_bins and options["pulse_width"] == opt.SCENE_TIME:
        return replace(found, pulse_width=None)

    # A built-in scene without a window gets an automatic one, and without a pulse that, too
    has_window = any(options[name] is not None for name in WINDOW)
    if has_window or not isinstance(settings.scene, str):
        return found
    pulse_width = "auto" if options["pulse_width"] is None else found.pulse_width
    return replace(found, window="auto", pulse_width=pulse_width)


def _report_time(settings: RenderSettings, job: Job) -> None:
    """Print the automatic window and pulse."""
    if settings.window != "auto":
        return  # The scene's own bins
    found = f"bins from {job.film.start_opl:.4g} to {job.film.end_opl():.4g} m"
    if settings.pulse_width == "auto" and isinstance(job.settings.pulse_width, float):
        found += f" and a pulse of {job.settings.pulse_width:g} m"
    opt.note(f"note: chose {found} automatically; --window START,STOP sets other bins")


def _fits(job: Job) -> bool:
    """Return whether the film of a job fits into memory; print a note if it does not."""
    from tofrender.rendering.job import whole

    try:
        job.require_memory(whole(job).count)
    except MemoryError as error:
        if job.settings.denoise:
            raise
        opt.note(f"note: {error}; the film is rendered in tiles on the disk")
        return False
    return True


def _on_disk(
    job: Job, film: Path, client: Client | None, seconds: float, resume: bool
) -> xr.Dataset:
    """Render a job on the disk, or open the film that a killed run has finished."""
    from tofrender.rendering.films_on_disk import is_film, load_zarr
    from tofrender.rendering.job import check_resume, whole
    from tofrender.rendering.stored_film import under_way
    from tofrender.rendering.streaming import stream

    if not resume:
        for unfinished in (film, under_way(film)):
            atomic.remove(unfinished)
    if not is_film(film):
        return stream(
            job, film, client=client, seconds=seconds, tell=opt.note, again=checkpoints.AGAIN
        )
    dataset = load_zarr(film)
    check_resume(dataset, job)
    spp = dataset.attrs["spp"]
    wanted = whole(job).count
    if spp != wanted:
        raise ValueError(
            f"--resume: the film was rendered with --spp {spp}. Use the same value instead of "
            f"{wanted}"
        )
    return dataset


def _complete(out: Path, job: Job) -> xr.Dataset | None:
    """Load the render in `out` if it is the complete result of `job`; otherwise return None."""
    from ..rendering.job import check_resume, whole

    try:
        found = opt.load_render(out, "--resume")
    except (ValueError, OSError):
        # `_earlier` raises the error again
        return None
    if not found.attrs["complete"] or found.attrs["spp"] != whole(job).count:
        return None
    check_resume(found, job)
    return found


def _earlier(out: Path, file: Checkpoint | None) -> xr.Dataset | None:
    """Load the render in `out` to resume from; None if the checkpoint is sufficient."""
    first = None if file is None else file.recipe().get("resume")
    if file is not None and first == 0:
        return None
    earlier = opt.load_render(out, "--resume")
    if file is not None and earlier.attrs["spp"] != first:
        # DIR has changed since the checkpoint was written
        file.resume = False
    opt.note(f"resuming from {earlier.attrs['spp']} samples per pixel in {out}")
    return earlier


def _report(dataset: xr.Dataset, out: Path, files: Sequence[str]) -> list[str]:
    """Return lines with the names of the files, the time, and the energy outside the window."""
    frames = [name for name in files if name.startswith("frame_")]
    names = [name for name in files if name not in frames]
    if frames:
        names.insert(0, f"{frames[0]} ... {frames[-1]}")
    attrs = dataset.attrs
    seconds = attrs["render_seconds"]
    samples = dataset.sizes["y"] * dataset.sizes["x"] * attrs["spp"]
    return [
        f"{out}: {', '.join(names)}",
        f"{seconds:.1f} s, {samples / seconds:,.0f} samples per second, "
        f"{100 * attrs['energy_outside_window']:.1f} % of the energy outside the window",
    ]
