"""Grade a class. Each submission is graded in a separate process, several at a time.

All submissions are copied before the first one runs, to a folder that no submission can read or
change.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...runtime.child_processes import safe_environment
from ...runtime.progress import ProgressBar
from ..assignments import PACKAGE, Assignment
from ..rubric import Rubric
from . import unpacking
from .grading import Extracted, Grader
from .results import Results, finished, printable
from .roster import Marks, Member, Standing, write_csv

GRACE_S = 25.0  # time between the limit of a submission and the signal that ends its process [s]
END_WITHIN_S = 60.0  # time between this signal and killing the process [s]


@dataclass
class Class:
    """Submissions of a class of students."""

    grader: Grader
    folder: Path  # folder of the submissions
    members: Sequence[Member]
    csv: Path  # table with a line for each member, written after each submission
    out: Path  # folder of the results files, `NAME.json` for each submission
    marks: dict[str, Marks] | None = None  # by the members' ids; None without a sheet
    roster: bool = False  # whether the members come from a roster
    jobs: int = 1  # number of submissions that are graded at a time
    private: Sequence[Path] = ()  # further paths that submissions must not read
    # names of the table's columns, and the field in each, see `roster.columns`
    columns: Mapping[str, str] = field(default_factory=dict)
    # results by the member's id, without the tests
    content: dict[str, dict[str, Any]] = field(default_factory=dict)
    _processes: list[subprocess.Popen] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _stopped: bool = False

    def grade(self, say: Callable[[str], None]) -> None:
        """Grade all submissions. No submission can read another submission.

        Earlier results are kept, unless the submission or the tests have changed.

        Args:
            say: Function that gets a line of text about each submission.
        """
        # Copy all submissions, and read earlier results
        self.out.mkdir(parents=True, exist_ok=True)
        work = [(m, self._extract(m)) for m in self.members if m.submission is not None]
        empty = [(m, f) for m, f in work if isinstance(f, Extracted) and f.empty]
        if empty:
            shown = "; ".join(f"{printable(m.id, 80)}: {f.error}" for m, f in empty[:3])
            say(f"warning: {len(empty)} of {len(work)} submissions are empty: {shown}")

        # Grade them in parallel
        with (
            ThreadPoolExecutor(self.jobs) as pool,
            ProgressBar("Grading", len(work), unit="submission") as bar,
        ):
            runs = {pool.submit(self._grade, member, files): member for member, files in work}
            try:
                left = set(runs)
                while left:
                    done, left = wait(left, timeout=1.0, return_when=FIRST_COMPLETED)
                    for run in done:
                        # Store the result, and write the table
                        content, note = run.result()
                        member = runs[run]
                        self.content[member.id] = content
                        bar.update()
                        self.write()

                        # Report it
                        score = f"{content['score']:g}" if "score" in content else "none"
                        points = f"{score} of {self.rubric.points:g} points"
                        name = printable(self.results(member).stem, 100)
                        say(f"[{bar.n}/{len(work)}] {name}: {points}, {note}")
            except BaseException:
                # Also after Ctrl-C: end all processes, and start no other
                pool.shutdown(wait=False, cancel_futures=True)
                with self._lock:
                    self._stopped = True
                    for process in self._processes:
                        process.terminate()
                raise
        self.write()

    def write(self) -> None:
        """Write the CSV file with the graded members and the members without a submission."""
        done = [m for m in self.members if m.submission is None or m.id in self.content]
        class_ = map(self.standing, done)
        sheet = self.marks is not None
        write_csv(self.csv, self.rubric, class_, self.roster, sheet, self.columns)

    @property
    def not_graded(self) -> list[Member]:
        """Members without a grade, because the machine failed."""
        return [member for member in self.members if not self.standing(member).graded]

    @property
    def rubric(self) -> Rubric:
        """Rubric of the assignment."""
        return self.grader.assignment.rubric

    def standing(self, member: Member) -> Standing:
        """Return the points of a member."""
        marks = (self.marks or {}).get(member.id, Marks())
        return Standing(self.rubric, member, self.content.get(member.id), marks)

    def results(self, member: Member) -> Path:
        """Return the path of the results file of a member's submission."""
        assert member.submission is not None
        return self.out / f"{member.submission.name}.json"

    def tests(self, member: Member) -> dict[str, dict[str, Any]]:
        """Read the results of a member's tests, by the tests' ids; empty without a submission."""
        if member.submission is None:
            return {}
        tests = json.loads(self.results(member).read_text(encoding="utf-8"))["tests"]
        return {test["extra_data"]["test"]: test for test in tests}

    def pictures(self, member: Member) -> Path:
        """Return the folder for pictures of a member's submission, which may not exist."""
        assert member.submission is not None
        return self.out / f"{member.submission.name}.pictures"

    def _extract(self, member: Member) -> Extracted | dict[str, Any]:
        """Copy a member's submission, or return its earlier results without the tests."""
        assert member.submission is not None
        path = self.results(member)
        content = finished(path, self.rubric, self.grader.fingerprint)
        if content is not None and _changed(member.submission) <= path.stat().st_mtime:
            return _short(content)
        return self.grader.extract(member.submission)

    def _grade(
        self, member: Member, files: Extracted | dict[str, Any]
    ) -> tuple[dict[str, Any], str]:
        """Grade a copied submission in a separate process.

        Args:
            member: Member of the class.
            files: The copied files. If earlier results are passed instead, they are returned.

        Returns:
            The results without the entries of single tests, and a note with the duration or the
            problem.
        """
        if isinstance(files, dict):
            return files, "graded before"

        # Describe the work
        grader = self.grader
        path = self.results(member)
        private = (self.folder, self.out, self.csv, *self.private)
        request = {
            "grader": vars(grader) | {"assignment": grader.assignment.folder},
            "submission": vars(files),
            "out": path.absolute(),
            "hidden": [each.absolute() for each in private],
            "pictures": self.pictures(member).absolute(),
        }

        # Start the process. The request goes through standard input, because all users can read
        # the arguments of a command, and the seed is secret
        with self._lock:
            if self._stopped:
                raise KeyboardInterrupt
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", f"{__package__}.grading"],
                env=safe_environment(PYTHONPATH=str(PACKAGE.parent)),
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C reaches only this process, which ends the others
            )
            self._processes.append(process)

        # Wait for its end
        try:
            text = json.dumps(request, default=str).encode()
            errors = process.communicate(text, timeout=grader.time_limit_s + GRACE_S)[1]
        except subprocess.TimeoutExpired:
            process.terminate()
            errors = b"took too long"
            with suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=END_WITHIN_S)
            process.kill()
        finally:
            with self._lock:
                self._processes.remove(process)

        # Read the results; without results, write why, and continue with other submissions
        content = finished(path, self.rubric, grader.fingerprint)
        if content is None:
            last = errors.decode(errors="replace").strip().splitlines()[-1:] or ["it was ended"]
            results = Results(self.rubric, fingerprint=grader.fingerprint, seed=grader.seed)
            results.remarks = [f"not graded: {printable(last[0], 300)}"]
            with suppress(OSError):
                results.write(path)
            return _short(results.gradescope()), "not graded; the same command tries again"
        return _short(content), f"{content['execution_time']:.0f} s"


