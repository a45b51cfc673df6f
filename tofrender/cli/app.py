"""The `tofrender` command.

Only the standard library and Typer are imported here, so that `--help` answers at once; each
command imports what it needs, after its options are checked.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import (
    course as cli_course,
)
from . import (
    grade as cli_grade,
)
from . import (
    nlos as cli_nlos,
)
from . import (
    time as cli_time,
)
from . import (
    warp as cli_warp,
)
from .options import FILES, check_out, definitions, load_render, number, split_size

if TYPE_CHECKING:
    import xarray as xr

BAD_INPUT, FAILURE, INTERRUPTED = 2, 1, 130
PRECISIONS = ("half", "float")
WINDOWS = ("auto",)

app = typer.Typer(
    help="Renders light in flight: transient images of Mitsuba scenes.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status.

    Args:
        arguments: What follows the command's name; by default those of the process.

    Returns:
        0 on success, 2 for bad input, 1 for a failure and 130 after Ctrl-C. All but the first
        leave one line on stderr; with TOFRENDER_DEBUG=1 an error is raised instead.

    Example:
        >>> main(["--version"]) == 0
        tofrender ...
        True
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = _warn
            return app(args=arguments, prog_name="tofrender", standalone_mode=False) or 0
    except (Exception, KeyboardInterrupt) as error:
        if os.environ.get("TOFRENDER_DEBUG", "0") not in ("", "0"):
            raise
        return _explain(error)


def _explain(error: BaseException) -> int:
    """Put an error into one line on stderr; returns the exit status."""
    while error.__cause__ is not None:  # Dr.Jit wraps what is raised inside a loop
        error = error.__cause__
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        return _complain("interrupted", INTERRUPTED)
    explain = getattr(error, "format_message", None)  # Typer's errors about the command line
    if explain is not None:
        return _complain(explain(), BAD_INPUT)
    bad = (ValueError, MemoryError, FileNotFoundError, FileExistsError, PermissionError)
    status = BAD_INPUT if isinstance(error, bad) else FAILURE
    return _complain(str(error) or type(error).__name__, status)


def _warn(message: Warning | str, *_: Any) -> None:
    print(f"warning: {' '.join(str(message).split())}", file=sys.stderr)


def _complain(message: str, status: int) -> int:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return status


# ---------------------------------------------------------------------------------- commands


def _show_version(wanted: bool) -> None:
    if wanted:
        from tofrender import __version__

        typer.echo(f"tofrender {__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    pass


@app.command()
def scenes() -> None:
    """List the built-in scenes."""
    from tofrender.scenes import BUILT_IN, describe

    width = max(map(len, BUILT_IN))
    for name in BUILT_IN:
        typer.echo(f"{name:{width}}  {describe(name)}")


@app.command()
def doctor() -> None:
    """Check whether rendering works here, and say what to do if not."""
    from tofrender.runtime.doctor import main as diagnose

    raise typer.Exit(diagnose())


Text = str | None
_option = typer.Option

app.command()(cli_time.phasor)
app.command()(cli_time.gate)
app.command()(cli_nlos.capture)
app.command()(cli_nlos.reconstruct)
app.command()(cli_warp.warp)
for command in (cli_course.start, cli_course.submit, cli_course.release, cli_course.verify):
    app.command()(command)
app.command()(cli_grade.grade)


@app.command()
def render(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE", help="Built-in name (see `tofrender scenes`) or Mitsuba XML file."
        ),
    ],
    out: Annotated[Path, _option("--out", metavar="DIR", help="Folder to write, made whole.")],
    spp: Annotated[Text, _option("--spp", metavar="N", help="Samples per pixel.")] = None,
    size: Annotated[Text, _option("--size", metavar="WxH", help="Picture's size, pixels.")] = None,
    bins: Annotated[Text, _option("--bins", metavar="N", help="Number of time bins.")] = None,
    start_opl: Annotated[
        Text, _option("--start-opl", metavar="M", help="Path length where bins start, metres.")
    ] = None,
    bin_width: Annotated[
        Text, _option("--bin-width", metavar="M", help="Width of a bin, metres of path length.")
    ] = None,
    window: Annotated[
        Text, _option("--window", metavar="auto", help="Find the window that holds the light.")
    ] = None,
    pulse_width: Annotated[
        Text,
        _option("--pulse-width", metavar="M", help="Gaussian pulse's standard deviation, metres."),
    ] = None,
    max_depth: Annotated[
        Text, _option("--max-depth", metavar="N", help="Longest path, in segments.")
    ] = None,
    integrator: Annotated[
        Text, _option("--integrator", metavar="NAME", help="For example transient_path.")
    ] = None,
    sampler: Annotated[
        Text,
        _option(
            "--sampler",
            metavar="NAME",
            help="Mitsuba's sampler, or padded_sobol.",
        ),
    ] = None,
    variant: Annotated[
        Text, _option("--variant", metavar="NAME", help="Mitsuba variant, e.g. llvm_ad_rgb.")
    ] = None,
    seed: Annotated[str, _option("--seed", metavar="N", help="Random seed.")] = "0",
    format: Annotated[
        str, _option("--format", metavar="frames|multipart|npz", help="How to store the transient.")
    ] = "frames",
    precision: Annotated[
        str, _option("--precision", metavar="half|float", help="Numbers in the EXR files.")
    ] = "float",
    defines: Annotated[
        list[str] | None,
        _option("-D", metavar="NAME=VALUE", help="A parameter of the XML file; repeatable."),
    ] = None,
    video: Annotated[bool, _option("--video/--no-video", help="Write video.mp4 as well.")] = True,
    resume: Annotated[
        bool, _option("--resume", help="Go on with what DIR holds of this render, up to --spp.")
    ] = False,
) -> None:
    """Render SCENE in time.

    What is left out stays as the scene has it. DIR gets the transient image, its sum over time
    (steady.exr), a video and a summary figure; it appears whole or not at all, and one that an
    earlier run made is replaced. Ctrl-C saves the passes that are finished.
    """
    from tofrender.runtime import backend, checks
    from tofrender.scenes.settings import CHECKS

    # -------------------------------------------------------- check everything, start nothing
    width, height = (None, None) if size is None else split_size(size)
    texts = {
        "width": ("--size", width),
        "height": ("--size", height),
        "temporal_bins": ("--bins", bins),
        "start_opl": ("--start-opl", start_opl),
        "bin_width_opl": ("--bin-width", bin_width),
        "spp": ("--spp", spp),
        "sampler": ("--sampler", sampler),
        "max_depth": ("--max-depth", max_depth),
        "integrator": ("--integrator", integrator),
        "pulse_width_opl": ("--pulse-width", pulse_width),
    }
    settings = {
        name: CHECKS[name](option, number(text))
        for name, (option, text) in texts.items()
        if text is not None
    }
    points = {name: settings.pop(name, None) for name in ("spp", "sampler")}
    seed_number = checks.integer("--seed", number(seed), 0, checks.MAX_SEED)
    checks.one_of("--format", format, FILES)
    checks.one_of("--precision", precision, PRECISIONS)
    if window is not None:
        checks.one_of("--window", window, WINDOWS)
        for option, text in (("--start-opl", start_opl), ("--bin-width", bin_width)):
            if text is not None:
                raise ValueError(f"{option} = {text}: must be left out, --window auto finds it")
        if bins is not None:  # lets a steady scene turn transient; the window found replaces it
            settings |= {"start_opl": 0.0, "bin_width_opl": 1.0}
    parameters = definitions(defines or [])
    check_out(out)
    if format == "npz" and precision != "float":
        raise ValueError(f"--precision = {precision}: must be float with --format npz")
    backend.activate(variant)  # chooses the LLVM, which must come before anything imports Mitsuba

    backend.require_vectorised()

    from tofrender.rendering.renderer import render as render_scene
    from tofrender.runtime import memory
    from tofrender.scenes.loading import find_scene, load_scene, require_sensor

    found = find_scene(scene)
    loaded = load_scene(found, parameters=parameters, **settings)
    require_sensor(loaded)
    film = loaded.sensors()[0].film()
    if hasattr(film, "shape"):
        memory.require_film(*film.shape)
    check_out(out, film, "float" if format == "npz" else precision)

    # ---------------------------------------------------------------------- render and write
    earlier = load_render(out, "--resume") if resume else None
    dataset = render_scene(loaded, seed=seed_number, window=window, resume=earlier, **points)
    dataset.attrs["scene"] = str(found)
    files = _write(dataset, out, format, precision, video)
    _report(dataset, out, files)
    if not dataset.attrs["complete"]:
        spp_done = dataset.attrs["spp"]
        raise typer.Exit(_complain(f"interrupted after {spp_done} samples a pixel", INTERRUPTED))


# ------------------------------------------------------------------------------------ output


def _write(dataset: xr.Dataset, out: Path, format: str, precision: str, video: bool) -> list[str]:
    """Write all files into `out`, which appears whole; returns their names."""
    from tofrender import io, vis

    with io.output_folder(out, overwrite=True) as folder:
        if format == "npz":
            io.save_npz(dataset, folder / FILES[format])
        else:
            io.save_exr_stack(
                dataset, folder / FILES[format], layout=format, precision=precision, overwrite=True
            )
        if video:
            io.save_video(dataset, folder / "video.mp4")
        vis.summary_figure(dataset).savefig(folder / "summary.png")
        return sorted(path.name for path in folder.iterdir())


def _report(dataset: xr.Dataset, out: Path, files: Sequence[str]) -> None:
    """Say what was written, how long it took, and what the window missed."""
    frames = [name for name in files if name.startswith("frame_")]
    names = [name for name in files if name not in frames]
    if frames:
        names.insert(0, f"{frames[0]} ... {frames[-1]}")
    attrs = dataset.attrs
    seconds = attrs["render_seconds"]
    samples = dataset.sizes["y"] * dataset.sizes["x"] * attrs["spp"]
    typer.echo(f"{out}: {', '.join(names)}")
    typer.echo(
        f"{seconds:.1f} s, {samples / seconds:,.0f} samples per second, "
        f"{100 * attrs['energy_outside_window']:.1f} % of the energy outside the window"
    )
