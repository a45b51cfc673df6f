"""The commands `tofrender grade`, `gradescope`, `similarity` and `new-term`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..course.assignments import find
from ..course.rubric import MAX_SEED
from ..runtime import checks
from .course import Name
from .options import choice, integer, named, note, real, say

if TYPE_CHECKING:
    from ..course.grade.classes import Class
    from ..course.grade.grading import Grader

MAX_JOBS = 256

RESULTS = "Results file; with --all the folder of the results files, else beside --csv."
ROSTER = "With --all, CSV of the class: id, and name, email, section, submission."
SHEET = (
    "With --all, CSV of manual entries: id, and late_days, note, ids of problems (points instead "
    "of the tests') and of what is graded by hand."
)
COLUMNS = (
    'With --all, a column of --csv, as "SIS Login ID=email"; repeatable. FIELD is id, name, email, '
    "section, submission, total, a problem's id, late_days, lost_late, note or reason."
)
FORMATS = ("gradescope", "prairielearn", "classroom50", "junit")

TimeLimit = Annotated[float, real(30, "Seconds for one submission.")]
Memory = Annotated[float, real(1, "GiB of memory for one submission.")]


def grade(
    assignment: Name,
    submission: Annotated[
        Path | None, named("PATH", "Folder, zip, tar or file of one student.")
    ] = None,
    everyone: Annotated[
        Path | None, named("DIR", "Folder of a class's submissions.", "--all")
    ] = None,
    out: Annotated[Path | None, named("FILE|DIR", RESULTS, "--out", "-o")] = None,
    csv: Annotated[Path | None, named("FILE", "With --all, one row per student.")] = None,
    columns: Annotated[list[str] | None, named("NAME=FIELD", COLUMNS)] = None,
    jobs: Annotated[int, integer(1, MAX_JOBS, "With --all, submissions at a time.")] = 1,
    roster: Annotated[Path | None, named("FILE", ROSTER)] = None,
    sheet: Annotated[Path | None, named("FILE", SHEET)] = None,
    feedback: Annotated[
        Path | None, named("DIR", "With --all, folder of a page a student, and one of the class.")
    ] = None,
    time_limit: TimeLimit = 540,
    memory: Memory = 4,
    format: Annotated[str, choice(FORMATS, "Of --out, without --all.")] = "gradescope",
) -> None:
    """Grade a submission, or a class, with all tests.

    Grading a class can be interrupted and resumed: finished results are kept, unless the submission
    or the tests have changed. A sheet can be added later. If this machine fails, a submission is
    not graded, and the exit status is 1; the same command tries again. The seed of the tests that
    students do not have is drawn, unless seed.txt in the assignment's folder has one; the results
    name it.
    """
    if (submission is None) == (everyone is None):
        raise ValueError("--submission and --all: must be exactly one of them")
    of_class = {"--csv": csv, "--roster": roster, "--sheet": sheet, "--feedback": feedback}
    of_class |= {"--columns": columns[0] if columns else None}
    if submission is not None:
        out = _check_one(submission, out, of_class, jobs)
    else:
        assert everyone is not None
        if format != "gradescope":
            raise ValueError(f"--format = {format}: must be left out with --all")
        out, csv = _check_class(everyone, out, csv, feedback, jobs)

    from ..course.grade import classes, grading, results, roster as rosters
    from ..course.judge import sandbox

    found = find(assignment)
    found.require_tests()
    members, unknown, marks = [], [], None
    if everyone is not None:
        reserved = [path for path in (out, csv, feedback, roster, sheet) if path is not None]
        those = classes.submissions_in(everyone, found, reserved)
        members, unknown = rosters.members(those, roster)
        marks = None if sheet is None else rosters.marks(sheet, found.rubric, members)
    shown = rosters.columns(columns or [], found.rubric)
    for risk in sandbox.missing_protections():
        note(f"warning: this machine cannot keep a submission from {risk}")
    for name in unknown:
        note(f"warning: --roster = {roster}: {name!a} is nobody's")
    try:
        before = results.seed_of_before(out) if submission is None else 0
        more = {"time_limit_s": time_limit, "memory_gib": memory, "format": format}
        with grading.open_grader(found, before, **more) as grader:
            if submission is not None:
                _grade_one(grader, submission, out)
            elif everyone is not None and csv is not None:
                private = [path for path in (roster, sheet, feedback) if path is not None]
                class_ = classes.Class(
                    grader, everyone, members, csv, out, marks, roster is not None, jobs, private
                )
                class_.columns = shown
                class_.grade(say)
                say(f"{csv}: written")
                if feedback is not None:
                    _write_pages(class_, feedback)
                _require_graded(class_)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; what is graded is kept") from None


def _grade_one(grader: Grader, submission: Path, out: Path) -> None:
    """Grade a submission, and print its points."""
    results = grader.grade(submission, out)
    rubric = grader.assignment.rubric
    for problem in rubric.problems:
        points = f"{results.problem_points(problem):g} of {problem.points:g}"
        say(f"{problem.id}: {points}{' (bonus)' if problem.bonus else ''}")
    total = f"{results.score:g} of {rubric.points:g} points"
    say(*results.remarks, f"{out}: {total}, {results.seconds:.0f} s")


def _require_graded(class_: Class) -> None:
    """RuntimeError if the machine has failed to grade some submissions."""
    names = [repr(member.id[: checks.LONGEST]) for member in class_.not_graded]
    if names:
        raise RuntimeError(
            f"{len(names)} submissions were not graded, because this machine failed: "
            f"{', '.join(names[:10])}. Run the same command again; the column reason of "
            f"{class_.csv} has the cause"
        )


def _write_pages(class_: Class, folder: Path) -> None:
    """Write `FOLDER/students/ID/feedback.html` for each, and `FOLDER/overview.html`."""
    from ..course.grade import feedback, overview

    feedback.write(class_, folder / "students")
    overview.write(class_, folder)
    say(f"{folder}: overview.html, and students/*/feedback.html")


def _check_one(
    submission: Path, out: Path | None, of_class: Mapping[str, object], jobs: int
) -> Path:
    """Refuse options that do not go together; returns the results file."""
    submission = checks.path("--submission", submission)
    if not submission.is_dir() and not submission.is_file():
        raise ValueError(
            f"--submission = {submission}: must be a folder, an archive or a file that exists"
        )
    for name, value in {**of_class, "--jobs": jobs if jobs > 1 else None}.items():
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
    """Refuse options that do not go together; returns the folder of results and the CSV file."""
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
    allowed = f"{cores} or less, the number of cores; tests have time limits"
    checks.require("--jobs", jobs, jobs <= cores, allowed)
    return out, csv


Archive = Annotated[Path, named("FILE", "Zip to write: autograder.zip.", "--out", "-o")]


def gradescope(
    assignment: Name, out: Archive, time_limit: TimeLimit = 540, memory: Memory = 4
) -> None:
    """Make an autograder for Gradescope: setup.sh, run_autograder, and all that they need.

    Upload it as it is. Choose the largest container, and there a limit above --time-limit.
    """
    _archive("gradescope", assignment, out, time_limit, memory)


def prairielearn(
    assignment: Name, out: Archive, time_limit: TimeLimit = 540, memory: Memory = 4
) -> None:
    """Make an external grader for PrairieLearn: Dockerfile, grade.sh, and all that they need.

    Build the image, and copy info.json into that of the question. It needs no network.
    """
    _archive("prairielearn", assignment, out, time_limit, memory)


def classroom50(
    assignment: Name, out: Archive, time_limit: TimeLimit = 540, memory: Memory = 4
) -> None:
    """Make an autograder for Classroom 50 on GitHub Actions: autograder.py, and all that it needs.

    Unpack it in CLASSROOM/autograders/ASSIGNMENT/. Classroom 50 publishes what is there.
    """
    _archive("classroom50", assignment, out, time_limit, memory)


def _archive(platform: str, assignment: str, out: Path, time_limit: float, memory: float) -> None:
    if out.is_dir():
        raise ValueError(f"--out = {out}: is a folder; must be a file")
    if out.suffix.lower() != ".zip":
        raise ValueError(f"--out = {out}: must end in .zip")
    from ..course.grade import autograders

    found = find(assignment)
    limits = {"time_limit_s": time_limit, "memory_gib": memory}
    names = autograders.write(found, out, platform, **limits)
    size = out.stat().st_size / 2**20
    say(f"{out}: {len(names)} files, {size:.1f} MiB; {found.rubric.points:g} points")


def similarity(
    assignment: Name,
    everyone: Annotated[Path, named("DIR", "Folder of a class's submissions.", "--all")],
    out: Annotated[Path, named("DIR", "A new folder, for JPlag.", "--out", "-o")],
) -> None:
    """Put a class's programs where JPlag compares them, and say how to run it.

    Stubs are separate, so that given code is ignored.
    """
    if not everyone.is_dir():
        raise ValueError(f"--all = {everyone}: is no folder; must be one of submissions")
    from ..course.grade import classes, similarity

    found = find(assignment)
    written, reasons = similarity.write(found, classes.submissions_in(everyone, found, [out]), out)
    for reason in reasons:
        note(f"warning: {reason}")
    next_step = f"  {similarity.command(out)}"
    say(f"{out}: {len(written)} submissions", "Next, with JPlag 5 or newer:", next_step)


def new_term(
    assignment: Name,
    term: Annotated[
        int | None, integer(0, MAX_SEED, "The term; 0 is that of the first year. Else drawn.")
    ] = None,
) -> None:
    """Draw new inputs for the public tests, so that last year's answers fail.

    It writes one line of the rubric. Commit it after `tofrender verify` has passed.
    """
    from ..course.author.release import new_term as write_term

    found = find(assignment)
    before, now = write_term(found, term)
    say(f"{found.rubric.id}: term {before} is term {now} now", "Next:")
    say(f"  tofrender verify {assignment} --seeds 200", f"  tofrender release {assignment} -o dist")
