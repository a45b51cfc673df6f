"""The `tofrender` command: groups of commands, the layout of their help, and error messages.

This module imports the standard library and Typer only, so that `--help` answers at once. Each
command imports what it needs after its options are checked.
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

LONGEST_SUMMARY = 48
"""Characters of a command's summary. It fits beside the command's name in 80 columns."""


class Groups(TyperGroup):
    """The `tofrender` command. Its help lists the commands by the groups of `GROUPS`."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section for each group."""
        for title, names in GROUPS.items():
            with formatter.section(title):
                summaries = [
                    self.commands[name].get_short_help_str(LONGEST_SUMMARY) for name in names
                ]
                formatter.write_dl(list(zip(names, summaries, strict=True)))


app = typer.Typer(
    cls=Groups,
    help="Render light in flight: transient images of Mitsuba scenes.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status.

    Every status except 0 comes with one line on stderr. If the environment variable
    TOFRENDER_DEBUG is 1, an error is raised instead.

    Args:
        arguments: Arguments of the command; by default `sys.argv[1:]`.

    Returns:
        0 on success, 1 for a failure, 2 for bad input, 130 after Ctrl-C or if work that can be
        resumed was stopped, 143 after SIGTERM, and 129 after SIGHUP.

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
            # A signal that arrives before the command starts. Typer does not report it.
            if received and code == INTERRUPTED:
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
    """Print an error in one line on stderr, and return the exit status."""
    # Errors of Typer about the command line
    explain = getattr(error, "format_message", None)
    if explain is not None:
        return _complain(explain(), BAD_INPUT)

    # Dr.Jit wraps errors that are raised inside a loop
    while error.__cause__ is not None:
        error = error.__cause__
    package = str(getattr(error, "name", None)).partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and package in COURSE:
        remedy = "pip install 'tofrender[course]'"
        return _complain(f"{package} is not installed. Run: {remedy}", FAILURE)
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        message = str(error) if str(error).startswith("interrupted") else "interrupted"
        return _complain(message, getattr(error, "status", INTERRUPTED))
    bad_input = (ValueError, MemoryError, FileNotFoundError, FileExistsError, PermissionError)
    status = BAD_INPUT if isinstance(error, bad_input) else FAILURE
    return _complain(with_option_names(str(error)) or type(error).__name__, status)


def _warn(message: Warning | str, *_: Any) -> None:
    note(f"warning: {' '.join(with_option_names(str(message)).split())}")


def _complain(message: str, status: int) -> int:
    print(f"error: {printable(' '.join(message.split()))}", file=sys.stderr)
    return status


EXAMPLES = "\n\nExamples:\n"
"""Heading in the docstring of a command. The lines below are printed as they are."""


class Described(TyperCommand):
    """A command with examples at the end of its help. They are written in its docstring."""

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write the description without the examples."""
        text, _, _ = (self.help or "").partition(EXAMPLES)
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(text)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the options, without Typer's names of types."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is None:
                continue
            name, text = record
            if parameter.param_type_name == "argument":
                sections["Arguments"].append((parameter.metavar or name, text))
            else:
                sections["Options"].append((name, text))
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples."""
        _, _, examples = (self.help or "").partition(EXAMPLES)
        with formatter.section("Examples"):
            for line in examples.splitlines():
                formatter.write(f"  {line.strip()}\n")


class Command(Described):
    """A command with a status line and with error messages that name its options.

    After Ctrl-C, `invoke` raises another error, because Typer would end without a message.
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


@app.command(cls=Described)
def scenes(as_json: Json = False) -> None:
    """List the built-in scenes.

    Examples:
        tofrender scenes
        tofrender scenes --json
    """
    from tofrender.scenes import BUILT_IN, describe

    width = max(map(len, BUILT_IN))
    found = [{"name": name, "description": describe(name)} for name in BUILT_IN]
    lines = (f"{each['name']:{width}}  {each['description']}" for each in found)
    answer("scenes", as_json, {"scenes": found}, lines)


@app.command(cls=Described)
def doctor(as_json: Json = False) -> None:
    """Check the installation and print remedies.

    The exit status is 0 if rendering works.

    Examples:
        tofrender doctor
        tofrender doctor --json
    """
    if not as_json:
        raise typer.Exit(diagnosis.main())
    checks = diagnosis.diagnose()
    works = diagnosis.works(checks)
    answer("doctor", True, {"works": works, "checks": [asdict(each) for each in checks]}, ())
    raise typer.Exit(0 if works else FAILURE)


SHOWN = (
    render.render,
    time.gate,
    time.phasor,
    moving.doppler,
    moving.fmcw,
    lidar.lidar,
    dataset.dataset,
    writing.merge,
    nlos.capture,
    nlos.reconstruct,
    sense.sense,
    twin.twin,
    report.report,
    warp.warp,
)
"""Commands with a status line. The other commands print a line for each result."""

GROUPS = {
    "Render": ("render", "gate", "phasor", "doppler", "fmcw", "lidar", "dataset", "merge"),
    "Around the corner": ("capture", "reconstruct"),
    "Measure and look": ("sense", "twin", "report", "view", "compare"),
    "Learn sampling": ("warp", "warptest"),
    "Students": ("start", "submit"),
    "Teachers": (
        "release",
        "verify",
        "grade",
        "gradescope",
        "prairielearn",
        "classroom50",
        "similarity",
        "new-term",
    ),
    "This installation": ("scenes", "doctor"),
}
"""Headings of `tofrender --help`, and the names of the commands below each."""

for command in (
    *SHOWN,
    view.view,
    view.compare,
    warp.warptest,
    course.start,
    course.submit,
    course.release,
    course.verify,
    grade.grade,
    grade.gradescope,
    grade.prairielearn,
    grade.classroom50,
    grade.similarity,
    grade.new_term,
):
    app.command(cls=Command)(with_progress(command))
