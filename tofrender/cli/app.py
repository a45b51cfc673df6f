"""The `tofrender` command: its groups of commands, and one line for whatever goes wrong.

Only the standard library and Typer are imported here, so that `--help` answers at once; each
command imports what it needs, after its options are checked.
"""

import os
import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from ..runtime import doctor as diagnosis
from ..runtime.checks import printable
from ..runtime.child_processes import safe_children
from ..runtime.progress import Terminated, ended_by_signals, status, without_bars
from . import (
    course,
    dataset,
    grade,
    lidar,
    moving,
    nlos,
    render,
    report,
    sense,
    time,
    twin,
    view,
    warp,
    writing,
)
from .answers import Json, answer
from .messages import set_command, with_option_names
from .options import BAD_INPUT, FAILURE, INTERRUPTED, note, with_progress


class Groups(TyperGroup):
    """The command, whose help lists its commands in `GROUPS`."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section for each group."""
        space = formatter.width - 6 - max(map(len, self.commands))
        for title, names in GROUPS.items():
            with formatter.section(title):
                lines = [(n, self.commands[n].get_short_help_str(space)) for n in names]
                formatter.write_dl(lines)


app = typer.Typer(
    cls=Groups,
    help="Renders light in flight: transient images of Mitsuba scenes.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments`, by default the process's, and return its exit status.

    That is 0 on success, 2 for bad input, 1 for a failure, 130 after Ctrl-C or if work that can go
    on was stopped, else 143 after SIGTERM and 129 after SIGHUP. All but the first leave one line on
    stderr; with TOFRENDER_DEBUG=1 an error is raised instead.

    Example:
        >>> main(["--version"]) == 0
        tofrender ...
        True
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    set_command()
    try:
        with safe_children(), warnings.catch_warnings(), ended_by_signals() as received:
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = _warn
            code = app(args=arguments, prog_name="tofrender", standalone_mode=False) or 0
            if received and code == INTERRUPTED:  # Before the command starts; Typer says nothing
                raise Terminated(received[0])
            return code
    except (Exception, KeyboardInterrupt) as error:
        if os.environ.get("TOFRENDER_DEBUG", "0") not in ("", "0"):
            raise
        return _explain(error)


COURSE = {
    "jupytext",
    "markdown_it",
    "math_core",
    "mdit_py_plugins",
    "nbclient",
    "pytest",
    "tomlkit",
}
"""Packages of the extra `course`. Only the commands for courses import them."""


def _explain(error: BaseException) -> int:
    """Print an error in one line on stderr; returns the exit status."""
    explain = getattr(error, "format_message", None)  # Typer's errors about the command line
    if explain is not None:
        return _complain(explain(), BAD_INPUT)
    while error.__cause__ is not None:  # Dr.Jit wraps what is raised inside a loop
        error = error.__cause__
    package = str(getattr(error, "name", None)).partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and package in COURSE:
        return _complain(f"{package} is missing; run: pip install 'tofrender[course]'", FAILURE)
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        message = str(error) if str(error).startswith("interrupted") else "interrupted"
        return _complain(message, getattr(error, "status", INTERRUPTED))
    bad = (ValueError, MemoryError, FileNotFoundError, FileExistsError, PermissionError)
    status = BAD_INPUT if isinstance(error, bad) else FAILURE
    return _complain(with_option_names(str(error)) or type(error).__name__, status)


def _warn(message: Warning | str, *_: Any) -> None:
    note(f"warning: {' '.join(with_option_names(str(message)).split())}")


def _complain(message: str, status: int) -> int:
    print(f"error: {printable(' '.join(message.split()))}", file=sys.stderr)
    return status


class Command(TyperCommand):
    """Command with a status line, whose errors name its options.

    Its Ctrl-C reaches `_explain` in another error: Typer would end it without a word.
    """

    def invoke(self, ctx: Any) -> Any:
        """Call the command."""
        set_command(ctx)
        is_hidden = not ctx.params["progress"]
        has_status = self.name in {each.__name__ for each in SHOWN}
        try:
            with without_bars(is_hidden), status(f"tofrender {self.name}", has_status):
                return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            raise RuntimeError from interrupt


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
def scenes(as_json: Json = False) -> None:
    """List the built-in scenes."""
    from tofrender.scenes import BUILT_IN, describe

    width = max(map(len, BUILT_IN))
    found = [{"name": name, "description": describe(name)} for name in BUILT_IN]
    lines = (f"{each['name']:{width}}  {each['description']}" for each in found)
    answer("scenes", as_json, {"scenes": found}, lines)


@app.command()
def doctor(as_json: Json = False) -> None:
    """Check whether rendering works here, and explain how to fix it if not."""
    if not as_json:
        raise typer.Exit(diagnosis.main())
    checks = diagnosis.diagnose()
    works = diagnosis.works(checks)
    answer("doctor", True, {"works": works, "checks": [asdict(each) for each in checks]}, ())
    raise typer.Exit(0 if works else FAILURE)


SHOWN = (
    *(time.phasor, time.gate, nlos.capture, nlos.reconstruct, warp.warp, report.report),
    *(moving.doppler, moving.fmcw),
    *(render.render, lidar.lidar, writing.merge, sense.sense, dataset.dataset, twin.twin),
)
"""Commands with a status line; the others print each thing that they have done."""

_TEACHERS = ("release", "verify", "grade", "gradescope", "prairielearn", "classroom50")

GROUPS = {
    "Render": ("render", "gate", "phasor", "doppler", "fmcw", "lidar", "dataset", "merge"),
    "Around the corner": ("capture", "reconstruct"),
    "Measure and look": ("sense", "twin", "report", "view", "compare"),
    "Learn sampling": ("warp", "warptest"),
    "Students": ("start", "submit"),
    "Teachers": (*_TEACHERS, "similarity", "new-term"),
    "This installation": ("scenes", "doctor"),
}
"""Names of the commands by the headings under which --help lists them."""

for command in (
    *SHOWN,
    *(course.start, course.submit, course.release, course.verify, grade.grade),
    *(grade.gradescope, grade.prairielearn, grade.classroom50, grade.similarity, grade.new_term),
    *(warp.warptest, view.view, view.compare),
):
    app.command(cls=Command)(with_progress(command))
