"""The command `tofrender render`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..runtime import checks
from ..runtime.progress import EVERY_S
from . import options as opt
from .answers import Json, answer, of_render
from .first_sight import NONE, OWN, at_first_sight, tell_first_sight
from .keeping import (
    AGAIN,
    Resume,
    Seconds,
    is_begun,
    keeping,
    left_work,
    on_disk,
    require_something,
    tell,
)
from .streaming import fits, streamed
from .writing import write

if TYPE_CHECKING:
    import xarray as xr

    from ..rendering.job import Job
    from ..runtime.checkpoints import Checkpoint

Integrator = Literal[
    "transient_path",
    "transient_volpath",
    "path_tracer_mats",
    "path_tracer_nee",
    "path_tracer_mis",
    "transient_light_tracer",
    "transient_bdpt",
    "ao",
]
Sampler = Literal[
    "padded_sobol", "independent", "stratified", "multijitter", "orthogonal", "ldsampler"
]
Format = Literal["frames", "png", "multipart", "npz", "zarr"]
Precision = Literal["half", "float"]


def render(
    scene: opt.Scene,
    out: opt.Out,
    spp: opt.Spp = None,
    size: opt.Pixels = None,
    bins: Annotated[int | None, opt.integer(1, checks.MAX_BINS, "Time bins.")] = None,
    start_opl: Annotated[
        float | None, opt.checked(checks.metres, "Where bins start, metres of path.")
    ] = None,
    bin_width: Annotated[
        float | None, opt.positive("metres", "Width of a bin, metres of path.")
    ] = None,
    window: Annotated[
        Any,
        opt.checked(
            opt.span,
            "Where all bins start and stop, metres of path; auto finds what holds the light.",
            metavar="auto|scene|START,STOP",
            autocompletion=opt.completion.among(["auto", OWN]),
        ),
    ] = None,
    pulse_width: Annotated[
        Any,
        opt.checked(
            opt.pulse,
            "Gaussian pulse's standard deviation, metres; auto takes a 128th of the window.",
            metavar="auto|none|METRES",
            autocompletion=opt.completion.among(["auto", NONE]),
        ),
    ] = None,
    max_depth: opt.MaxDepth = None,
    integrator: Annotated[
        Integrator | None, opt.choice(Integrator, "What follows the paths.")
    ] = None,
    sampler: Annotated[
        Sampler | None, opt.choice(Sampler, "Mitsuba's sampler, or padded_sobol.")
    ] = None,
    sensor: Annotated[int, opt.integer(0, opt.MAX_SENSOR, "Number of the sensor.")] = 0,
    variant: opt.Variant = None,
    seed: opt.Seed = 0,
    format: Annotated[Format, opt.choice(Format, "How to store the transient.")] = "frames",
    precision: Annotated[Precision, opt.choice(Precision, "Numbers in the EXR files.")] = "float",
    define: Annotated[
        list[Any] | None,
        opt.checked(
            opt.definition, "XML parameter; repeatable.", "-D", "--define", metavar="NAME=VALUE"
        ),
    ] = None,
    video: Annotated[bool, typer.Option(help="Write video.mp4 as well.")] = True,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = None,
    errors: Annotated[
        bool, typer.Option("--errors", help="Measure the noise of each bin.")
    ] = False,
    workers: opt.Workers = None,
    scheduler: opt.Scheduler = None,
    checkpoint: Seconds = EVERY_S,
    resume: Resume = False,
    progress: opt.Progress = True,
    as_json: Json = False,
) -> None:
    """Render SCENE in time.

    What is left out stays as the scene has it, but for time: a built-in scene, or one whose film is
    steady, gets a window that holds its light and a pulse that suits it, unless one of --start-opl,
    --bin-width, --window and --pulse-width is given. DIR gets the transient image, its sum over
    time (steady.exr), a video and a summary figure; it appears whole or not at all, and one that an
    earlier run made is replaced. What is done is kept beside DIR while it renders; Ctrl-C, SIGTERM
    and SIGHUP write it as far as it is. With --resume, a run goes on from a stopped one, or from a
    render in DIR that has fewer samples; one that has all of them stays. Without it, what a stopped
    run has done is never replaced.

    A film that does not fit into memory is rendered tile by tile on the disk, as are those with
    --format zarr and by workers.

    In a polarised --variant, files have Stokes vectors, in channels S0.R to S3.B of EXR files;
    video, PNG frames and summary are of S0, and a second figure is of the polarisation.
    """
    from tofrender.runtime import backend

    # -------------------------------------------------------- check everything, start nothing
    opt.check_format(format, precision)
    opt.check_client(workers, scheduler)
    opt.check_out(out)
    backend.activate(variant)  # chooses the LLVM, which must come before anything imports Mitsuba
    backend.require_vectorised()

    from tofrender.rendering.job import carry_out, collect
    from tofrender.rendering.renderer import make_job
    from tofrender.runtime.progress import deferred_stop
    from tofrender.scenes.loading import find_scene

    words = {
        "scene": find_scene(scene),
        "spp": spp,
        "seed": seed,
        "size": size,
        "bins": bins,
        "start_opl": start_opl,
        "bin_width": bin_width,
        "window": window,
        "pulse_width": pulse_width,
        "max_depth": max_depth,
        "integrator": integrator,
        "sampler": sampler,
        "sensor": sensor,
        "define": dict(define or ()),
        "errors": errors,
    }
    asked = at_first_sight(**words)
    job = make_job(asked)
    tell_first_sight(asked, job)
    height, width, count, channels = job.film.shape
    films = 2 if errors else 1
    cells = height * width * films * count
    opt.check_out(out, (height, width, films * count, channels), precision)
    if checkpoint:  # which has the samples' weight of each bin, too
        opt.check_room(out, cells * channels, cells * (channels + 1))

    done = _complete(out, job) if resume and left_work(out) is None else None
    if done is not None:
        files = sorted(path.name for path in out.iterdir())
        lines = [f"{out}: already complete, {done.attrs['spp']} samples per pixel"]
        answer("render", as_json, of_render(done, out, files), lines)
        return

    # ---------------------------------------------------------------------- render and write
    with keeping(out, checkpoint, resume) as kept, opt.client_of(workers, scheduler) as client:
        film = on_disk(out)
        if client is None and format != "zarr" and not is_begun(film) and fits(job):
            earlier = _earlier(out, kept) if resume else None
            dataset = carry_out(job, earlier, kept)
        elif client is not None and job.plan.splats:
            require_something(resume, kept and kept.path, out)
            dataset = collect(job, client, kept)
        else:
            require_something(resume, film, out)
            dataset = streamed(job, film, client, checkpoint, resume)
        with deferred_stop() as stop:
            files = write(dataset, out, format, precision, video, figure, dpi)
        answer("render", as_json, of_render(dataset, out, files), _report(dataset, out, files))
        if not dataset.attrs["complete"]:
            done = f"{dataset.attrs['spp']} samples per pixel; {AGAIN}"
            opt.note(f"error: interrupted after {done}")
            raise typer.Exit(opt.INTERRUPTED)
    tell(stop)


def _complete(out: Path, job: Job) -> xr.Dataset | None:
    """The render in `out` if it is what `job` would come to, None if there is more to do."""
    from ..rendering.job import check_resume
    from ..rendering.pieces import whole

    try:
        found = opt.load_render(out, "--resume")
    except (ValueError, OSError):  # Is told by who goes on with it
        return None
    if not found.attrs["complete"] or found.attrs["spp"] != whole(job).count:
        return None
    check_resume(found, job)
    return found


def _earlier(out: Path, kept: Checkpoint | None) -> xr.Dataset | None:
    """The render in `out` to go on from, None if a checkpoint has all that is needed."""
    first = None if kept is None else kept.recipe().get("resume")
    if kept is not None and first == 0:
        return None
    earlier = opt.load_render(out, "--resume")
    if kept is not None and earlier.attrs["spp"] != first:  # DIR has changed since
        kept.resume = False
    opt.note(f"resuming from {earlier.attrs['spp']} samples per pixel in {out}")
    return earlier


def _report(dataset: xr.Dataset, out: Path, files: Sequence[str]) -> list[str]:
    """What was written, how long it took, and what the window missed."""
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