def submissions_in(
    folder: Path, assignment: Assignment, not_submissions: Iterable[Path] = ()
) -> list[Path]:
    """List the submissions of a class: folders, archives and single files, sorted by name.

    Hidden files, and files that operating systems leave behind, are ignored.

    Args:
        folder: Folder of the class.
        assignment: Assignment with the names that a single file can have.
        not_submissions: Paths in the folder that belong to the teacher, such as the roster.

    Raises:
        ValueError: The folder contains no submissions, or something in it is neither a folder, an
            archive, nor a file of the assignment. The message lists all of them. Also raised if two
            single files seem to belong to one student.
    """
    ignored = {path.resolve() for path in not_submissions}
    rubric = assignment.rubric
    found: list[Path] = []
    unknown: list[str] = []
    singles: dict[str, str] = {}
    for path in sorted(folder.iterdir()):
        hidden = path.name.startswith(".") or path.name.lower() in unpacking.LITTER
        if hidden or path.resolve() in ignored:
            continue
        if path.is_dir() or unpacking.is_archive(path):
            found.append(path)
            continue
        name = unpacking.asked_name(path.name, rubric.submit, rubric.files)
        if name is None:
            unknown.append(path.name)
            continue
        owner = path.name.removesuffix(name)
        if owner in singles and owner != path.name:
            raise ValueError(
                f"--all = {folder}: {singles[owner]!a} and {path.name!a} seem to be of one student;"
                " put the files of each student into a folder"
            )
        singles[owner] = path.name
        found.append(path)
    if unknown:
        listed = ", ".join(ascii(name) for name in unknown)
        raise ValueError(
            f"--all = {folder}: {len(unknown)} files are not understood: {listed}. "
            "Pass folders, zip or tar archives, or files with a name of the assignment; "
            "move other files elsewhere"
        )
    if not found:
        raise ValueError(f"--all = {folder}: contains no submissions")
    return found


def _short(content: dict[str, Any]) -> dict[str, Any]:
    """Return results without the tests, to save memory."""
    return {name: value for name, value in content.items() if name != "tests"}


def _changed(submission: Path) -> float:
    """Return the time of the latest change of a submission's files, in content or place.

    The time is in seconds since 1970.
    """
    newest = 0.0
    for folder, folders, names in [("", [], [submission]), *os.walk(submission)]:
        for name in (*folders, *names):
            with suppress(OSError):
                state = Path(folder, name).lstat()
                newest = max(newest, state.st_mtime, state.st_ctime)
    return newest
