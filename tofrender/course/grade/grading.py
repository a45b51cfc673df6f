"""Grade submissions that may be wrong, broken or hostile: `tofrender grade`.

The process that runs this never imports a submission. For each problem it starts a judge, which is
pytest with the staff's tests, and the judge starts a worker, which runs the submission::

    grader  ->  judge (one a problem)  ->  worker (one after another)
    writes      writes its report and      writes its scratch folder
    results     its scratch folder

Each arrow takes rights away and ends all that is behind it. A worker that crashes costs the test
that asked it, a judge that is lost costs the problem's tests that had not ended, and whatever
happens to this process, a results file with 0 points has been written before anything else.
"""

from __future__ import annotations

import compileall
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import edition
from ..assignments import PACKAGE, Assignment
from ..judge import processes, running, sandbox
from ..rubric import Problem
from . import unpacking
from .results import Grade, Results, finished, grades_of, printable, write_csv

TIME_LIMIT_S = 540.0
"""Time for a submission [s], below the ten minutes that Gradescope gives."""
MEMORY_GIB = 4.0
"""Memory of all processes of a submission together [GiB]."""
JUDGE_GIB = 2.0  # of the judge, besides
START_S = 30.0  # of judge and worker, on a slow machine
LEAST_S = 20.0  # for a problem, even if those before it have used up the time
KEPT_VARIABLES = ("PATH", "LANG", "LC_", "LD_LIBRARY_PATH", "DRJIT_", "TZ")


@dataclass(frozen=True)
class Grader:
    """Grades submissions of one assignment, one after another.

    Attributes:
        assignment: With all its tests.
        scratch: Folder for what is made on the way; `opened` makes and removes it.
        time_limit_s: Longest time for a submission [s].
        memory_gib: Most memory of a submission [GiB].
    """

    assignment: Assignment
    scratch: Path
    time_limit_s: float = TIME_LIMIT_S
    memory_gib: float = MEMORY_GIB

    def grade(self, submission: Path, out: Path, hidden: Sequence[Path] = ()) -> Results:
        """Grade a submission.

        Call it from a thread that stays: what it starts ends with that thread.

        Args:
            submission: Folder or zip.
            out: File to write in Gradescope's format.
            hidden: What the submission must not read, besides solutions.

        Returns:
            What is in the file.
        """
        begin = time.monotonic()
        rubric = self.assignment.rubric
        results = Results(rubric, fingerprint=self.fingerprint)
        results.missing_protections = sandbox.missing_protections()
        results.remarks = ["grading was interrupted"]
        results.write(out)
        results.remarks = []
        folder = Path(tempfile.mkdtemp(prefix="submission-", dir=self.scratch))
        try:
            unpacking.extract(submission, rubric.submit, folder / "submission")
        except unpacking.BadSubmission as error:
            results.remarks.append(f"the submission {error}")
        else:
            self._judge_all(folder, results, begin, hidden)
        finally:
            remove(folder)
        results.seconds = time.monotonic() - begin
        results.complete = True
        results.write(out)
        return results

    @property
    def fingerprint(self) -> str:
        """Stands for the rubric and the tests."""
        digest = hashlib.sha256()
        for path in _judging_files(self.assignment.folder):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        return digest.hexdigest()[:16]

    def _judge_all(
        self, folder: Path, results: Results, begin: float, hidden: Sequence[Path]
    ) -> None:
        """Judge one problem after the other, each in what is left of the time."""
        problems = self.assignment.rubric.problems
        package = self.scratch / "edition"
        if results.missing_protections:  # a submission might change what the next one gets
            package = shutil.copytree(package, folder / "edition")
        # the judge, too, works with the student edition: nobody needs what holds the solutions
        hidden = [PACKAGE, PACKAGE.parent / ".git", self.assignment.folder, *hidden]
        for number, problem in enumerate(problems):
            later = sum(2 * other.takes_s + 5 for other in problems[number + 1 :])
            left = self.time_limit_s - (time.monotonic() - begin) - later
            whole = START_S + problem.timeout_s + 4 * problem.takes_s
            timeout_s = max(LEAST_S, min(whole, left))
            results.grades |= self._judge(problem, folder, package, hidden, timeout_s)

    def _judge(
        self,
        problem: Problem,
        folder: Path,
        package: Path,
        hidden: Sequence[Path],
        timeout_s: float,
    ) -> dict[str, Grade]:
        """Judge one problem in a process of its own; grades by test id."""
        place = folder / problem.marker
        for name in ("home", "tmp", "report"):
            (place / name).mkdir(parents=True)
        judging = place / "judging"
        for path in _judging_files(self.assignment.folder):
            target = judging / path.relative_to(self.assignment.folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        report = place / "report" / "lines.json"
        options = {
            "rootdir": judging,
            "submission": folder / "submission",
            "edition": package,
            "report": report,
            "memory-gib": self.memory_gib,
        }
        pytest = [sys.executable, "-P", "-s", "-m", "pytest", *running.QUICKLY]
        pytest += ["-c", "pytest.ini", "-m", problem.marker, "--confine"]
        pytest += [f"--{name}={value}" for name, value in options.items()]
        confined = {
            "writable": [str(place / name) for name in ("home", "tmp", "report")],
            "hidden": [str(path) for path in hidden],
        }
        ended = processes.run(
            sandbox.command(confined, pytest),
            timeout_s=timeout_s,
            memory_bytes=int((self.memory_gib + JUDGE_GIB) * 2**30),
            cwd=judging,
            env=_environment(place, package),
        )
        lines = running.read_report(report)
        whole = not ended.reason and ended.status in (0, 1)  # 1: some failed
        reason = ended.reason and f"not judged: the problem {ended.reason}"
        if not whole and not reason:
            reason = f"not judged: the judge ended with status {ended.status}\n{ended.output}"
        remove(place)
        return grades_of(problem, lines, whole, reason)


@contextmanager
def opened(assignment: Assignment, **limits: float) -> Iterator[Grader]:
    """Make what all submissions share, and remove it afterwards.

    Args:
        assignment: With all its tests.
        limits: `time_limit_s` and `memory_gib` of `Grader`.
    """
    scratch = Path(tempfile.mkdtemp(prefix="tofrender-grade-")).resolve()
    try:
        edition.copy(assignment, scratch / "edition")
        compileall.compile_dir(scratch / "edition", quiet=1)
        yield Grader(assignment, scratch, **limits)
    finally:
        remove(scratch)


def grade_all(
    grader: Grader, folder: Path, csv: Path, out: Path, say: Callable[[str], None]
) -> None:
    """Grade every folder and zip of a folder, none of which sees another.

    What is graded already is kept, unless the submission or the tests have changed since.

    Args:
        grader: What grades.
        folder: Folder of the submissions.
        csv: File to write after each of them, a line each.
        out: Folder of the results files, `NAME.json` each.
        say: Gets a line about each.
    """
    submissions = submissions_in(folder, out)
    out.mkdir(parents=True, exist_ok=True)
    rubric, fingerprint = grader.assignment.rubric, grader.fingerprint
    rows: dict[str, Any] = {}
    for number, submission in enumerate(submissions, 1):
        path = out / f"{submission.name}.json"
        content = finished(path, rubric, fingerprint)
        kept = content is not None and _changed(submission) <= path.stat().st_mtime
        if content is None or not kept:
            content = grader.grade(submission, path, [folder, out]).gradescope()
        del content["tests"]
        rows[submission.name] = content
        write_csv(csv, rubric, rows)
        points = f"{content['score']:g} of {rubric.points:g} points"
        name = printable(submission.name, 100)
        how = "graded before" if kept else f"{content['execution_time']:.0f} s"
        say(f"[{number}/{len(submissions)}] {name}: {points}, {how}")


def submissions_in(folder: Path, out: Path) -> list[Path]:
    """The folders and zips of a folder, by name.

    Raises:
        ValueError: There are none.
    """
    found = [
        path
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".")
        and (path.is_dir() or path.suffix.lower() == ".zip")
        and path.resolve() != out.resolve()
    ]
    if not found:
        raise ValueError(f"--all = {folder}: holds no folders and no zips")
    return found


