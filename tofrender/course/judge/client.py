"""Client of the judge: a submission as a worker that can be asked, killed and replaced."""

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
START_S = 90.0
WAITING = 4  # seconds of the clock that count as a second of processor time
MAX_REASON = 20_000  # characters of a reason that are kept
MAX_NAMES = 1000


class NoAnswer(AssertionError):
    """A submission did not answer; the reason is one that a student can read."""


@dataclass(frozen=True)
class Limits:
    """Limits of a submission."""

    memory_bytes: int | None = None  # of the worker and its children together; None is no limit
    confine: bool = False  # whether the worker may change nothing outside its scratch folder
    uid: int | None = None  # user that it becomes then, if this is root
    hidden: tuple[str, ...] = ()  # files that it cannot read then, besides the tests


class Worker:
    """Runs a submission, by default the package itself, in a process; a new one after a crash.

    The assignment's folder has `rubric.toml` and `tests/probes.py`; `edition` is the folder whose
    `tofrender` the submission imports, and `forbids` has words of `forbidden` besides the rubric's.
    """

    def __init__(
        self,
        assignment: Path,
        submission: Path | None,
        edition: Path | None = None,
        limits: Limits | None = None,
        forbids: Collection[str] = (),
    ) -> None:
        self._assignment, self._submission = assignment, submission
        self._edition, self._limits = edition, limits or Limits()
        self._forbids = forbids
        self._scratch = _unlisted_folder(None)
        self._folder = self._scratch / "none yet"  # of the current process
        self._running: Supervised | None = None
        self._number = 0  # of the current question
        self.used: set[str] = set()  # names that the submission says it used for the last answer

    def ask(self, probe: str, arguments: dict[str, Any], timeout_s: float) -> Any:
        """Result of a function of `tests/probes.py`; arguments are data as `wire` takes it.

        NoAnswer with the reason if there is none; MachineFailure if the submission is not the
        reason. The start of a process does not count as time.
        """
        try:
            return self._ask(probe, arguments, timeout_s)
        except OSError as error:  # The submission changes nothing that this process reads or writes
            raise MachineFailure(f"the judge cannot work: {error}") from error

    def _ask(self, probe: str, arguments: dict[str, Any], timeout_s: float) -> Any:
        """Result of a probe."""
        running = self._running
        if running is None or running.process.poll() is not None:
            running = self._start()
        self._number += 1
        question = self._folder / "questions" / f"{self._number}.npz"
        wire.write(question, [probe, arguments])
        with suppress(OSError):  # if it has died, the wait says how
            cast(IO[bytes], running.process.stdin).write(f"{self._number}\n".encode())
        reply = self._wait(running, timeout_s)
        with suppress(OSError):  # without a sandbox the submission may have removed it
            question.unlink()
        return self._answer_in(reply)

    def _answer_in(self, reply: Any) -> Any:
        """Answer in a reply, which may be anything: the submission's process wrote it."""
        fields = reply if isinstance(reply, dict) else {}
        names = uses if isinstance(uses := fields.get("uses"), list) else []
        self.used = {name[:100] for name in names[:MAX_NAMES] if isinstance(name, str)}
        if isinstance(error := fields.get("error"), str):
            raise self._failure(error)
        if "answer" not in fields:
            raise NoAnswer("the reply is none that the worker writes")
        return fields["answer"]

    def close(self) -> None:
        """End the processes and remove their scratch folder."""
        self._end()
        shutil.rmtree(self._scratch, ignore_errors=True)

    def _start(self) -> Supervised:
        self._end()
        self._number = 0
        # New folders each time, so that a worker finds nothing of the one before
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder = _unlisted_folder(self._scratch)
        names = ("questions", "answers", "work", "tmp")
        questions, answers, work, tmp = folders = [self._folder / name for name in names]
        for folder in folders:
            folder.mkdir()
        settings = {
            "rubric": self._assignment / "rubric.toml",
            "probes": self._assignment / "tests" / "probes.py",
            "submission": self._submission,
            "questions": questions,
            "answers": answers,
            "variant": os.environ.get("TOFRENDER_VARIANT"),
        }
        configuration = questions / "configuration.json"
        package = self._edition or PACKAGE.parent
        environment = safe_environment(PYTHONPATH=str(package), TMPDIR=str(tmp))
        command = [sys.executable, "-P", "-u", "-m", WORKER, str(configuration)]
        if self._limits.confine:
            environment["HOME"] = str(tmp)  # Dr.Jit keeps its kernels there
            confinement = self._confinement(folders[1:])
            command = sandbox.command(confinement, command)
        content: dict[str, Any] = {name: value and str(value) for name, value in settings.items()}
        content["forbids"] = sorted(self._forbids)
        if self._limits.confine:
            content["readable"] = self._readable_later(confinement)
        configuration.write_text(json.dumps(content), encoding="utf-8")
        self._running = Supervised(
            command, cwd=work, env=environment, stdin=subprocess.PIPE, uid=self._limits.uid
        )
        # Nothing of the submission runs before the first reply
        try:
            self._wait(self._running, START_S)
        except NoAnswer as error:
            text = f"the process of a submission does not start: {error}"
            raise MachineFailure(" | ".join(text.splitlines())) from None
        return self._running

    def _failure(self, reason: str) -> NoAnswer | MachineFailure:
        """Blame the machine for a failure if it lacks something, otherwise the submission."""
        if lack := used_up(self._scratch):
            return MachineFailure(f"{lack}; a submission failed: {shortened(reason)[:200]}")
        return NoAnswer(shortened(reason))

    def _readable_later(self, confinement: dict[str, Any]) -> list[str]:
        """Paths that a submission can read, without files that bring forbidden features back."""
        words = {*rubrics.read(self._assignment).forbids, *self._forbids}
        files = forbidden.files(words, self._edition or PACKAGE.parent)
        if not files:
            return []
        hidden = [*confinement["hidden"], *files, *sandbox.HIDDEN_OF_SYSTEM]
        readable = [*confinement["readable"], *sandbox.READABLE_OF_SYSTEM]
        return [*sandbox.everything_but(hidden, readable), *map(str, confinement["writable"])]

    def _confinement(self, writable: list[Path]) -> dict[str, Any]:
        """Rights in the sandbox, which hides the assignment's tests and solutions."""
        limits = self._limits
        patterns = ("tests/test_*.py", f"tests/{STAFF_TEST}", mutants.FILE_NAME, "solutions")
        hidden = [path for pattern in patterns for path in self._assignment.glob(pattern)]
        package = self._edition or PACKAGE.parent
        needed = [*sandbox.python_folders(), package, self._assignment, self._folder / "questions"]
        if self._submission is not None:
            needed.append(self._submission)
        return {
            "writable": writable,
            "hidden": (*limits.hidden, *hidden, *sandbox.private()),
            "readable": needed,
            # Python looks for modules by the names in a folder
            "listed": (self._assignment / "tests", package),
            "memory_bytes": limits.memory_bytes,
            "uid": limits.uid,
            "reads_all": bool(limits.uid and sandbox.closed_to_others()),
        }

    def _wait(self, running: Supervised, timeout_s: float) -> Any:
        """Read the reply of the current question; NoAnswer with the reason if there is none."""
        answer = self._folder / "answers" / f"{self._number}.npz"
        begin, pause, looked = time.monotonic(), 0.001, 0.0
        processor_before_s = running.processor_s()
        while not os.path.lexists(answer):
            if running.process.poll() is not None and not os.path.lexists(answer):
                raise self._failure(_death(running))
            now = time.monotonic()
            if now - looked > 0.1:
                looked = now
                wall_s, used_s = now - begin, running.processor_s() - processor_before_s
                # the clock, unless others slow this process down; waiting counts in part
                if max(min(wall_s, used_s), wall_s / WAITING) > timeout_s:
                    self._end()
                    raise NoAnswer(f"no answer within {timeout_s:g} s; the process was ended")
                if excess := running.excess(self._limits.memory_bytes, self._folder):
                    self._end()
                    raise NoAnswer(f"{excess}; the process was ended")
            time.sleep(pause)
            pause = min(1.5 * pause, 0.02)
        if answer.is_symlink():
            raise NoAnswer("the answer is a link to another file")
        try:
            reply = wire.read(answer)
        except ValueError as error:
            raise self._failure(str(error)) from None
        with suppress(OSError):  # it may be a folder by now
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
    """Begin of a reason, up to `MAX_REASON` characters."""
    return text if len(text) <= MAX_REASON else f"{text[:MAX_REASON]} [...]"


def _unlisted_folder(parent: Path | None) -> Path:
    """New folder that others cannot list, but through which they reach their own."""
    folder = Path(tempfile.mkdtemp(prefix="tofrender-judge-", dir=parent))
    folder.chmod(0o711)
    return folder


def _death(running: Supervised) -> str:
    """Explanation of the end of the process."""
    status = running.process.returncode
    text = f"the process ended itself with status {status} and gave no answer"
    if status < 0:
        name = signal.Signals(-status).name
        text = f"the process crashed ({name})"
        if name in ("SIGSEGV", "SIGBUS", "SIGABRT"):
            text += ": a gather or scatter outside of its array, or too little memory?"
    return "\n  ".join([text, *running.output(wait_s=1.0).strip().splitlines()[-3:]])
