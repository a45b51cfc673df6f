"""Grade submissions that may be wrong, broken or hostile: `tofrender grade`.

The process that runs this never imports a submission. For each problem it starts a judge, which is
pytest with the staff's tests, and the judge starts a worker, which runs the submission::

    grader  ->  judge (one a problem)  ->  worker (one after another)
    writes      writes its report and      writes its scratch folder
    results     its scratch folder

Each arrow takes rights away and ends all that is behind it (see `judge.sandbox`). If root grades,
the worker is a user that nobody else is. A worker that crashes costs the test that asked it, a
judge that is lost costs the problem's tests that had not ended, and whatever happens to this
process, a results file with 0 points has been written before anything else.

A class is copied before the first submission runs, to where none of them can read or write. Of all
that is made on the way, a submission reads its own part only, and the edition.
"""

from __future__ import annotations

import compileall
import hashlib
import os
import secrets
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
from ..assignments import PACKAGE, STAFF_TEST, Assignment
from ..judge import processes, running, sandbox
from ..rubric import MAX_SEED, Problem
from . import unpacking
from .results import Grade, Results, grades_of

TIME_LIMIT_S = 540.0
"""Time for a submission [s], below the ten minutes that Gradescope gives."""
MEMORY_GIB = 4.0
"""Memory of all processes of a submission together [GiB]."""
JUDGE_GIB = 2.0  # of the judge, besides
START_S = 30.0  # of judge and worker, on a slow machine
LEAST_S = 20.0  # for a problem, even if those before it have used up their time
BEYOND_S = 15.0
"""Time beyond a submission's limit in which the problems that are left are still judged [s]."""
MAX_PICTURES, MAX_PICTURE = 40, 4 << 20  # of a problem; of each [bytes]
CLASS = "class"
"""Folder of the copies that wait."""
KEPT_VARIABLES = ("PATH", "LANG", "LC_", "LD_LIBRARY_PATH", "DRJIT_", "TZ")


@dataclass(frozen=True)
class Taken:
    """A submission's files, copied.

    Attributes:
        folder: Holds them, for this grader alone to change.
        refused: Why there are none, "" if there are.
    """

    folder: Path
    refused: str = ""


