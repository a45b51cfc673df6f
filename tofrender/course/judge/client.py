"""Client of the judge: runs a submission in a worker process, which can be asked and replaced."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

from ...runtime.child_processes import safe_environment
from .. import mutants, rubric as rubrics
from ..assignments import PACKAGE
from ..rubric import STAFF_TEST
from . import forbidden, sandbox, wire
from .processes import MachineFailure, Supervised, used_up

WORKER = "tofrender.course.judge.worker"
START_S = 90.0  # longest time in which a worker must be ready [s]
LOOK_EVERY_S = 0.1  # time between two checks of the limits [s]
LONGEST_PAUSE_S = 0.02  # time between two looks for the answer [s]
WALL_PER_PROCESSOR_S = 4  # a worker that uses no processor gets this multiple of its time limit
MAX_REASON = 20_000  # longest reason that is kept [characters]
MAX_NAMES = 1000  # largest number of used names that is read from a reply


class NoAnswer(AssertionError):
    """A submission did not answer. The message is for the student."""


@dataclass(frozen=True)
class SubmissionLimits:
    """Limits of a submission."""

    memory_bytes: int | None = (
        None  # memory of the worker and its children together; None: no limit
    )
    confine: bool = False  # whether the worker runs in the sandbox
    uid: int | None = None  # user that runs the worker in the sandbox, if this process is root's
    hidden: tuple[str, ...] = ()  # files that the sandbox hides in addition to the tests


class Worker:
    """Runs a submission in a process, and starts a new process after a crash.

    Args:
        assignment: Folder with `rubric.toml` and `tests/probes.py`.
        submission: Folder of the student's files; None for the package itself.
        edition: Folder with the package `tofrender` that the submission imports; by default the
            folder of this package.
        limits: Limits of the submission; by default unlimited.
        forbids: Forbidden features (see `forbidden`), in addition to the rubric's.
    """

    def __init__(
        self,
        assignment: Path,
        submission: Path | None,
        edition: Path | None = None,
        limits: SubmissionLimits | None = None,
        forbids: Collection[str] = (),
    ) -> None:
        self._assignment = assignment
        self._submission = submission
        self._edition = edition
        self._limits = limits or SubmissionLimits()
        self._forbids = forbids
        self._scratch = _unlisted_folder(None)
        self._folder = self._scratch / "none yet"  # folder of the current process
        self._running: Supervised | None = None
        self._number = 0  # number of the current question
        self.used: set[str] = set()  # names that the submission used for the last answer

    def ask(self, probe: str, arguments: dict[str, Any], timeout_s: float) -> Any:
        """Call a probe with the submission and return its result.

        Args:
            probe: Name of a function in `tests/probes.py`.
            arguments: Keyword arguments of the probe: plain values or arrays, see `wire`.
            timeout_s: Longest time of the answer [s]. The start of a process does not count.

        Raises:
            NoAnswer: The submission failed; the message is for the student.
            MachineFailure: The machine failed, so the submission cannot be judged.
        """
        try:
            return self._ask(probe, arguments, timeout_s)
        except OSError as error:  # The submission cannot cause errors in this process's files
            raise MachineFailure(f"the judge cannot work: {error}") from error

    def _ask(self, probe: str, arguments: dict[str, Any], timeout_s: float) -> Any:
        """Send a question to the worker and return the answer, see `ask`."""
        # Start a worker, if none is running
        running = self._running
        if running is None or running.process.poll() is not None:
            running = self._start()

        # Write the question, and send its number
        self._number += 1
        question = self._folder / "questions" / f"{self._number}.npz"
        wire.write(question, [probe, arguments])
        with suppress(OSError):  # If the worker has died, `_wait` finds the reason
            cast(IO[bytes], running.process.stdin).write(f"{self._number}\n".encode())

        # Wait for the reply
        reply = self._wait(running, timeout_s)
        with suppress(OSError):  # Without a sandbox, the submission may have removed the file
            question.unlink()
        return self._answer_in(reply)

    def _answer_in(self, reply: Any) -> Any:
        """Return the answer in a reply.

        The reply may be any value, because the process of the submission wrote it.
        """
        fields = reply if isinstance(reply, dict) else {}
        names = uses if isinstance(uses := fields.get("uses"), list) else []
        self.used = {name[:100] for name in names[:MAX_NAMES] if isinstance(name, str)}
        if isinstance(error := fields.get("error"), str):
            raise self._failure(error)
        if "answer" not in fields:
            raise NoAnswer("the reply does not have the worker's format")
        return fields["answer"]

    def close(self) -> None:
        """End the processes and remove their scratch folder."""
        self._end()
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _start(self) -> Supervised:
        """Start a worker, and wait until it is ready."""
        # Make new folders each time, so that a worker finds nothing of the previous one
        self._end()
        self._number = 0
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder = _unlisted_folder(self._scratch)
        questions = self._folder / "questions"
        answers = self._folder / "answers"
        work = self._folder / "work"
        tmp = self._folder / "tmp"
        for folder in (questions, answers, work, tmp):
            folder.mkdir()

        # Collect the settings of the worker
        settings = {
            "rubric": self._assignment / "rubric.toml",
            "probes": self._assignment / "tests" / "probes.py",
            "submission": self._submission,
            "questions": questions,
            "answers": answers,
            "variant": os.environ.get("TOFRENDER_VARIANT"),
        }
        content: dict[str, Any] = {name: value and str(value) for name, value in settings.items()}
        content["forbids"] = sorted(self._forbids)
        configuration = questions / "configuration.json"

        # Confine the process, if wanted
        package = self._edition or PACKAGE.parent
        environment = safe_environment(PYTHONPATH=str(package), TMPDIR=str(tmp))
        command = [sys.executable, "-P", "-u", "-m", WORKER, str(configuration)]
        if self._limits.confine:
            environment["HOME"] = str(tmp)  # Dr.Jit stores its kernels there
            confinement = self._confinement([answers, work, tmp])
            command = sandbox.command(confinement, command)
            content["readable"] = self._readable_later(confinement)

        # Start the process
        configuration.write_text(json.dumps(content), encoding="utf-8")
        self._running = Supervised(
            command, cwd=work, env=environment, stdin=subprocess.PIPE, uid=self._limits.uid
        )

        # The submission does not run before the first reply, so it cannot cause a failure here
        try:
            self._wait(self._running, START_S)
        except NoAnswer as error:
            text = f"the process of a submission does not start: {error}"
            raise MachineFailure(" | ".join(text.splitlines())) from None
        return self._running

    def _failure(self, reason: str) -> NoAnswer | MachineFailure:
        """Return the exception for a failure.

        If the machine has too little memory or disk space, the submission is not to blame.
        """
        if problem := used_up(self._scratch):
            return MachineFailure(f"{problem}; a submission failed: {shortened(reason)[:200]}")
        return NoAnswer(shortened(reason))

    def _readable_later(self, confinement: dict[str, Any]) -> list[str]:
        """Return the paths that the submission may read after the worker has started.

        Files that would bring forbidden features back are left out. An empty list means that the
        worker does not restrict reading any further.
        """
        words = {*rubrics.read(self._assignment).forbids, *self._forbids}
        files = forbidden.files(words, self._edition or PACKAGE.parent)
        if not files:
            return []
        hidden = [*confinement["hidden"], *files, *sandbox.HIDDEN_OF_SYSTEM]
        readable = [*confinement["readable"], *sandbox.READABLE_OF_SYSTEM]
        return [*sandbox.everything_but(hidden, readable), *map(str, confinement["writable"])]

    def _confinement(self, writable: list[Path]) -> dict[str, Any]:
        """Return the arguments of `sandbox.confine`, which hide tests and solutions."""
        limits = self._limits
        patterns = ("tests/test_*.py", f"tests/{STAFF_TEST}", mutants.FILE_NAME, "solutions")
        hidden = [path for pattern in patterns for path in self._assignment.glob(pattern)]

        # Folders that the worker needs, even inside hidden folders
        package = self._edition or PACKAGE.parent
        needed = [*sandbox.python_folders(), package, self._assignment, self._folder / "questions"]
        if self._submission is not None:
            needed.append(self._submission)
        return {
            "writable": writable,
            "hidden": (*limits.hidden, *hidden, *sandbox.private()),
            "readable": needed,
            # Python lists a folder to find the modules in it
            "listed": (self._assignment / "tests", package),
            "memory_bytes": limits.memory_bytes,
            "uid": limits.uid,
            "reads_all": bool(limits.uid and sandbox.closed_to_others()),
        }

    def _wait(self, running: Supervised, timeout_s: float) -> Any:
        """Wait for the reply to the current question, and return it.

        Raises:
            NoAnswer: The worker died, exceeded a limit, or wrote something else.
            MachineFailure: The worker died, and the machine has too little memory or disk space.
        """
        answer = self._folder / "answers" / f"{self._number}.npz"
        begin = time.monotonic()
        last_look = 0.0
        pause_s = 0.001
        processor_before_s = running.processor_s()
        while not os.path.lexists(answer):
            # Has the worker died?
            if running.process.poll() is not None and not os.path.lexists(answer):
                raise self._failure(_death(running))

            # Has it exceeded a limit?
            now = time.monotonic()
            if now - last_look > LOOK_EVERY_S:
                last_look = now
                wall_s = now - begin
                used_s = running.processor_s() - processor_before_s

                # On a busy machine the processor time counts. Waiting counts in part
                counted_s = max(min(wall_s, used_s), wall_s / WALL_PER_PROCESSOR_S)
                if counted_s > timeout_s:
                    self._end()
                    raise NoAnswer(f"no answer within {timeout_s:g} s; the process was ended")
                if excess := running.excess(self._limits.memory_bytes, self._folder):
                    self._end()
                    raise NoAnswer(f"{excess}; the process was ended")
            time.sleep(pause_s)
            pause_s = min(1.5 * pause_s, LONGEST_PAUSE_S)

        # Read the reply
        if answer.is_symlink():
            raise NoAnswer("the answer is a link to another file")
        try:
            reply = wire.read(answer)
        except ValueError as error:
            raise self._failure(str(error)) from None
        with suppress(OSError):  # The submission may have replaced it by a folder
            answer.unlink()
        return reply

    def _end(self) -> None:
        """End the worker and all its children."""
        if self._running is not None:
            self._running.end()
            with suppress(OSError):
                cast(IO[bytes], self._running.process.stdin).close()
            self._running = None


def shortened(text: str) -> str:
    """Shorten a reason to `MAX_REASON` characters."""
    return text if len(text) <= MAX_REASON else f"{text[:MAX_REASON]} [...]"


def _unlisted_folder(parent: Path | None) -> Path:
    """Make a temporary folder that other users can enter, but not list."""
    folder = Path(tempfile.mkdtemp(prefix="tofrender-judge-", dir=parent))
    folder.chmod(0o711)
    return folder


def _death(running: Supervised) -> str:
    """Explain why the process ended, with the last lines of its output."""
    status = running.process.returncode
    text = f"the process ended itself with status {status} and gave no answer"
    if status < 0:
        name = signal.Signals(-status).name
        text = f"the process crashed ({name})"
        if name in ("SIGSEGV", "SIGBUS", "SIGABRT"):
            text += "; possible causes: a gather or scatter outside its array, too little memory"
    return "\n  ".join([text, *running.output(wait_s=1.0).strip().splitlines()[-3:]])
