"""The commands `tofrender grade`, `gradescope`, `similarity` and `new-term`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..course.assignments import find
from ..course.rubric import MAX_SEED
from ..runtime import checks
from .course import Name
from .options import choice, integer, named, note, real, say, with_groups

if TYPE_CHECKING:
    from ..course.grade.classes import Class
    from ..course.grade.grading import Grader

MAX_JOBS = 256

RESULTS = "Results file to write. With --all, folder of results files."
ROSTER = (
    "With --all, CSV file of the class with the column id, and optionally name, email, section "
    "and submission. By default, each submission is a row of --csv."
)
SHEET = (
    "With --all, CSV file of manual entries with the column id, and optionally late_days, "
    "handed_in (time, compared with the deadline of the rubric), note, "
    "ids of problems (points that replace those of the tests) and of parts graded by hand."
)
COLUMNS = (
    'With --all, write the column NAME with the values of FIELD to --csv, e.g. "Login ID=email". '
    "Repeat the option for more columns. By default, the file has the columns that roster, tests "
    "and sheet fill. FIELD is id, name, email, section, submission, total, the id of a problem, "
    "late_days, lost_late, note or reason."
)
FORMATS = ("gradescope", "prairielearn", "classroom50", "junit")

TimeLimit = Annotated[float, real(30, "Time limit of one submission [s]")]
Memory = Annotated[float, real(1, "Memory limit of one submission [GiB]")]


@dataclass(frozen=True)
class ClassFiles:
    """Options that require --all."""

    csv: Annotated[
        Path | None, named("FILE", "With --all, CSV file to write, one row per student.")
    ] = None
    columns: Annotated[list[str] | None, named("NAME=FIELD", COLUMNS)] = None
    jobs: Annotated[int, integer(1, MAX_JOBS, "With --all, submissions graded in parallel")] = 1
    roster: Annotated[Path | None, named("FILE", ROSTER)] = None
    sheet: Annotated[Path | None, named("FILE", SHEET)] = None
    feedback: Annotated[
        Path | None,
        named("DIR", "With --all, folder for a page per student and an overview of the class."),
    ] = None


@with_groups
def grade(
    assignment: Name,
    submission: Annotated[
        Path | None, named("PATH", "Submission of one student: folder, zip, tar or Python file.")
    ] = None,
    everyone: Annotated[
        Path | None, named("DIR", "Folder with the submissions of a class.", "--all")
    ] = None,
    out: Annotated[Path | None, named("FILE|DIR", RESULTS, "--out", "-o")] = None,
    *,
    of_class: ClassFiles,
    time_limit: TimeLimit = 540,
    memory: Memory = 4,
    format: Annotated[str, choice(FORMATS, "Format of --out for one submission")] = "gradescope",
) -> None:
    """Grade one submission or a whole class.

    Grading a class can be interrupted and resumed. Finished results are kept, unless the submission
    or the tests have changed. The sheet of manual entries can be added later. If the machine fails,
    submissions are reported as not graded, and the exit status is 1. Run the same command again
    to grade them.

    The hidden tests use a random seed, unless the file seed.txt in the assignment's folder contains
    one. The results contain the seed.

    Examples:
        tofrender grade a1 --submission ana.zip --out results.json
        tofrender grade a1 --all submissions --csv grades.csv --feedback feedback
    """
    if (submission is None) == (everyone is None):
        raise ValueError("pass either --submission PATH or --all DIR")
    csv = of_class.csv
    roster = of_class.roster
    sheet = of_class.sheet
    feedback = of_class.feedback
    if submission is not None:
        out = _check_one(submission, out, of_class)
    else:
        assert everyone is not None
        if format != "gradescope":
            raise ValueError(f"--format = {format} cannot be combined with --all")
        out, csv = _check_class(everyone, out, csv, feedback, of_class.jobs)

    from ..course.grade import classes, grading, results, roster as rosters
    from ..course.judge import sandbox

    found = find(assignment)
    found.require_tests()
    members = []
    unknown = []
    marks = None
    if everyone is not None:
        reserved = [path for path in (out, csv, feedback, roster, sheet) if path is not None]
        those = classes.submissions_in(everyone, found, reserved)
        members, unknown = rosters.members(those, roster)
        marks = None if sheet is None else rosters.marks(sheet, found.rubric, members)
    shown = rosters.columns(of_class.columns or [], found.rubric)
    for risk in sandbox.missing_protections():
        note(f"warning: this machine cannot keep a submission from {risk}")
    for name in unknown:
        note(f"warning: --roster = {roster}: no student has the submission {name!a}")
    try:
        before = results.seed_of_before(out) if submission is None else 0
        more = {"time_limit_s": time_limit, "memory_gib": memory, "format": format}
        with grading.open_grader(found, before, **more) as grader:
            if submission is not None:
                _grade_one(grader, submission, out)
            elif everyone is not None and csv is not None:
                private = [path for path in (roster, sheet, feedback) if path is not None]
                class_ = classes.Class(
                    grader,
                    everyone,
                    members,
                    csv,
                    out,
                    marks,
                    roster is not None,
                    of_class.jobs,
                    private,
                )
                class_.columns = shown
                class_.grade(say)
                say(f"{csv}: written")
                if feedback is not None:
                    _write_pages(class_, feedback)
                _require_graded(class_)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; finished results are kept") from None


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
    """Raise a RuntimeError if the machine has failed to grade some submissions."""
    names = [repr(member.id[: checks.LONGEST]) for member in class_.not_graded]
    if names:
        raise RuntimeError(
            f"{len(names)} submissions were not graded, because this machine failed: "
            f"{', '.join(names[:10])}. Run the same command again; the column reason of "
            f"{class_.csv} has the cause"
        )


def _write_pages(class_: Class, folder: Path) -> None:
    """Write `students/ID/feedback.html` for each student, and `overview.html`."""
    from ..course.grade import feedback, overview

    feedback.write(class_, folder / "students")
    overview.write(class_, folder)
    say(f"{folder}: overview.html, and students/*/feedback.html")


def _check_one(submission: Path, out: Path | None, of_class: ClassFiles) -> Path:
    """Return the results file, and raise a ValueError if options cannot be combined."""
    submission = checks.path("--submission", submission)
    if not submission.is_dir() and not submission.is_file():
        raise ValueError(
            f"--submission = {submission}: must be a folder, an archive or a file that exists"
        )
    given: dict[str, Any] = {
        "--csv": of_class.csv,
        "--roster": of_class.roster,
        "--sheet": of_class.sheet,
        "--feedback": of_class.feedback,
        "--columns": of_class.columns[0] if of_class.columns else None,
        "--jobs": of_class.jobs if of_class.jobs > 1 else None,
    }
    for name, value in given.items():
        if value is not None:
            raise ValueError(f"{name} = {value} requires --all")
    if out is None:
        raise ValueError("--out is missing. Add the file to write, for example results.json")
    _require_no_folder("--out", out)
    return out


def _check_class(
    everyone: Path, out: Path | None, csv: Path | None, feedback: Path | None, jobs: int
) -> tuple[Path, Path]:
    """Check the options for a class.

    Returns:
        The folder of results, and the CSV file.

    Raises:
        ValueError: Options cannot be combined, or a value is wrong.
    """
    _require_folder("--all", everyone)
    if csv is None:
        raise ValueError("--csv is missing. Add the file to write, for example grades.csv")
    _require_no_folder("--csv", csv)
    if out is None:
        out = csv.absolute().with_name(f"{csv.stem}_results")
    for name, path in (("--out", out), ("--feedback", feedback)):
        if path is not None and path.exists() and not path.is_dir():
            raise ValueError(f"{name} = {path} is a file. Choose a folder")
    cores = os.cpu_count() or 1
    allowed = f"{cores} or less, the number of cores, because tests have time limits"
    checks.require("--jobs", jobs, jobs <= cores, allowed)
    return out, csv


def _require_folder(option: str, path: Path) -> None:
    if not path.is_dir():
        raise ValueError(f"{option} = {path} is not a folder. Pass the folder of the submissions")


def _require_no_folder(option: str, path: Path) -> None:
    if path.is_dir():
        raise ValueError(f"{option} = {path} is a folder. Choose a file")


Archive = Annotated[
    Path, named("FILE", "Archive to write, for example autograder.zip.", "--out", "-o")
]


def gradescope(
    assignment: Name, out: Archive, time_limit: TimeLimit = 540, memory: Memory = 4
) -> None:
    """Make an autograder for Gradescope.

    Upload the archive without changes. Choose the largest container, and a time limit of Gradescope
    that is longer than --time-limit.

    Examples:
        tofrender gradescope a1 -o autograder.zip
        tofrender gradescope a2 -o autograder.zip --time-limit 900
    """
    _archive("gradescope", assignment, out, time_limit, memory)


def prairielearn(
    assignment: Name, out: Archive, time_limit: TimeLimit = 540, memory: Memory = 4
) -> None:
    """Make an external grader for PrairieLearn.

    Build the image from the Dockerfile, and copy the entries of info.json into the question's
    info.json. The grader does not need a network.

    Examples:
        tofrender prairielearn a1 -o grader.zip
        tofrender prairielearn a2 -o grader.zip --memory 8
    """
    _archive("prairielearn", assignment, out, time_limit, memory)


def classroom50(
    assignment: Name, out: Archive, time_limit: TimeLimit = 540, memory: Memory = 4
) -> None:
    """Make an autograder for Classroom 50.

    The autograder runs on GitHub Actions. Unpack the archive in CLASSROOM/autograders/ASSIGNMENT/.
    Classroom 50 publishes all files there.

    Examples:
        tofrender classroom50 a1 -o autograder.zip
        tofrender classroom50 a2 -o autograder.zip --time-limit 900
    """
    _archive("classroom50", assignment, out, time_limit, memory)


def _archive(platform: str, assignment: str, out: Path, time_limit: float, memory: float) -> None:
    _require_no_folder("--out", out)
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
    everyone: Annotated[Path, named("DIR", "Folder with the submissions of a class.", "--all")],
    out: Annotated[
        Path, named("DIR", "Folder to create, with the files that JPlag reads.", "--out", "-o")
    ],
    old: Annotated[
        Path | None, named("DIR", "Folder with submissions of other terms.", "--old")
    ] = None,
) -> None:
    """Prepare submissions for a comparison with JPlag.

    The command copies the programs into a new folder and prints the command that runs JPlag. The
    stubs are in a separate folder, so that JPlag ignores the given code. JPlag also compares the
    submissions with the solutions of the staff, the package, and submissions of other terms.

    Examples:
        tofrender similarity a1 --all submissions -o jplag
        tofrender similarity a2 --all class_2026 --old class_2025 -o jplag_a2
    """
    _require_folder("--all", everyone)
    if old is not None:
        _require_folder("--old", old)
    from ..course.grade import classes, similarity

    found = find(assignment)
    submissions = classes.submissions_in(everyone, found, [out])
    earlier = classes.submissions_in(old, found, [out]) if old is not None else []
    written, reasons = similarity.write(found, submissions, out, earlier)
    for reason in reasons:
        note(f"warning: {reason}")
    next_step = f"  {similarity.command(out)}"
    say(f"{out}: {len(written)} submissions", "Next, with JPlag 5 or newer:", next_step)


def new_term(
    assignment: Name,
    term: Annotated[
        int | None,
        integer(0, MAX_SEED, "Seed of the term, 0 for the first year", show_default="random"),
    ] = None,
) -> None:
    """Draw new inputs for the public tests.

    Answers of an earlier term then fail. The command changes one line of the rubric, and computes
    the expected results of the public tests if they are in a file. Commit the changes after
    `tofrender verify` has passed.

    Examples:
        tofrender new-term a1
        tofrender new-term a1 --term 0
    """
    from ..course.author.release import new_term as write_term

    found = find(assignment)
    before, now = write_term(found, term)
    say(f"{found.rubric.id}: changed the term from {before} to {now}", "Next:")
    say(f"  tofrender verify {assignment} --seeds 200", f"  tofrender release {assignment} -o dist")