def remove(folder: Path) -> None:
    """Remove a folder, however deep a submission has made it."""
    with suppress(RecursionError):
        shutil.rmtree(folder, ignore_errors=True)
    if folder.exists() and os.name == "posix":
        subprocess.run(["rm", "-rf", "--", str(folder)], check=False, stderr=subprocess.DEVNULL)


def _judging_files(folder: Path) -> list[Path]:
    """What of an assignment's folder the judge needs."""
    files = [folder / "rubric.toml", folder / "pytest.ini"]
    tests = sorted((folder / "tests").rglob("*"))
    return files + [path for path in tests if path.is_file() and "__pycache__" not in path.parts]


def _environment(place: Path, package: Path) -> dict[str, str]:
    """What judge and worker see of this process's environment: nothing that is private."""
    kept = {name: text for name, text in os.environ.items() if name.startswith(KEPT_VARIABLES)}
    return kept | {
        "HOME": str(place / "home"),
        "TMPDIR": str(place / "tmp"),
        "PYTHONPATH": str(package),
        "PYTHONSAFEPATH": "1",
        "PYTHONNOUSERSITE": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
    }


def _changed(submission: Path) -> float:
    """When a file of a submission was last changed or put there [s since 1970]."""
    paths = [submission]
    for folder, folders, names in os.walk(submission):
        paths += [Path(folder, name) for name in (*folders, *names)]
    newest = 0.0
    for path in paths:
        with suppress(OSError):
            state = path.lstat()
            newest = max(newest, state.st_mtime, state.st_ctime)
    return newest
