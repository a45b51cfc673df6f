"""Grade submissions that may be wrong, broken or hostile: `tofrender grade`.

The process that runs this never imports a submission. For each problem it starts a judge, which is
pytest with the staff's tests, and the judge starts a worker, which runs the submission::

    grader  ->  judge (one a problem)  ->  worker (one after another)
    writes      writes its report and      writes its scratch folder
    results     its scratch folder

Each arrow removes rights, and ends all processes behind it (see `judge.sandbox`). If root grades,
the worker is a user that nobody else is. A worker that crashes costs the test that asked it, a
judge that is ended at a limit costs the problem's tests that had not ended. If the machine fails,
the submission is not graded. A results file without points is written before anything else.

A class is copied before the first submission runs, to a folder that none of them can read or
write. A submission reads its own part of the scratch folder only, and the edition.
"""

import compileall
import hashlib
import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...runtime.atomic import replacing
from .. import edition, mutants
from ..assignments import PACKAGE, SEED, Assignment
from ..judge import processes, running, sandbox
from ..material import copy_file
from ..rubric import MAX_SEED, STAFF_TEST, Problem
from . import unpacking
from .results import Grade, Results, grades_of

TIME_LIMIT_S = 540.0  # for a submission [s], below the ten minutes that Gradescope gives
MEMORY_GIB = 4.0  # of all processes of a submission together [GiB]
JUDGE_GIB = 2.0  # of the judge, besides
START_S = 30.0  # of judge and worker, on a slow machine
LEAST_S = 20.0  # for a problem, even if those before it have used up their time
BEYOND_S = 15.0  # time beyond a submission's limit in which remaining problems are still judged [s]
MAX_PICTURES, MAX_PICTURE = 40, 4 << 20  # of a problem; of each [bytes]
CLASS = "class"  # folder of the waiting copies
KEPT_VARIABLES = ("PATH", "LANG", "LC_", "LD_LIBRARY_PATH", "DRJIT_", "TZ")


@dataclass(frozen=True)
class Extracted:
    """Copied files of a submission."""

    folder: Path  # holds them, for this grader alone to change
    error: str = ""  # why there are none, "" if there are
    empty: bool = False  # whether the submission has none that were asked for


