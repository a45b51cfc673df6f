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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ...runtime.atomic import replacing
from .. import edition
from ..assignments import PACKAGE, Assignment
from ..judge import processes, running, sandbox
from ..rubric import Problem
from . import unpacking
from .results import Grade, Results, grades_of

TIME_LIMIT_S = 540.0
"""Time for a submission [s], below the ten minutes that Gradescope gives."""
MEMORY_GIB = 4.0
"""Memory of all processes of a submission together [GiB]."""
JUDGE_GIB = 2.0  # of the judge, besides
START_S = 30.0  # of judge and worker, on a slow machine
LEAST_S = 20.0  # for a problem, even if those before it have used up the time
MAX_PICTURES, MAX_PICTURE = 40, 4 << 20  # of a problem; of each [bytes]
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

    def grade(
        self,
        submission: Path,
        out: Path,
        hidden: Sequence[Path] = (),
        pictures: Path | None = None,
    ) -> Results:
        """Grade a submission.

        Call it from a thread that stays: what it starts ends with that thread.

        Args:
            submission: Folder or zip.
            out: File to write in Gradescope's format.
            hidden: What the submission must not read, besides solutions.
            pictures: Folder to make of pictures of failures, if there are any.

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
        # as one of them is hidden, those that others make later are not to be read either
        others = [path for path in self.scratch.iterdir() if path.name != "edition"]
        hidden = [*hidden, *(path for path in others if path != folder)]
        try:
            unpacking.extract(submission, rubric.submit, folder / "submission")
        except unpacking.BadSubmission as error:
            results.remarks.append(f"the submission {error}")
            _keep_pictures(folder / "pictures", pictures)
        else:
            self._judge_all(folder, results, begin, hidden)
            _keep_pictures(folder / "pictures", pictures)
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
        for path in judging_files(self.assignment):
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
        for path in judging_files(self.assignment, problem):
            target = judging / path.relative_to(self.assignment.folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        report = place / "report" / "lines.json"
        options = {
            "rootdir": judging,
            "submission": folder / "submission",
            "edition": package,
            "report": report,
            "pictures": place / "report" / "pictures",
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
        drawn = folder / "pictures"
        drawn.mkdir(exist_ok=True)
        for path in sorted((place / "report" / "pictures").glob("*.png"))[:MAX_PICTURES]:
            if path.is_file() and not path.is_symlink() and path.stat().st_size <= MAX_PICTURE:
                shutil.copyfile(path, drawn / f"{problem.marker}-{path.name}")
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
        (scratch / "others").mkdir()
        edition.of_grading(assignment, scratch / "edition")
        compileall.compile_dir(scratch / "edition", quiet=1)
        yield Grader(assignment, scratch, **limits)
    finally:
        remove(scratch)


def remove(folder: Path) -> None:
    """Remove a folder, however deep a submission has made it."""
    with suppress(RecursionError):
        shutil.rmtree(folder, ignore_errors=True)
    if folder.exists() and os.name == "posix":
        subprocess.run(["rm", "-rf", "--", str(folder)], check=False, stderr=subprocess.DEVNULL)


def judging_files(assignment: Assignment, problem: Problem | None = None) -> list[Path]:
    """What of an assignment's folder the judge needs.

    Args:
        assignment: With all its tests.
        problem: The problem that is judged; None for all of them.
    """
    folder, rubric = assignment.folder, assignment.rubric
    files = [folder / "rubric.toml", folder / "pytest.ini"]
    tests = sorted((folder / "tests").rglob("*"))
    files += [path for path in tests if path.is_file() and "__pycache__" not in path.parts]
    testing = [each for each in rubric.problems if each.tests_of and problem in (None, each)]
    if testing:  # a student's test is tried on right and wrong solutions
        tested = {each.tests_of for each in testing}
        names = [each.file for each in rubric.problems if each.id in tested]
        files += [folder / "mutants.toml", *(assignment.solutions / name for name in names)]
    return files


def _keep_pictures(made: Path, target: Path | None) -> None:
    """Put a submission's pictures where they stay, in the place of earlier ones."""
    if target is None:
        return
    if made.is_dir() and any(made.iterdir()):
        with replacing(target, folder=True) as folder:
            shutil.copytree(made, folder, dirs_exist_ok=True)
    elif target.is_dir():
        remove(target)


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
