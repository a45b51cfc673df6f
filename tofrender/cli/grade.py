"""The command `tofrender grade`."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Annotated

import typer

from ..runtime import checks
from .course import Name
from .options import INTERRUPTED, real


def grade(
    assignment: Name,
    submission: Annotated[
        Path | None, typer.Option(metavar="DIR|ZIP", help="What one student has handed in.")
    ] = None,
    everyone: Annotated[
        Path | None, typer.Option("--all", metavar="DIR", help="Folder of a class's submissions.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE|DIR",
            help="Results file; with --all the folder of the results files, else beside --csv.",
        ),
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(metavar="FILE", help="With --all, a line a student.")
    ] = None,
    time_limit: Annotated[float, real(30, "Seconds for one submission.")] = 540,
    memory: Annotated[float, real(1, "GiB of memory for one submission.")] = 4,
) -> None:
    """Grade a submission, or a class, with all tests.

    The results are in Gradescope's format. A class can be stopped and gone on with: what is graded
    is kept, unless the submission or the tests have changed.
    """
    if (submission is None) == (everyone is None):
        raise ValueError("--submission and --all: must be exactly one of them")
    if submission is not None:
        out = _check_one(submission, out, csv)
    else:
        assert everyone is not None
        out, csv = _check_class(everyone, out, csv)

    from ..course.assignments import find
    from ..course.grade import grading
    from ..course.judge import sandbox

    found = find(assignment)
    found.require_staff("grading")
    for what in sandbox.missing_protections():
        typer.echo(f"warning: this machine cannot keep a submission from {what}", err=True)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: ends what runs
    try:
        with grading.opened(found, time_limit_s=time_limit, memory_gib=memory) as grader:
            if submission is None:
                assert everyone is not None
                assert csv is not None
                grading.grade_all(grader, everyone, csv, out, typer.echo)
                typer.echo(f"{csv}: written")
                return
            results = grader.grade(submission, out)
    except KeyboardInterrupt:
        typer.echo("error: interrupted; what is graded is kept", err=True)
        raise typer.Exit(INTERRUPTED) from None
    finally:
        signal.signal(signal.SIGTERM, before)
    for problem in found.rubric.problems:
        points = f"{results.problem_points(problem):g} of {problem.points:g}"
        typer.echo(f"{problem.id}: {points}{' (bonus)' if problem.bonus else ''}")
    for remark in results.remarks:
        typer.echo(remark)
    total = f"{results.score:g} of {found.rubric.points:g} points"
    typer.echo(f"{out}: {total}, {results.seconds:.0f} s")


def _check_one(submission: Path, out: Path | None, csv: Path | None) -> Path:
    """Refuse options that do not go together; the results file."""
    submission = checks.path("--submission", submission)
    if not submission.is_dir() and not submission.is_file():
        raise ValueError(f"--submission = {submission}: must be a folder or a zip that exists")
    if csv is not None:
        raise ValueError(f"--csv = {csv}: must be left out without --all")
    if out is None:
        raise ValueError("--out: must be the file to write, for example results.json")
    if out.is_dir():
        raise ValueError(f"--out = {out}: is a folder; must be a file")
    return out


def _check_class(everyone: Path, out: Path | None, csv: Path | None) -> tuple[Path, Path]:
    """Refuse options that do not go together; the folder of the results and the CSV file."""
    if not everyone.is_dir():
        raise ValueError(f"--all = {everyone}: is no folder; must be one of submissions")
    if csv is None:
        raise ValueError("--csv: must be the file to write, for example grades.csv")
    if csv.is_dir():
        raise ValueError(f"--csv = {csv}: is a folder; must be a file")
    if out is None:
        out = csv.absolute().with_name(f"{csv.stem}_results")
    if out.exists() and not out.is_dir():
        raise ValueError(f"--out = {out}: is a file; must be a folder")
    return out, csv