@dataclass(frozen=True)
class Grader:
    """Grades submissions of one assignment, one after another.

    Attributes:
        assignment: With all its tests.
        scratch: Folder for what is made on the way; `opened` makes and removes it.
        time_limit_s: Longest time for a submission [s].
        memory_gib: Most memory of a submission [GiB].
        seed: Seed of the staff's tests, the same for all submissions.
    """

    assignment: Assignment
    scratch: Path
    time_limit_s: float = TIME_LIMIT_S
    memory_gib: float = MEMORY_GIB
    seed: int = 0

    def take(self, submission: Path) -> Taken:
        """Copy what a submission consists of, and what was given and is not in it."""
        folder = Path(tempfile.mkdtemp(dir=self.scratch / CLASS)) / "submission"
        try:
            unpacking.extract(submission, self.assignment.rubric.submit, folder)
        except unpacking.BadSubmission as error:
            remove(folder.parent)
            return Taken(folder, f"the submission {error}")
        for name in self.assignment.given:
            if not (folder / name).exists():
                shutil.copyfile(self.assignment.starter / name, folder / name)
        return Taken(folder)

    def grade(
        self,
        submission: Path | Taken,
        out: Path,
        hidden: Sequence[Path] = (),
        pictures: Path | None = None,
    ) -> Results:
        """Grade a submission.

        Call it from a thread that stays: what it starts ends with that thread.

        Args:
            submission: Folder or zip, or what `take` has made of it, which is used up.
            out: File to write in Gradescope's format.
            hidden: What the submission must not read, besides solutions.
            pictures: Folder to make of pictures of failures, if there are any.

        Returns:
            What is in the file.
        """
        begin = time.monotonic()
        rubric = self.assignment.rubric
        results = Results(rubric, fingerprint=self.fingerprint, seed=self.seed)
        results.missing_protections = sandbox.missing_protections()
        results.remarks = ["grading was interrupted"]
        results.write(out)
        results.remarks = []
        folder = Path(tempfile.mkdtemp(prefix="submission-", dir=self.scratch))
        folder.chmod(0o711)
        try:
            taken = submission if isinstance(submission, Taken) else self.take(submission)
            if taken.refused:
                results.remarks.append(taken.refused)
            else:
                taken.folder.rename(folder / "submission")
                taken.folder.parent.rmdir()
                show(folder / "submission")
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
        """Stands for the rubric, the tests and their seed."""
        digest = hashlib.sha256(str(self.seed).encode())
        for path in judging_files(self.assignment):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        return digest.hexdigest()[:16]

    def _judge_all(
        self, folder: Path, results: Results, begin: float, hidden: Sequence[Path]
    ) -> None:
        """Judge one problem after the other, each in what is left of the time."""
        problems = self.assignment.rubric.problems
        package = self.scratch / "edition"
        if not sandbox.keeps_files():  # a submission might change what the next one gets
            package = shutil.copytree(package, folder / "edition")
        # the judge, too, works with the student edition: nobody needs what holds the solutions
        hidden = [PACKAGE, PACKAGE.parent / ".git", self.assignment.folder, *hidden]
        hidden += [self.scratch, *map(Path, sandbox.home())]
        with sandbox.own_user() as uid:
            for number, problem in enumerate(problems):
                left = self.time_limit_s - (time.monotonic() - begin)
                if left < 1 - BEYOND_S:
                    reason = f"not judged: all problems together took {self.time_limit_s:g} s"
                    results.grades |= grades_of(problem, [], False, reason)
                    continue
                later = sum(2 * other.takes_s + 5 for other in problems[number + 1 :])
                whole = START_S + problem.timeout_s + 4 * problem.takes_s
                timeout_s = min(max(LEAST_S, min(whole, left - later)), left + BEYOND_S)
                results.grades |= self._judge(problem, folder, package, hidden, timeout_s, uid)

    def _judge(
        self,
        problem: Problem,
        folder: Path,
        package: Path,
        hidden: Sequence[Path],
        timeout_s: float,
        uid: int | None,
    ) -> dict[str, Grade]:
        """Judge one problem in a process of its own; grades by test id."""
        place = folder / problem.marker
        place.mkdir()
        place.chmod(0o755)
        for name, mode in (("home", 0o700), ("tmp", 0o711), ("report", 0o700)):
            (place / name).mkdir()
            (place / name).chmod(mode)
        judging = place / "judging"
        for path in judging_files(self.assignment, problem):
            target = judging / path.relative_to(self.assignment.folder)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        show(judging, but=("test_*.py", STAFF_TEST, "mutants.toml", "solutions/*"))
        report = place / "report" / "lines.json"
        secret = place / "report" / "secret"
        secret.write_text(str(self.seed), encoding="utf-8")
        options = {
            "rootdir": judging,
            "submission": folder / "submission",
            "edition": package,
            "report": report,
            "secret": secret,
            "pictures": place / "report" / "pictures",
            "memory-gib": self.memory_gib,
        }
        pytest = [sys.executable, "-P", "-s", "-m", "pytest", *running.QUICKLY]
        pytest += ["-c", "pytest.ini", "-m", problem.marker, "--confine"]
        pytest += [f"--{name}={value}" for name, value in options.items()]
        pytest += [] if uid is None else [f"--uid={uid}"]
        confined = {
            "writable": [str(place / name) for name in ("home", "tmp", "report")],
            "hidden": [str(path) for path in hidden],
            # what others make in the scratch folder, now or later, is not among it
            "readable": [
                *sandbox.python_folders(),
                *map(str, (package, folder / "submission", place)),
            ],
            "judge": True,
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
        drawn.mkdir(mode=0o700, exist_ok=True)
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
def opened(assignment: Assignment, seed: int = 0, **limits: float) -> Iterator[Grader]:
    """Make what all submissions share, and remove it afterwards.

    Args:
        assignment: With all its tests.
        seed: Seed of the staff's tests; with 0 the rubric's, and with 0 there one is drawn.
        limits: `time_limit_s` and `memory_gib` of `Grader`.
    """
    seed = drawn_seed(assignment, seed)
    scratch = Path(tempfile.mkdtemp(prefix="tofrender-grade-")).resolve()
    try:
        scratch.chmod(0o711)
        (scratch / CLASS).mkdir(mode=0o700)
        edition.of_grading(assignment, scratch / "edition")
        compileall.compile_dir(scratch / "edition", quiet=1)
        show(scratch / "edition")
        yield Grader(assignment, scratch, **limits, seed=seed)
    finally:
        remove(scratch)


def drawn_seed(assignment: Assignment, seed: int = 0) -> int:
    """The seed of the staff's tests: the one given, else the rubric's, else one that none knows."""
    return seed or assignment.rubric.seed or 1 + secrets.randbelow(MAX_SEED)


def remove(folder: Path) -> None:
    """Remove a folder, however deep a submission has made it."""
    with suppress(RecursionError):
        shutil.rmtree(folder, ignore_errors=True)
    if folder.exists() and os.name == "posix":  # what is deep, or closed to its owner
        for command in (["chmod", "-R", "u+rwX"], ["rm", "-rf"]):
            full = [*command, "--", str(folder)]
            subprocess.run(full, check=False, stderr=subprocess.DEVNULL)


def show(folder: Path, but: Sequence[str] = ()) -> None:
    """Let other users read a folder of the grader's, as the worker may be one.

    Args:
        folder: With all below it.
        but: Patterns of files that only the grader reads.
    """
    for inside, folders, names in os.walk(folder):
        for name in folders:
            path = Path(inside, name)
            path.chmod(path.stat().st_mode | 0o055)
        for name in names:
            path = Path(inside, name)
            secret = any(map(path.match, but))
            path.chmod(0o600 if secret else path.stat().st_mode | 0o044)
    folder.chmod(0o755)


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
