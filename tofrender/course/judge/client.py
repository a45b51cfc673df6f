"""The judge's end of the wire: a submission as a worker that can be asked, killed and replaced."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

from ..assignments import PACKAGE, STAFF_TEST
from . import sandbox, wire
from .processes import Supervised

WORKER = "tofrender.course.judge.worker"
START_S = 90.0
TELLING = ("mutants.toml", "solutions")
"""What an assignment's folder may hold besides tests that no submission reads."""
MAX_REASON = 20_000
"""Characters of a reason that are kept."""
MAX_NAMES = 1000
REPLY = ("uses", "error")


class NoAnswer(AssertionError):
    """A submission did not answer; the reason is one that a student can read."""


@dataclass(frozen=True)
class Limits:
    """What a submission may use.

    Attributes:
        memory_bytes: Memory of the worker and what it starts, together; None is no limit.
        confine: Whether the worker may change nothing outside its scratch folder.
        uid: User that it becomes then, if this is root.
        hidden: Files that it cannot read then, besides the tests.
    """

    memory_bytes: int | None = None
    confine: bool = False
    uid: int | None = None
    hidden: tuple[str, ...] = ()


class Worker:
    """Runs one submission in processes of its own; a new one after each that dies.

    Args:
        assignment: Folder with `rubric.toml` and `tests/probes.py`.
        submission: Folder of the files to judge; None for the package itself.
        edition: Folder whose `tofrender` the submission sees; None for this one.
        limits: What it may use.
    """

    def __init__(
        self,
        assignment: Path,
        submission: Path | None,
        edition: Path | None = None,
        limits: Limits | None = None,
    ) -> None:
        self._assignment, self._submission = assignment, submission
        self._edition, self._limits = edition, limits or Limits()
        self._scratch = _folder_to_pass(None)
        self._place = self._scratch / "none yet"
        self._running: Supervised | None = None
        self._number = 0
        self.used: set[str] = set()
        """Names of the submission that the last question used, as it says itself."""

    # ------------------------------------------------------------------ for tests

    def ask(self, probe: str, arguments: dict[str, Any], timeout_s: float) -> Any:
        """Ask for what a probe returns.

        Args:
            probe: Name of a function of `tests/probes.py`.
            arguments: Its arguments, data as `wire` takes it.
            timeout_s: Longest time for the answer, the start of a new process not counted [s].

        Raises:
            NoAnswer: It failed, crashed, took too long or too much; says which.
        """
        running = self._running
        if running is None or running.process.poll() is not None:
            running = self._start()
        self._number += 1
        question = self._place / "questions" / f"{self._number}.npz"
        wire.write(question, [probe, arguments])
        with suppress(OSError):  # if it has died, the wait says how
            cast(IO[bytes], running.process.stdin).write(f"{self._number}\n".encode())
        reply = self._wait(running, timeout_s)
        with suppress(OSError):  # without a sandbox the submission may have removed it
            question.unlink()
        return self._taken(reply)

    def _taken(self, reply: Any) -> Any:
        """What a reply answers. The submission's process wrote it, so it may be anything."""
        uses, error = (reply.get(key) if isinstance(reply, dict) else None for key in REPLY)
        names = uses if isinstance(uses, list) else []
        self.used = {name[:100] for name in names[:MAX_NAMES] if isinstance(name, str)}
        if isinstance(error, str):
            raise NoAnswer(shortened(error))
        if not isinstance(reply, dict) or "answer" not in reply:
            raise NoAnswer("the reply is none that the worker writes")
        return reply["answer"]

    def close(self) -> None:
        """End the processes and remove their scratch folder."""
        self._end()
        shutil.rmtree(self._scratch, ignore_errors=True)

    @property
    def output(self) -> str:
        """The last that the submission printed."""
        return "" if self._running is None else self._running.output()

    # ------------------------------------------------------------------ processes

    def _start(self) -> Supervised:
        self._end()
        self._number = 0
        # Fresh folders each time: nothing that a worker has left meets the next one
        shutil.rmtree(self._place, ignore_errors=True)
        self._place = _folder_to_pass(self._scratch)
        for name in ("questions", "answers", "work", "tmp"):
            (self._place / name).mkdir()
        limits = self._limits
        tests = self._assignment / "tests"
        hidden = [*tests.glob("test_*.py"), *tests.glob(STAFF_TEST)]
        hidden += [*map(self._assignment.joinpath, TELLING)]
        confine = {
            "writable": [str(self._place / name) for name in ("answers", "work", "tmp")],
            "hidden": [*limits.hidden, *(str(path) for path in hidden if path.exists())],
            "memory_bytes": limits.memory_bytes,
            "uid": limits.uid,
            "reads_all": bool(limits.uid and sandbox.closed_to_others()),
        }
        settings = {
            "rubric": str(self._assignment / "rubric.toml"),
            "probes": str(tests / "probes.py"),
            "submission": None if self._submission is None else str(self._submission),
            "questions": str(self._place / "questions"),
            "answers": str(self._place / "answers"),
            "variant": os.environ.get("TOFRENDER_VARIANT"),
        }
        configuration = self._place / "questions" / "configuration.json"
        configuration.write_text(json.dumps(settings), encoding="utf-8")
        package = self._edition or PACKAGE.parent
        environment = os.environ | {"PYTHONPATH": str(package), "TMPDIR": str(self._place / "tmp")}
        command = [sys.executable, "-P", "-u", "-m", WORKER, str(configuration)]
        if limits.confine:
            environment["HOME"] = str(self._place / "tmp")  # Dr.Jit keeps its kernels there
            command = sandbox.command(confine, command)
        self._running = Supervised(
            command,
            cwd=self._place / "work",
            env=environment,
            stdin=subprocess.PIPE,
        )
        self._wait(self._running, START_S)
        return self._running

    def _wait(self, running: Supervised, timeout_s: float) -> Any:
        """The reply, or the reason why there is none."""
        answer = self._place / "answers" / f"{self._number}.npz"
        begin, pause, looked = time.monotonic(), 0.001, 0.0
        while not os.path.lexists(answer):
            if running.process.poll() is not None and not os.path.lexists(answer):
                raise NoAnswer(_death(running))
            now = time.monotonic()
            if now - begin > timeout_s:
                self._end()
                raise NoAnswer(f"no answer within {timeout_s:g} s; the process was ended")
            if now - looked > 0.1:
                looked = now
                if excess := running.excess(self._limits.memory_bytes, self._place):
                    self._end()
                    raise NoAnswer(f"{excess}; the process was ended")
            time.sleep(pause)
            pause = min(1.5 * pause, 0.02)
        if answer.is_symlink():
            raise NoAnswer("the answer is a link to another file")
        try:
            reply = wire.read(answer)
        except ValueError as error:
            raise NoAnswer(shortened(str(error))) from None
        with suppress(OSError):  # it may be a folder by now
            answer.unlink()
        return reply

    def _end(self) -> None:
        """End the worker and everything that it has started."""
        if self._running is not None:
            self._running.end()
            with suppress(OSError):
                cast(IO[bytes], self._running.process.stdin).close()
            self._running = None


def shortened(text: str) -> str:
    """The begin of a reason, as much of it as is kept."""
    return text if len(text) <= MAX_REASON else f"{text[:MAX_REASON]} [...]"


def _folder_to_pass(parent: Path | None) -> Path:
    """A new folder that others cannot list, but reach what is below it that is theirs."""
    folder = Path(tempfile.mkdtemp(prefix="tofrender-judge-", dir=parent))
    folder.chmod(0o711)
    return folder


def _death(running: Supervised) -> str:
    """What the end of the process means."""
    status = running.process.returncode
    if status < 0:
        name = signal.Signals(-status).name
        what = f"the process crashed ({name})"
        if name in ("SIGSEGV", "SIGBUS", "SIGABRT"):
            what += ": a gather or scatter outside of its array, or too little memory?"
    else:
        what = f"the process ended itself with status {status} and gave no answer"
    last_words = running.output(wait_s=1.0).strip().splitlines()[-3:]
    return "\n  ".join([what, *last_words])
