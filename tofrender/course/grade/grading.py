"""Grade submissions that may be wrong, broken or hostile: `tofrender grade`.

The grading process never imports a submission. For each problem it starts a judge, which is pytest
with the staff's tests. The judge starts a worker, which runs the submission::

    grader  ->  judge (one per problem)  ->  worker (restarted after a crash)
    writes      writes its report and        writes its scratch folder
    results     its scratch folder

At each arrow, the new process gets fewer rights, and all its children are ended with it (see
`judge.sandbox`). If root grades, the worker runs as an otherwise unused user. After a crash of the
worker, the current test fails. If a judge exceeds a limit, the remaining tests of its problem fail.
If the machine fails, the submission is not graded. A results file without points is written before
anything else.

A class is copied before the first submission runs, to a folder that no submission can read or
change. A submission can read only its own part of the scratch folder, and the student edition.
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
from .. import edition, mutants, rubric as rubrics, toml
from ..assignments import PACKAGE, SEED, Assignment
from ..judge import processes, running, sandbox
from ..judge.speed import slowness
from ..material import copy_file
from ..rubric import MAX_SEED, STAFF_TEST, Problem
from . import unpacking
from .results import Grade, Results, grades_of

TIME_LIMIT_S = 540.0  # time limit of a submission [s]; Gradescope's own limit is ten minutes
MEMORY_GIB = 4.0  # memory limit of all processes of a submission together [GiB]
JUDGE_GIB = 2.0  # additional memory for the judge [GiB]
START_S = 30.0  # time to start judge and worker on a slow machine [s]
LEAST_S = 20.0  # least time for a problem, even if earlier problems have used the time [s]
GRACE_S = 15.0  # time beyond a submission's limit in which remaining problems are judged [s]
MAX_PICTURES = 40  # largest number of pictures per problem
MAX_PICTURE = 4 << 20  # largest size of a picture [bytes]
CLASS = "class"  # folder of the copies that wait to be graded
KEPT_VARIABLES = ("PATH", "LANG", "LC_", "LD_LIBRARY_PATH", "DRJIT_", "TZ")
"""Beginnings of the environment variables that judge and worker get."""


@dataclass(frozen=True)
class Extracted:
    """Copied files of a submission."""

    folder: Path  # folder of the copies, which the grader may change
    error: str = ""  # why no files were copied, "" if they were
    empty: bool = False  # whether the submission contains none of the requested files
    notes: Sequence[str] = ()  # sentences on files that were found in an unusual place


@dataclass(frozen=True)
class Grader:
    """Grades submissions of one assignment, one after another."""

    assignment: Assignment  # assignment with all its tests
    scratch: Path  # temporary folder; `open_grader` makes and removes it
    time_limit_s: float = TIME_LIMIT_S  # time limit of a submission [s]
    memory_gib: float = MEMORY_GIB  # memory limit of a submission [GiB]
    seed: int = 0  # seed of the staff's tests, the same for all submissions
    format: str = "gradescope"  # format of the results file, a key of `formats.FORMATS`

    def extract(self, submission: Path) -> Extracted:
        """Copy the files of a submission, and provided files that it lacks."""
        folder = Path(tempfile.mkdtemp(dir=self.scratch / CLASS)) / "submission"
        rubric = self.assignment.rubric
        try:
            notes: list[str] = []
            unpacking.extract(submission, rubric.submit, folder, rubric.files, notes)
        except unpacking.BadSubmission as error:
            remove(folder.parent)
            empty = isinstance(error, unpacking.Nothing)
            return Extracted(folder, f"the submission {error}", empty)
        for name in self.assignment.provided_files:
            if not (folder / name).exists():
                shutil.copyfile(self.assignment.starter / name, folder / name)
        return Extracted(folder, notes=notes)

    def grade(
        self,
        submission: Path | Extracted,
        out: Path,
        hidden: Sequence[Path] = (),
        pictures: Path | None = None,
    ) -> Results:
        """Grade a submission and write the results.

        Call this method from a thread that lives long enough, because the processes end with the
        thread.

        Args:
            submission: Path of the submission, or the result of `extract`. Its files are moved.
            out: Path of the results file.
            hidden: Paths that the submission must not read, in addition to the solutions.
            pictures: Folder for pictures of failures, which is made; None for no pictures.

        Raises:
            MachineFailure: The machine failed, so a problem cannot be judged. The results file then
                contains the reason, but no points.
        """
        # Write a results file first, in case that this process is ended
        begin = time.monotonic()
        results = Results(self.assignment.rubric, fingerprint=self.fingerprint, seed=self.seed)
        results.format = self.format
        results.missing_protections = sandbox.missing_protections()
        results.remarks = ["not graded: grading was interrupted"]
        results.write(out)
        results.remarks = []

        # Judge the problems in a temporary folder
        folder = Path(tempfile.mkdtemp(prefix="submission-", dir=self.scratch))
        folder.chmod(0o711)
        try:
            files = submission if isinstance(submission, Extracted) else self.extract(submission)
            if files.error:
                results.remarks.append(files.error)
            else:
                results.remarks.extend(files.notes)
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

        # Write the results
        results.seconds = time.monotonic() - begin
        results.complete = True
        results.write(out)
        return results

    @property
    def fingerprint(self) -> str:
        """Hash of everything that results depend on: the problems, the tests and their seed.

        Points that are given by hand and the late rule do not change results, so they do not count.
        """
        digest = hashlib.sha256(str(self.seed).encode())
        for path in judging_files(self.assignment):
            content = path.read_bytes()
            if path.name == rubrics.FILE_NAME:
                table = toml.read(path)
                judged = {name: table[name] for name in table if name not in rubrics.NOT_JUDGED}
                content = json.dumps(judged, sort_keys=True, default=str).encode()
            digest.update(path.name.encode() + b"\0" + content + b"\0")
        return digest.hexdigest()[:16]

    def _judge_all(
        self, folder: Path, results: Results, begin: float, hidden: Sequence[Path]
    ) -> None:
        """Judge the problems in turn, within the remaining time.

        Args:
            folder: Temporary folder with the subfolder `submission`.
            results: Results; the grades are added here.
            begin: Time when grading began, by `time.monotonic` [s].
            hidden: Paths that the submission must not read.
        """
        # Without a sandbox, each submission gets a copy of the edition, which it could change
        problems = self.assignment.rubric.problems
        package = self.scratch / "edition"
        if not sandbox.protects_files():
            package = shutil.copytree(package, folder / "edition")

        # Also hide the package with the solutions; the judge imports the student edition, too
        hidden = [PACKAGE, PACKAGE.parent, self.assignment.folder, *hidden]
        hidden += [self.scratch, *map(Path, sandbox.private())]
        with sandbox.own_user() as uid:
            for number, problem in enumerate(problems):
                # Can the problem be judged?
                left_s = self.time_limit_s - (time.monotonic() - begin)
                reason = ""
                if problem.file and not (folder / "submission" / problem.file).is_file():
                    reason = f"{problem.file} is missing (problem {problem.id})"
                elif left_s < 1 - GRACE_S:
                    reason = f"not judged: all problems together took {self.time_limit_s:g} s"
                if reason:
                    results.grades |= grades_of(problem, [], reason)
                    continue

                # Give it much more time than it needs, but leave time for later problems
                later_s = sum(2 * other.takes_s + 5 for other in problems[number + 1 :])
                # A slow machine gets more time, within the limit of the whole submission
                most_s = START_S + 4 * (problem.timeout_s + problem.takes_s)
                most_s *= slowness()
                timeout_s = max(LEAST_S, min(most_s, left_s - later_s))
                timeout_s = min(timeout_s, left_s + GRACE_S)
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
        """Judge one problem in a separate process.

        Args:
            problem: The problem.
            folder: Temporary folder with the subfolder `submission`.
            package: Folder of the student edition.
            hidden: Paths that the submission must not read.
            timeout_s: Time limit of the judge [s].
            uid: User that runs the submission; None for this user.

        Returns:
            Grades by the tests' ids.
        """
        # Make the folders of the judge
        submission = folder / "submission"
        workspace = folder / problem.marker
        home = workspace / "home"
        tmp = workspace / "tmp"
        report = workspace / "report"
        judging = workspace / "judging"
        for path, mode in ((workspace, 0o755), (home, 0o700), (tmp, 0o711), (report, 0o700)):
            path.mkdir()
            path.chmod(mode)

        # Copy the tests; other users must not read the staff's files
        for path in judging_files(self.assignment, problem):
            copy_file(path, judging / path.relative_to(self.assignment.folder))
        make_readable(judging, ("test_*.py", STAFF_TEST, mutants.FILE_NAME, "solutions/*"))
        (report / "secret").write_text(str(self.seed), encoding="utf-8")

        # Compose the command
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

        # Run it. The scratch folder of other submissions is not readable
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

        # Read the report and keep the pictures
        lines = running.read_report(report / "lines.json")
        pictures = folder / "pictures"
        pictures.mkdir(mode=0o700, exist_ok=True)
        for path in sorted((report / "pictures").glob("*.png"))[:MAX_PICTURES]:
            if path.is_file() and not path.is_symlink() and path.stat().st_size <= MAX_PICTURE:
                shutil.copyfile(path, pictures / f"{problem.marker}-{path.name}")
        remove(workspace)
        if ended.reason:
            return grades_of(problem, lines, f"not judged: the problem {ended.reason}")

        # If no limit was exceeded, all tests have run; otherwise the machine failed
        missing = {test.id for test in problem.tests} - {line["id"] for line in lines}
        if ended.status not in (running.OK, running.SOME_FAILED) or missing:
            last = [line for line in ended.output.splitlines() if line.strip()][-1:]
            status = f"problem {problem.id}: the judge ended with status {ended.status}"
            raise processes.MachineFailure(": ".join([status, *last]))
        return grades_of(problem, lines, "")


@contextmanager
def open_grader(assignment: Assignment, seed_before: int = 0, **options: Any) -> Iterator[Grader]:
    """Make a grader with a scratch folder and a student edition, and remove both at the end.

    Args:
        assignment: Assignment with all its tests.
        seed_before: Seed of earlier results of the class, which is used again. 0 chooses a random
            seed.
        **options: `time_limit_s`, `memory_gib` and `format` of the grader.
    """
    seed = seed_of(assignment, seed_before)
    scratch = Path(tempfile.mkdtemp(prefix="tofrender-grade-")).resolve()
    try:
        scratch.chmod(0o711)
        (scratch / CLASS).mkdir(mode=0o700)
        edition.of_grading(assignment, scratch / "edition")
        compileall.compile_dir(scratch / "edition", quiet=1)
        make_readable(scratch / "edition")
        yield Grader(assignment, scratch, **options, seed=seed)
    finally:
        remove(scratch)


def seed_of(assignment: Assignment, before: int = 0) -> int:
    """Return the seed of the staff's tests.

    The seed comes from the file `seed.txt` of the assignment. Without this file, it is the seed of
    earlier results, or a random number. It must stay secret: all users can read the arguments of a
    command, and submissions can read the rubric, so the seed is in neither.

    Args:
        assignment: The assignment.
        before: Seed in earlier results of the class, 0 without earlier results.

    Raises:
        ValueError: The file does not contain a seed.
    """
    path = assignment.folder / SEED
    if not path.is_file():
        return before or 1 + secrets.randbelow(MAX_SEED)
    text = path.read_text(encoding="utf-8", errors="replace").strip()
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= MAX_SEED):
        raise ValueError(f"{path}: {text[:20]!r}: must be an integer from 1 to {MAX_SEED}")
    return int(text)


def remove(folder: Path) -> None:
    """Remove a folder, even if a submission has made deep or protected subfolders."""
    with suppress(RecursionError):
        shutil.rmtree(folder, ignore_errors=True)

    # Programs of the system remove what Python cannot
    if folder.exists() and os.name == "posix":
        for command in (["chmod", "-R", "u+rwX"], ["rm", "-rf"]):
            full = [*command, "--", str(folder)]
            subprocess.run(full, check=False, stderr=subprocess.DEVNULL)


def make_readable(folder: Path, secret: Sequence[str] = ()) -> None:
    """Let other users read a folder, because the worker may run as another user.

    Args:
        folder: The folder.
        secret: Patterns of files that other users must not read.
    """
    for inside, folders, names in os.walk(folder):
        for path in (Path(inside, name) for name in (*folders, *names)):
            is_secret = path.name in names and any(map(path.match, secret))
            shared = 0o055 if path.name in folders else 0o044
            path.chmod(0o600 if is_secret else path.stat().st_mode | shared)
    folder.chmod(0o755)


def judging_files(assignment: Assignment, problem: Problem | None = None) -> list[Path]:
    """Return the files of an assignment's folder that a judge needs.

    Args:
        assignment: The assignment.
        problem: Problem that is judged; None for all problems.
    """
    # Rubric and tests
    folder = assignment.folder
    rubric = assignment.rubric
    files = [folder / "rubric.toml", folder / "pytest.ini"]
    tests = sorted((folder / "tests").rglob("*"))
    files += [path for path in tests if path.is_file() and "__pycache__" not in path.parts]

    # Solutions that a student's test is applied to
    testing = [each for each in rubric.problems if each.tests_of and problem in (None, each)]
    if testing:
        tested = {each.tests_of for each in testing}
        names = [each.file for each in rubric.problems if each.id in tested]
        files += [folder / mutants.FILE_NAME, *(assignment.solutions / name for name in names)]
    return files


def _keep_pictures(made: Path, target: Path | None) -> None:
    """Copy the new pictures of a submission to a folder, and remove earlier pictures there.

    Args:
        made: Folder of the new pictures, which may not exist.
        target: Target folder; None for no pictures.
    """
    if target is None:
        return
    if made.is_dir() and any(made.iterdir()):
        with replacing(target, folder=True) as folder:
            shutil.copytree(made, folder, dirs_exist_ok=True)
    elif target.is_dir():
        remove(target)


def _environment(home: Path, tmp: Path, package: Path) -> dict[str, str]:
    """Return the environment variables of judge and worker, without private variables."""
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
    """Grade a copied submission, as described by a request of `classes.Class`.

    Args:
        request: Fields of the `Grader` and of the `Extracted` submission, and the arguments of
            `Grader.grade`. Paths are texts.
    """
    settings = request["grader"]
    assignment = Assignment(Path(settings["assignment"]))
    scratch = Path(settings["scratch"])
    grader = Grader(**settings | {"assignment": assignment, "scratch": scratch})
    hidden = [Path(path) for path in request["hidden"]]
    files = request["submission"]
    submission = Extracted(**files | {"folder": Path(files["folder"])})
    try:
        grader.grade(submission, Path(request["out"]), hidden, Path(request["pictures"]))
    except processes.MachineFailure as failure:
        sys.exit(str(failure))


if __name__ == "__main__":
    # End with the process of the class. A signal then ends the processes of the submission
    if sys.platform.startswith("linux"):
        sandbox.prctl(sandbox.SET_PDEATHSIG, signal.SIGTERM)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main(json.loads(sys.stdin.read()))
    except KeyboardInterrupt:
        sys.exit(130)
