"""The command `tofrender grade`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime import checks
from .course import Name
from .options import integer, real, say

if TYPE_CHECKING:
    from ..course.grade.classes import Class
    from ..course.grade.grading import Grader

MAX_JOBS = 256
MAX_SEED = (1 << 31) - 1
SEED = (
    "Seed of the tests that students do not have; else the rubric's, or a drawn one. The results "
    "name it."
)


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
    jobs: Annotated[int, integer(1, MAX_JOBS, "With --all, submissions at a time.")] = 1,
    roster: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With --all, CSV of the class: id, and name, email, section, submission.",
        ),
    ] = None,
    sheet: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With --all, CSV of what people say: id, and late_days, note, ids of problems "
            "(points instead of the tests') and of what is graded by hand.",
        ),
    ] = None,
    feedback: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="With --all, folder of a page a student, and one of the class."
        ),
    ] = None,
    time_limit: Annotated[float, real(30, "Seconds for one submission.")] = 540,
    memory: Annotated[float, real(1, "GiB of memory for one submission.")] = 4,
    seed: Annotated[int | None, integer(1, MAX_SEED, SEED)] = None,
) -> None:
    """Grade a submission, or a class, with all tests.

    The results are in Gradescope's format. A class can be stopped and gone on with: what is graded
    is kept, unless the submission or the tests have changed. So a sheet can be merged in later.
    """
    if (submission is None) == (everyone is None):
        raise ValueError("--submission and --all: must be exactly one of them")
    if submission is not None:
        alone = {"--csv": csv, "--roster": roster, "--sheet": sheet, "--feedback": feedback}
        out = _check_one(submission, out, alone, jobs)
    else:
        assert everyone is not None
        out, csv = _check_class(everyone, out, csv, feedback, jobs)

    from ..course.assignments import find
    from ..course.grade import classes, grading, roster as rosters
    from ..course.judge import sandbox

    found = find(assignment)
    found.require_tests()
    members, nobodys, marks = [], [], None
    if everyone is not None:
        assert csv is not None
        those = classes.submissions_in(everyone, out, *([feedback] if feedback else []))
        members, nobodys = rosters.members(those, roster)
        marks = None if sheet is None else rosters.marks(sheet, found.rubric, members)
    for what in sandbox.missing_protections():
        say(f"warning: this machine cannot keep a submission from {what}", err=True)
    for name in nobodys:
        say(f"warning: --roster = {roster}: {name!a} is nobody's", err=True)
    try:
        if seed is None and submission is None and not found.rubric.seed:
            seed = classes.seed_of_before(out)  # those that are graded stay as they are
        limits = {"time_limit_s": time_limit, "memory_gib": memory}
        with grading.open_grader(found, seed or 0, **limits) as grader:
            if submission is not None:
                _grade_one(grader, submission, out)
                return
            assert everyone is not None
            assert csv is not None
            private = [path for path in (roster, sheet, feedback) if path is not None]
            class_ = classes.Class(
                grader, everyone, members, csv, out, marks, roster is not None, jobs, private
            )
            class_.grade(say)
            say(f"{csv}: written")
            if feedback is not None:
                _write_pages(class_, feedback)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; what is graded is kept") from None


def _grade_one(grader: Grader, submission: Path, out: Path) -> None:
    results = grader.grade(submission, out)
    rubric = grader.assignment.rubric
    for problem in rubric.problems:
        points = f"{results.problem_points(problem):g} of {problem.points:g}"
        say(f"{problem.id}: {points}{' (bonus)' if problem.bonus else ''}")
    for remark in results.remarks:
        say(remark)
    total = f"{results.score:g} of {rubric.points:g} points"
    say(f"{out}: {total}, {results.seconds:.0f} s")


def _write_pages(class_: Class, folder: Path) -> None:
    """Write `FOLDER/students/ID/feedback.html` for each, and `FOLDER/overview.html`."""
    from ..course.grade import feedback, overview

    feedback.write(class_, folder / "students")
    overview.write(class_, folder)
    say(f"{folder}: overview.html, and students/*/feedback.html")


def _check_one(submission: Path, out: Path | None, alone: Mapping[str, object], jobs: int) -> Path:
    """Refuse options that do not go together; the results file."""
    submission = checks.path("--submission", submission)
    if not submission.is_dir() and not submission.is_file():
        raise ValueError(f"--submission = {submission}: must be a folder or a zip that exists")
    for name, value in {**alone, "--jobs": jobs if jobs > 1 else None}.items():
        if value is not None:
            raise ValueError(f"{name} = {value}: must be left out without --all")
    if out is None:
        raise ValueError("--out: must be the file to write, for example results.json")
    if out.is_dir():
        raise ValueError(f"--out = {out}: is a folder; must be a file")
    return out


def _check_class(
    everyone: Path, out: Path | None, csv: Path | None, feedback: Path | None, jobs: int
) -> tuple[Path, Path]:
    """Refuse options that do not go together; the folder of the results and the CSV file."""
    if not everyone.is_dir():
        raise ValueError(f"--all = {everyone}: is no folder; must be one of submissions")
    if csv is None:
        raise ValueError("--csv: must be the file to write, for example grades.csv")
    if csv.is_dir():
        raise ValueError(f"--csv = {csv}: is a folder; must be a file")
    if out is None:
        out = csv.absolute().with_name(f"{csv.stem}_results")
    for name, path in (("--out", out), ("--feedback", feedback)):
        if path is not None and path.exists() and not path.is_dir():
            raise ValueError(f"{name} = {path}: is a file; must be a folder")
    cores = os.cpu_count() or 1
    if jobs > max(cores, 1):
        raise ValueError(
            f"--jobs = {jobs}: must be {cores} or less, the number of cores; tests have time limits"
        )
    return out, csv
