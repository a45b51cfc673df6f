"""Grade a class: each submission in a process of its own, several at a time.

All of them are copied before the first runs, to a folder that no submission can read or write.
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

MORE_S = 25.0  # time beyond the limit before the process of a submission is told to end [s]
END_WITHIN_S = 60.0  # time that it then has to end its children [s]


@dataclass
class Class:
    """A class that is graded."""

    grader: Grader
    folder: Path  # of the submissions
    members: Sequence[Member]
    csv: Path  # written after each submission, a line for each member
    out: Path  # folder of the results files, `NAME.json` for each submission
    marks: dict[str, Marks] | None = None  # by the members' ids; None without a sheet
    roster: bool = False  # whether the members are those of a roster
    jobs: int = 1  # submissions that are graded at a time
    private: Sequence[Path] = ()  # not readable by submissions, besides the class and its results
    columns: Mapping[str, str] = field(default_factory=dict)  # of the CSV, see `roster.columns`
    # results by the member's id, without the tests
    content: dict[str, dict[str, Any]] = field(default_factory=dict)
    _processes: list[subprocess.Popen] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _stopped: bool = False

    def grade(self, say: Callable[[str], None]) -> None:
        """Grade all submissions, none of which sees another; `say` gets a line about each.

        Earlier results are kept, unless the submission or the tests have changed since.
        """
        self.out.mkdir(parents=True, exist_ok=True)
        work = [(m, self._extract(m)) for m in self.members if m.submission is not None]
        empty = [(m, f) for m, f in work if isinstance(f, Extracted) and f.empty]
        if empty:
            shown = "; ".join(f"{printable(m.id, 80)}: {f.error}" for m, f in empty[:3])
            say(f"warning: {len(empty)} of {len(work)} submissions are empty: {shown}")
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
                        content, note = run.result()
                        member = runs[run]
                        self.content[member.id] = content
                        bar.update()
                        self.write()
                        score = f"{content['score']:g}" if "score" in content else "none"
                        points = f"{score} of {self.rubric.points:g} points"
                        name = printable(self.results(member).stem, 100)
                        say(f"[{bar.n}/{len(work)}] {name}: {points}, {note}")
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                with self._lock:
                    self._stopped = True
                    for process in self._processes:
                        process.terminate()
                raise
        self.write()

    def write(self) -> None:
        """Write the CSV file: members that are graded, and those without a submission."""
        done = [m for m in self.members if m.submission is None or m.id in self.content]
        class_ = map(self.standing, done)
        sheet = self.marks is not None
        write_csv(self.csv, self.rubric, class_, self.roster, sheet, self.columns)

    @property
    def not_graded(self) -> list[Member]:
        """Members whose submissions the machine has failed to grade."""
        return [member for member in self.members if not self.standing(member).graded]

    @property
    def rubric(self) -> Rubric:
        """Rubric of the assignment."""
        return self.grader.assignment.rubric

    def standing(self, member: Member) -> Standing:
        """Points of a member."""
        marks = (self.marks or {}).get(member.id, Marks())
        return Standing(self.rubric, member, self.content.get(member.id), marks)

    def results(self, member: Member) -> Path:
        """Results file of a member's submission."""
        assert member.submission is not None
        return self.out / f"{member.submission.name}.json"

    def tests(self, member: Member) -> dict[str, dict[str, Any]]:
        """Results of each test by its id, as in `results.json`; empty without a submission."""
        if member.submission is None:
            return {}
        tests = json.loads(self.results(member).read_text(encoding="utf-8"))["tests"]
        return {test["extra_data"]["test"]: test for test in tests}

    def pictures(self, member: Member) -> Path:
        """Folder of pictures of a member's submission, which need not exist."""
        assert member.submission is not None
        return self.out / f"{member.submission.name}.pictures"

    def _extract(self, member: Member) -> Extracted | dict[str, Any]:
        """A copy of a member's submission, or earlier results, without the tests."""
        assert member.submission is not None
        path = self.results(member)
        content = finished(path, self.rubric, self.grader.fingerprint)
        if content is not None and _changed(member.submission) <= path.stat().st_mtime:
            return _short(content)
        return self.grader.extract(member.submission)

    def _grade(
        self, member: Member, files: Extracted | dict[str, Any]
    ) -> tuple[dict[str, Any], str]:
        """Results of a member, without the tests, and a note on their origin."""
        if isinstance(files, dict):
            return files, "graded before"
        grader, path = self.grader, self.results(member)
        private = (self.folder, self.out, self.csv, *self.private)
        request = {
            "grader": vars(grader) | {"assignment": grader.assignment.folder},
            "submission": vars(files),
            "out": path.absolute(),
            "hidden": [each.absolute() for each in private],
            "pictures": self.pictures(member).absolute(),
        }
        with self._lock:
            if self._stopped:
                raise KeyboardInterrupt
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", f"{__package__}.grading"],
                env=safe_environment(PYTHONPATH=str(PACKAGE.parent)),
                stdin=subprocess.PIPE,  # all can read a command's arguments, and the seed is secret
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is ours to pass on
            )
            self._processes.append(process)
        try:
            text = json.dumps(request, default=str).encode()
            errors = process.communicate(text, timeout=grader.time_limit_s + MORE_S)[1]
        except subprocess.TimeoutExpired:
            process.terminate()
            errors = b"took too long"
            with suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=END_WITHIN_S)
            process.kill()
        finally:
            with self._lock:
                self._processes.remove(process)
        content = finished(path, self.rubric, grader.fingerprint)
        if content is None:  # whatever has happened to it, the others go on
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
        assignment: Assignment whose files a single file can stand for.
        not_submissions: Paths in the folder that belong to the teacher, such as the roster.

    Raises:
        ValueError: There is no submission, or something in the folder is neither a folder, an
            archive, nor a file of the assignment. The message lists all of them.
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
    """Results without the tests: those of a large class take little memory."""
    return {name: value for name, value in content.items() if name != "tests"}


def _changed(submission: Path) -> float:
    """Latest change of a file of a submission, in content or place [s since 1970]."""
    newest = 0.0
    for folder, folders, names in [("", [], [submission]), *os.walk(submission)]:
        for name in (*folders, *names):
            with suppress(OSError):
                state = Path(folder, name).lstat()
                newest = max(newest, state.st_mtime, state.st_ctime)
    return newest