@dataclass(frozen=True)
class Grader:
    """Grades submissions of one assignment, one after another."""

    assignment: Assignment  # with all its tests
    scratch: Path  # temporary folder, made and removed by `open_grader`
    time_limit_s: float = TIME_LIMIT_S  # for a submission [s]
    memory_gib: float = MEMORY_GIB  # for a submission [GiB]
    seed: int = 0  # of the staff's tests, the same for all submissions
    format: str = "gradescope"  # of the results file, of `formats.FORMATS`

    def extract(self, submission: Path) -> Extracted:
        """Copy the files of a submission, and given ones that it lacks."""
        folder = Path(tempfile.mkdtemp(dir=self.scratch / CLASS)) / "submission"
        rubric = self.assignment.rubric
        try:
            unpacking.extract(submission, rubric.submit, folder, rubric.files)
        except unpacking.BadSubmission as error:
            remove(folder.parent)
            empty = isinstance(error, unpacking.Nothing)
            return Extracted(folder, f"the submission {error}", empty)
        for name in self.assignment.provided_files:
            if not (folder / name).exists():
                shutil.copyfile(self.assignment.starter / name, folder / name)
        return Extracted(folder)

    def grade(
        self,
        submission: Path | Extracted,
        out: Path,
        hidden: Sequence[Path] = (),
        pictures: Path | None = None,
    ) -> Results:
        """Grade a submission, or a copy of it by `extract`, which is used up.

        The results are written to `out`.

        Call it from a thread that stays: the processes end with that thread. The submission cannot
        read solutions and `hidden` paths. `pictures` is the folder to make of pictures of failures.
        MachineFailure if the submission is not the reason that a problem cannot be judged; then
        the results are without points.
        """
        begin = time.monotonic()
        results = Results(self.assignment.rubric, fingerprint=self.fingerprint, seed=self.seed)
        results.format = self.format
        results.missing_protections = sandbox.missing_protections()
        results.remarks = ["not graded: grading was interrupted"]
        results.write(out)
        results.remarks = []
        folder = Path(tempfile.mkdtemp(prefix="submission-", dir=self.scratch))
        folder.chmod(0o711)
        try:
            files = submission if isinstance(submission, Extracted) else self.extract(submission)
            if files.error:
                results.remarks.append(files.error)
            else:
                files.folder.rename(folder / "submission")
                files.folder.parent.rmdir()
                make_readable(folder / "submission")
                self._judge_all(folder, results, begin, hidden)
            _keep_pictures(folder / "pictures", pictures)
        except processes.MachineFailure as failure:
            results.remarks = [f"not graded: {failure}"]
            results.write(out)
            raise
        finally:
            remove(folder)
        results.seconds = time.monotonic() - begin
        results.complete = True
        results.write(out)
        return results

    @property
    def fingerprint(self) -> str:
        """Hash of the rubric, the tests and their seed."""
        digest = hashlib.sha256(str(self.seed).encode())
        for path in judging_files(self.assignment):
            digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
        return digest.hexdigest()[:16]

    def _judge_all(
        self, folder: Path, results: Results, begin: float, hidden: Sequence[Path]
    ) -> None:
        """Judge the problems in turn, each in the time that is left."""
        problems = self.assignment.rubric.problems
        package = self.scratch / "edition"
        if not sandbox.protects_files():  # a submission might change what the next one gets
            package = shutil.copytree(package, folder / "edition")
        # The judge, too, works with the student edition, without the solutions
        hidden = [PACKAGE, PACKAGE.parent, self.assignment.folder, *hidden]
        hidden += [self.scratch, *map(Path, sandbox.private())]
        with sandbox.own_user() as uid:
            for number, problem in enumerate(problems):
                left, reason = self.time_limit_s - (time.monotonic() - begin), ""
                if problem.file and not (folder / "submission" / problem.file).is_file():
                    reason = f"{problem.file} is missing (problem {problem.id})"
                elif left < 1 - BEYOND_S:
                    reason = f"not judged: all problems together took {self.time_limit_s:g} s"
                if reason:
                    results.grades |= grades_of(problem, [], reason)
                    continue
                later = sum(2 * other.takes_s + 5 for other in problems[number + 1 :])
                whole = START_S + 4 * (problem.timeout_s + problem.takes_s)
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
        workspace, submission = folder / problem.marker, folder / "submission"
        home, tmp, report = (workspace / name for name in ("home", "tmp", "report"))
        judging = workspace / "judging"
        for path, mode in ((workspace, 0o755), (home, 0o700), (tmp, 0o711), (report, 0o700)):
            path.mkdir()
            path.chmod(mode)
        for path in judging_files(self.assignment, problem):
            copy_file(path, judging / path.relative_to(self.assignment.folder))
        make_readable(judging, ("test_*.py", STAFF_TEST, mutants.FILE_NAME, "solutions/*"))
        (report / "secret").write_text(str(self.seed), encoding="utf-8")
        options = {
            "rootdir": judging,
            "submission": submission,
            "edition": package,
            "report": report / "lines.json",
            "secret": report / "secret",
            "pictures": report / "pictures",
            "memory-gib": self.memory_gib,
        }
        pytest = [sys.executable, "-P", "-s", "-m", "pytest", *running.PYTEST_OPTIONS]
        pytest += ["-c", "pytest.ini", "-m", problem.marker, "--confine"]
        pytest += [f"--{name}={value}" for name, value in options.items()]
        pytest += [] if uid is None else [f"--uid={uid}"]
        # Nothing that others make in the scratch folder, now or later, is readable
        confinement = {
            "writable": (home, tmp, report),
            "hidden": hidden,
            "readable": (*sandbox.python_folders(), package, submission, workspace),
            "judge": True,
        }
        ended = processes.run(
            sandbox.command(confinement, pytest),
            timeout_s=timeout_s,
            memory_bytes=int((self.memory_gib + JUDGE_GIB) * 2**30),
            folder=workspace,
            uid=uid,
            cwd=judging,
            env=_environment(home, tmp, package),
        )
        lines = running.read_report(report / "lines.json")
        pictures = folder / "pictures"
        pictures.mkdir(mode=0o700, exist_ok=True)
        for path in sorted((report / "pictures").glob("*.png"))[:MAX_PICTURES]:
            if path.is_file() and not path.is_symlink() and path.stat().st_size <= MAX_PICTURE:
                shutil.copyfile(path, pictures / f"{problem.marker}-{path.name}")
        remove(workspace)
        if ended.reason:
            return grades_of(problem, lines, f"not judged: the problem {ended.reason}")

        # Without a limit that was exceeded, all tests have run
        missing = {test.id for test in problem.tests} - {line["id"] for line in lines}
        if ended.status not in (running.OK, running.SOME_FAILED) or missing:
            last = [line for line in ended.output.splitlines() if line.strip()][-1:]
            status = f"problem {problem.id}: the judge ended with status {ended.status}"
            raise processes.MachineFailure(": ".join([status, *last]))
        return grades_of(problem, lines, "")


