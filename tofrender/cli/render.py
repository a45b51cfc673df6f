"""The command `tofrender render`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..rendering.settings import RenderSettings
from ..runtime import atomic
from ..runtime.progress import EVERY_S, deferred_stop
from . import checkpoints, frames as animation, options as opt
from .answers import Json, answer, render_facts
from .writing import write

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

    from ..rendering.job import Job
    from ..runtime.checkpoints import Checkpoint

TIME = ("start_opl", "bin_width", "window", "pulse_width")  # Settings of the time axis


def render(
    scene: opt.Scene,
    out: opt.Out,
    spp: opt.Spp = None,
    size: opt.Pixels = None,
    bins: Annotated[int | None, opt.setting("bins")] = None,
    start_opl: Annotated[float | None, opt.setting("start_opl")] = None,
    bin_width: Annotated[float | None, opt.setting("bin_width")] = None,
    window: Annotated[
        Any, opt.setting("window", opt.span, "; auto finds what holds the light")
    ] = None,
    pulse_width: Annotated[
        Any, opt.setting("pulse_width", opt.pulse, "; auto takes a 128th of the window")
    ] = None,
    max_depth: opt.MaxDepth = None,
    integrator: Annotated[str | None, opt.setting("integrator")] = None,
    sampler: Annotated[str | None, opt.setting("sampler")] = None,
    sensor: Annotated[int, opt.setting("sensor")] = 0,
    variant: opt.Variant = None,
    seed: opt.Seed = 0,
    format: opt.Format = "frames",
    precision: opt.Precision = "float",
    define: Annotated[
        list[Any] | None,
        opt.checked(
            opt.definition, "XML parameter; repeatable.", "-D", "--define", metavar="NAME=VALUE"
        ),
    ] = None,
    video: opt.Video = True,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = None,
    errors: Annotated[bool, opt.setting("errors")] = False,
    denoise: Annotated[bool, opt.setting("denoise")] = False,
    frames: Annotated[
        int | None, opt.integer(1, 10_000, "Number of frames of a moving scene.")
    ] = None,
    frame_time: Annotated[float | None, opt.positive("seconds", "Seconds between frames.")] = None,
    exposure: Annotated[float, opt.real(0, "Seconds that each row is exposed.")] = 0.0,
    poses: Annotated[int | None, opt.integer(1, 4096, "Poses in an exposure; default 8.")] = None,
    row_time: Annotated[float, opt.real(0, "Seconds from a row's start to the next one's.")] = 0.0,
    workers: opt.Workers = None,
    scheduler: opt.Scheduler = None,
    checkpoint: checkpoints.Seconds = EVERY_S,
    resume: checkpoints.Resume = False,
    as_json: Json = False,
) -> None:
    """Render SCENE in time.

    Options that are not given keep the scene's values, except for time: a built-in scene, or one
    whose film is steady, gets a window that holds its light and a pulse that suits it, unless one
    of --start-opl, --bin-width, --window and --pulse-width is given. If the film is steady, --bins
    is 300 by default, and --window is auto by default. The command writes the
    transient image, its sum over time (steady.exr), a video and a summary figure. DIR is written
    atomically and replaces that of an earlier run. A checkpoint is kept beside it; Ctrl-C, SIGTERM
    and SIGHUP also write the result so far. --resume continues a stopped run, or a render in DIR
    with fewer samples; a complete one is not changed. Without --resume, the checkpoint of a stopped
    run is never replaced.

    A film that does not fit into memory is rendered tile by tile on the disk, as are those with
    --format zarr and by workers.

    In a polarised --variant, files have Stokes vectors, in channels S0.R to S3.B of EXR files;
    video, PNG frames and summary show S0, and a second figure the polarisation.

    With --denoise, --format npz keeps the film with its noise, too.

    With --frames, DIR gets folders frame_0000, ..., each with what a render writes, steady.npy with
    the steady pictures of all frames, and their video. Frame k starts at k times --frame-time.
    """
    options = locals().copy()

    # -------------------------------------------------------- check everything, start nothing
    opt.check_format(format, precision)
    opt.check_client(workers, scheduler)
    if denoise and (workers or scheduler or format == "zarr"):
        raise ValueError("--denoise: must be left out with --workers, --scheduler, --format zarr")
    animation.check(options)
    if frames is None:
        opt.check_out(out)
    opt.activate(variant, polarised=True)

    from tofrender.rendering.collecting import collect
    from tofrender.rendering.job import dataset_of, remaining
    from tofrender.rendering.renderer import make_job
    from tofrender.rendering.work_items import render_item
    from tofrender.scenes.loading import find_scene

    options |= {"scene": find_scene(scene), "define": dict(define or ())}
    names = {field.name for field in fields(RenderSettings)}
    settings = _with_time({name: options[name] for name in names & options.keys()})
    if frames is not None and frame_time is not None:
        from tofrender.motion.frames import Shutter, open_frames

        shutter, times = Shutter(exposure, poses, row_time), [k * frame_time for k in range(frames)]
        job, shutter = open_frames(settings, times, shutter)
        _report_time(settings, job)
        animation.render_frames(job, times, shutter, options)
        return
    job = make_job(settings)
    _report_time(settings, job)
    height, width, count, channels = job.film.shape
    films = 2 if errors else 1
    cells = height * width * films * count
    opt.check_out(out, (height, width, films * count, channels), precision)
    if checkpoint:  # which has the samples' weight of each bin, too
        opt.check_disk_space(out, cells * channels, cells * (channels + 1))

    complete = _complete(out, job) if resume and checkpoints.unfinished_work(out) is None else None
    if complete is not None:
        files = sorted(path.name for path in out.iterdir())
        lines = [f"{out}: already complete, {complete.attrs['spp']} samples per pixel"]
        answer("render", as_json, render_facts(complete, out, files), lines)
        return

    # ---------------------------------------------------------------------- render and write
    with (
        checkpoints.checkpointed(out, checkpoint, resume) as file,
        opt.client_of(workers, scheduler) as client,
    ):
        film = checkpoints.film_path(out)
        begun = checkpoints.is_begun(film) and not denoise
        if client is None and format != "zarr" and not begun and _fits(job):
            earlier = _earlier(out, file) if resume else None
            result = render_item(job, remaining(job, earlier), checkpoint=file)
            dataset = dataset_of(job, result, earlier)
        elif client is not None and job.plan.splats:
            checkpoints.require_begun(resume, file and file.path, out)
            dataset = dataset_of(job, collect(job, client, file))
        else:
            checkpoints.require_begun(resume, film, out)
            dataset = _on_disk(job, film, client, checkpoint, resume)
        with deferred_stop() as stop:
            files = write(dataset, out, format, precision, video, figure, dpi)
        answer("render", as_json, render_facts(dataset, out, files), _report(dataset, out, files))
        checkpoints.end_if_incomplete(dataset.attrs)
    checkpoints.end_if_stopped(stop)


def _with_time(options: dict[str, Any]) -> RenderSettings:
    """Settings of a render, with an automatic window and pulse where no setting of `TIME` is given.

    They are for built-in scenes, and for files of scenes whose film is steady.
    """
    from ..rendering.renderer import with_default_window

    own: dict[str, Any] = {name: None for name in TIME if options[name] == opt.SCENE_TIME}
    settings = RenderSettings(**options | own)
    found = with_default_window(settings)
    if found is not settings and options["window"] == opt.SCENE_TIME:
        raise ValueError(
            f"--window = {opt.SCENE_TIME}: must be auto or START,STOP, the scene's film is steady"
        )
    if found is not settings and options["pulse_width"] == opt.SCENE_TIME:
        return replace(found, pulse_width=None)
    left_open = all(options[name] is None for name in TIME) and isinstance(settings.scene, str)
    return replace(found, window="auto", pulse_width="auto") if left_open else found


def _report_time(settings: RenderSettings, job: Job) -> None:
    """Print which window and pulse were found, and how to have the scene's own."""
    if settings.pulse_width != "auto" or settings.window != "auto":
        return
    start, stop = job.film.start_opl, job.film.end_opl()
    found = f"bins from {start:.4g} to {stop:.4g} m"
    if isinstance(job.settings.pulse_width, float):
        found += f" and a pulse of {job.settings.pulse_width:g} m"
    own = "--window auto has no pulse"
    if not isinstance(settings.scene, Path):
        own = "--window scene has the scene's own, without a pulse"
    opt.note(f"note: {found} suit this scene; {own}")


