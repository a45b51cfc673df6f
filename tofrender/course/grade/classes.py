"""Grade a class: each submission in a process of its own, several at a time.

All of them are copied before the first runs, to where no submission can read or write.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...runtime.progress import progress_bar
from ..assignments import PACKAGE
from .grading import Grader, Taken
from .results import Results, finished, printable, seed_of
from .roster import Marks, Member
from .standing import Standing, write_csv

MORE_S = 25.0
"""Time that the process of a submission may take beyond the limit, before it is told to end [s]."""
END_WITHIN_S = 60.0
"""Time that it then has to end what it has started [s]."""


@dataclass
class Class:
    """A class that is graded.

    Attributes:
        grader: What grades.
        folder: Folder of the submissions.
        members: Who is in it.
        csv: File to write after each submission, a line for each member.
        out: Folder of the results files, `NAME.json` for each submission.
        marks: What people have graded, by the members' ids; None without a sheet.
        roster: Whether the members are those of a roster.
        jobs: Submissions that are graded at a time.
        private: What no submission may read, besides the class and what comes of it.
        content: What came of each, by the member's id, without the tests.
    """

    grader: Grader
    folder: Path
    members: Sequence[Member]
    csv: Path
    out: Path
    marks: dict[str, Marks] | None = None
    roster: bool = False
    jobs: int = 1
    private: Sequence[Path] = ()
    content: dict[str, dict[str, Any]] = field(default_factory=dict)

    def grade(self, say: Callable[[str], None]) -> None:
        """Grade all that was handed in, none of which sees another.

        What is graded already is kept, unless the submission or the tests have changed since.

        Args:
            say: Gets a line about each.
        """
        self.out.mkdir(parents=True, exist_ok=True)
        to_do = [member for member in self.members if member.submission is not None]
        work = {member.id: self._take(member) for member in to_do}
        running: list[subprocess.Popen] = []
        lock = threading.Lock()
        stopped = threading.Event()
        with (
            ThreadPoolExecutor(self.jobs) as pool,
            progress_bar("Grading", len(to_do), unit="submission") as bar,
        ):
            runs = {
                pool.submit(self._grade, each, work[each.id], running, lock, stopped): each
                for each in to_do
            }
            try:
                left = set(runs)
                while left:
                    done, left = wait(left, timeout=1.0, return_when=FIRST_COMPLETED)
                    for run in done:
                        content, how = run.result()
                        member = runs[run]
                        self.content[member.id] = content
                        bar.update()
                        self.write()
                        say(self._line(member, content, how, bar.n, len(to_do)))
            except BaseException:
                stopped.set()
                pool.shutdown(wait=False, cancel_futures=True)
                with lock:
                    for process in running:
                        process.terminate()
                raise
        self.write()

    def write(self) -> None:
        """Write the CSV file: those that are graded, and those who handed in nothing."""
        done = [m for m in self.members if m.submission is None or m.id in self.content]
        standings = map(self.standing, done)
        sheet = self.marks is not None
        write_csv(
            self.csv, self.grader.assignment.rubric, standings, roster=self.roster, sheet=sheet
        )

    def standing(self, member: Member) -> Standing:
        """What a member gets."""
        marks = (self.marks or {}).get(member.id, Marks())
        rubric = self.grader.assignment.rubric
        return Standing(rubric, member, self.content.get(member.id), marks)

    def results(self, member: Member) -> Path:
        """The results file of what a member handed in."""
        assert member.submission is not None
        return self.out / f"{member.submission.name}.json"

    def pictures(self, member: Member) -> Path:
        """The folder of pictures of what a member handed in, which need not exist."""
        assert member.submission is not None
        return self.out / f"{member.submission.name}.pictures"

    # ------------------------------------------------------------------------------ parts

    def _take(self, member: Member) -> Taken | dict[str, Any]:
        """A copy of what a member handed in, or results of before, without the tests."""
        assert member.submission is not None
        path = self.results(member)
        content = finished(path, self.grader.assignment.rubric, self.grader.fingerprint)
        if content is not None and _changed(member.submission) <= path.stat().st_mtime:
            return _short(content)
        return self.grader.take(member.submission)

    def _grade(
        self,
        member: Member,
        work: Taken | dict[str, Any],
        running: list[subprocess.Popen],
        lock: threading.Lock,
        stopped: threading.Event,
    ) -> tuple[dict[str, Any], str]:
        """Results of a member, without the tests, and how they came."""
        if isinstance(work, dict):
            return work, "graded before"
        rubric, fingerprint = self.grader.assignment.rubric, self.grader.fingerprint
        seed = self.grader.seed
        path = self.results(member)
        private = (self.folder, self.out, self.csv, *self.private)
        wishes = {
            "assignment": str(self.grader.assignment.folder),
            "scratch": str(self.grader.scratch),
            "time_limit_s": self.grader.time_limit_s,
            "memory_gib": self.grader.memory_gib,
            "seed": seed,
            "taken": str(work.folder),
            "refused": work.refused,
            "out": str(path.absolute()),
            "hidden": [str(each.absolute()) for each in private],
            "pictures": str(self.pictures(member).absolute()),
        }
        command = [sys.executable, "-P", "-m", f"{__package__}.one"]
        with lock:
            if stopped.is_set():
                raise KeyboardInterrupt
            process = subprocess.Popen(
                command,
                env=os.environ | {"PYTHONPATH": str(PACKAGE.parent)},
                stdin=subprocess.PIPE,  # all can read a command's arguments, and the seed is secret
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C is ours to pass on
            )
            running.append(process)
        try:
            asked = json.dumps(wishes).encode()
            said = process.communicate(asked, timeout=self.grader.time_limit_s + MORE_S)[1]
        except subprocess.TimeoutExpired:
            process.terminate()
            said = b"took too long"
            with suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=END_WITHIN_S)
            process.kill()
        finally:
            with lock:
                running.remove(process)
        content = finished(path, rubric, fingerprint)
        if content is None:  # whatever has happened to it, the others go on
            last = said.decode(errors="replace").strip().splitlines()[-1:] or ["it was ended"]
            results = Results(rubric, fingerprint=fingerprint, seed=seed)
            results.remarks = [f"not graded: {printable(last[0], 300)}"]
            with suppress(OSError):
                results.write(path)
            return _short(results.gradescope()), "not graded; the same command tries again"
        return _short(content), f"{content['execution_time']:.0f} s"

    def _line(
        self, member: Member, content: dict[str, Any], how: str, number: int, count: int
    ) -> str:
        points = f"{content['score']:g} of {self.grader.assignment.rubric.points:g} points"
        assert member.submission is not None
        name = printable(member.submission.name, 100)
        return f"[{number}/{count}] {name}: {points}, {how}"


def submissions_in(folder: Path, *others: Path) -> list[Path]:
    """The folders and zips of a folder, by name.

    Args:
        folder: Holds them.
        others: What is made beside them, and is none.

    Raises:
        ValueError: There are none.
    """
    made = {path.resolve() for path in others}
    found = [
        path
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".")
        and (path.is_dir() or path.suffix.lower() == ".zip")
        and path.resolve() not in made
    ]
    if not found:
        raise ValueError(f"--all = {folder}: holds no folders and no zips")
    return found


def seed_of_before(out: Path) -> int:
    """The seed with which some of a class were graded, so that all of it gets the same; or 0."""
    found = (seed_of(path) for path in sorted(out.glob("*.json")))
    return next(filter(None, found), 0)


def _short(content: dict[str, Any]) -> dict[str, Any]:
    """Results without the tests: those of a large class take little memory."""
    return {name: value for name, value in content.items() if name != "tests"}


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