@contextmanager
def open_grader(assignment: Assignment, seed_before: int = 0, **more: Any) -> Iterator[Grader]:
    """Grader with a scratch folder and edition; `more` are `time_limit_s`, `memory_gib`, `format`.

    `seed_before` is the seed of earlier results of the class, 0 if there are none.
    """
    seed = seed_of(assignment, seed_before)
    scratch = Path(tempfile.mkdtemp(prefix="tofrender-grade-")).resolve()
    try:
        scratch.chmod(0o711)
        (scratch / CLASS).mkdir(mode=0o700)
        edition.of_grading(assignment, scratch / "edition")
        compileall.compile_dir(scratch / "edition", quiet=1)
        make_readable(scratch / "edition")
        yield Grader(assignment, scratch, **more, seed=seed)
    finally:
        remove(scratch)


def seed_of(assignment: Assignment, before: int = 0) -> int:
    """Seed of the staff's tests: that of the file, else that of before, else a drawn one.

    All users can read a command's arguments, and submissions the rubric.
    """
    path = assignment.folder / SEED
    if not path.is_file():
        return before or 1 + secrets.randbelow(MAX_SEED)
    text = path.read_text(encoding="utf-8", errors="replace").strip()
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= MAX_SEED):
        raise ValueError(f"{path}: {text[:20]!r}: must be an integer from 1 to {MAX_SEED}")
    return int(text)


def remove(folder: Path) -> None:
    """Remove a folder, however deep a submission has made it."""
    with suppress(RecursionError):
        shutil.rmtree(folder, ignore_errors=True)
    if folder.exists() and os.name == "posix":  # what is deep, or closed to its owner
        for command in (["chmod", "-R", "u+rwX"], ["rm", "-rf"]):
            full = [*command, "--", str(folder)]
            subprocess.run(full, check=False, stderr=subprocess.DEVNULL)


def make_readable(folder: Path, secret: Sequence[str] = ()) -> None:
    """Let other users, as the worker may be one, read a folder, but for files of some patterns."""
    for inside, folders, names in os.walk(folder):
        for path in (Path(inside, name) for name in (*folders, *names)):
            is_secret = path.name in names and any(map(path.match, secret))
            shared = 0o055 if path.name in folders else 0o044
            path.chmod(0o600 if is_secret else path.stat().st_mode | shared)
    folder.chmod(0o755)


def judging_files(assignment: Assignment, problem: Problem | None = None) -> list[Path]:
    """Files of an assignment's folder that the judge of a problem, or of all, needs."""
    folder, rubric = assignment.folder, assignment.rubric
    files = [folder / "rubric.toml", folder / "pytest.ini"]
    tests = sorted((folder / "tests").rglob("*"))
    files += [path for path in tests if path.is_file() and "__pycache__" not in path.parts]
    testing = [each for each in rubric.problems if each.tests_of and problem in (None, each)]
    if testing:  # a student's test is tried on right and wrong solutions
        tested = {each.tests_of for each in testing}
        names = [each.file for each in rubric.problems if each.id in tested]
        files += [folder / mutants.FILE_NAME, *(assignment.solutions / name for name in names)]
    return files


def _keep_pictures(made: Path, target: Path | None) -> None:
    """Move a submission's pictures to their folder, in place of earlier ones."""
    if target is None:
        return
    if made.is_dir() and any(made.iterdir()):
        with replacing(target, folder=True) as folder:
            shutil.copytree(made, folder, dirs_exist_ok=True)
    elif target.is_dir():
        remove(target)


def _environment(home: Path, tmp: Path, package: Path) -> dict[str, str]:
    """Environment of judge and worker, without anything private."""
    public = {name: text for name, text in os.environ.items() if name.startswith(KEPT_VARIABLES)}
    return public | {
        "HOME": str(home),
        "TMPDIR": str(tmp),
        "PYTHONPATH": str(package),
        "PYTHONSAFEPATH": "1",
        "PYTHONNOUSERSITE": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
    }


def main(request: dict[str, Any]) -> None:
    """Grade a copied submission; the arguments of `Grader` and `Grader.grade` as JSON."""
    settings, files = request["grader"], request["submission"]
    paths = {name: Path(settings[name]) for name in ("assignment", "scratch")}
    grader = Grader(**settings | paths | {"assignment": Assignment(paths["assignment"])})
    hidden = [Path(path) for path in request["hidden"]]
    submission = Extracted(**files | {"folder": Path(files["folder"])})
    try:
        grader.grade(submission, Path(request["out"]), hidden, Path(request["pictures"]))
    except processes.MachineFailure as failure:
        sys.exit(str(failure))


if __name__ == "__main__":  # Processes of a submission end with this one, and harm no other
    if sys.platform.startswith("linux"):
        sandbox.prctl(sandbox.SET_PDEATHSIG, signal.SIGTERM)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: ends what runs
    try:
        main(json.loads(sys.stdin.read()))
    except KeyboardInterrupt:
        sys.exit(130)