def _fits(job: Job) -> bool:
    """Whether a job's film fits into memory; prints a note if not."""
    from tofrender.rendering.work_items import whole

    try:
        job.require_memory(whole(job).count)
    except MemoryError as error:
        if job.settings.denoise:
            raise
        opt.note(f"note: {error}; it is rendered tile by tile on the disk")
        return False
    return True


def _on_disk(
    job: Job, film: Path, client: Client | None, seconds: float, resume: bool
) -> xr.Dataset:
    """Render a job on the disk, or open what a killed run had finished there."""
    from tofrender.rendering.films_on_disk import is_film, load_zarr
    from tofrender.rendering.job import check_resume
    from tofrender.rendering.store import under_way
    from tofrender.rendering.streaming import stream
    from tofrender.rendering.work_items import whole

    if not resume:
        for unfinished in (film, under_way(film)):
            atomic.remove(unfinished)
    if not is_film(film):
        return stream(
            job, film, client=client, seconds=seconds, tell=opt.note, again=checkpoints.AGAIN
        )
    dataset = load_zarr(film)
    check_resume(dataset, job)
    spp, wanted = dataset.attrs["spp"], whole(job).count
    if spp != wanted:
        raise ValueError(f"--resume: was rendered with spp = {spp}; must be {wanted}")
    return dataset


def _complete(out: Path, job: Job) -> xr.Dataset | None:
    """Load the render in `out` if it is the result of `job`, None if there is more to do."""
    from ..rendering.job import check_resume
    from ..rendering.work_items import whole

    try:
        found = opt.load_render(out, "--resume")
    except (ValueError, OSError):  # Raised again by `_earlier`
        return None
    if not found.attrs["complete"] or found.attrs["spp"] != whole(job).count:
        return None
    check_resume(found, job)
    return found


def _earlier(out: Path, file: Checkpoint | None) -> xr.Dataset | None:
    """Load the render in `out` to resume from, None if a checkpoint has all that is needed."""
    first = None if file is None else file.recipe().get("resume")
    if file is not None and first == 0:
        return None
    earlier = opt.load_render(out, "--resume")
    if file is not None and earlier.attrs["spp"] != first:  # DIR has changed since
        file.resume = False
    opt.note(f"resuming from {earlier.attrs['spp']} samples per pixel in {out}")
    return earlier


def _report(dataset: xr.Dataset, out: Path, files: Sequence[str]) -> list[str]:
    """Lines with names of files, time, and the energy outside the window."""
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
