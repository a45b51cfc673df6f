"""Run a command that may misbehave: for a limited time, with limited memory, leaving nothing.

What it starts is found even if it hides in a session of its own and outlives its parent: this
process adopts orphans (`PR_SET_CHILD_SUBREAPER`, Linux), so that all stays below it in the tree.
Nothing that is not below it is ever ended.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import psutil

KEPT_OUTPUT = 20_000
MAX_PROCESSES = 200
"""Most processes that a command may have at a time."""
LOOK_EVERY_S = 0.2
SET_CHILD_SUBREAPER = 36


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        reason: Why it was ended, "" if it ended by itself.
        status: Exit status, negative for a signal.
        output: The last that it and its children printed.
        seconds: How long it ran [s].
    """

    reason: str
    status: int
    output: str
    seconds: float


def run(
    command: Sequence[str],
    *,
    timeout_s: float,
    memory_bytes: int,
    cwd: str | os.PathLike,
    env: dict[str, str],
) -> Ended:
    """Run a command and end all that it has started, whatever happens.

    Args:
        command: Program and arguments.
        timeout_s: Longest time [s].
        memory_bytes: Most memory of everything that it starts together [bytes].
        cwd: Working folder.
        env: Environment.

    Example:
        >>> environment = dict(os.environ)
        >>> ended = run(
        ...     ["sh", "-c", "sleep 9 & echo started"],
        ...     timeout_s=5,
        ...     memory_bytes=1 << 30,
        ...     cwd=".",
        ...     env=environment,
        ... )
        >>> ended.status, ended.output.split(), ended.seconds < 5
        (0, ['started'], True)
    """
    _adopt_orphans()
    others = set(psutil.Process().children())
    begin = time.monotonic()
    process = subprocess.Popen(
        command,
        cwd=cwd,
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        bufsize=0,
        start_new_session=True,
    )
    drain = _Drain(process)
    reason = ""
    try:
        while not reason:
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_EVERY_S)
                break
            if time.monotonic() - begin > timeout_s:
                reason = f"took more than {timeout_s:.0f} s"
            else:
                reason = _excess(_descendants(others), memory_bytes)
    finally:
        process.kill()
        process.wait()
        end_descendants(others)
    return Ended(reason, process.returncode, drain.text(), time.monotonic() - begin)


def end_descendants(others: set[psutil.Process] | None = None, within_s: float = 20.0) -> None:
    """End every process below this one, those that they start meanwhile too.

    Args:
        others: Children that stay, with all that is below them.
        within_s: Longest time to try [s].

    Raises:
        RuntimeError: Some are still there after that time.
    """
    deadline = time.monotonic() + within_s
    while below := _descendants(others or set()):
        for action in ("suspend", "kill"):  # first nobody forks any more
            for process in below:
                with suppress(psutil.Error):
                    getattr(process, action)()
        for process in below:
            with suppress(ChildProcessError):
                os.waitpid(process.pid, getattr(os, "WNOHANG", 0))
        if time.monotonic() > deadline:
            raise RuntimeError(f"{len(below)} processes of a submission cannot be ended")
        time.sleep(0.005)


def _descendants(others: set[psutil.Process]) -> list[psutil.Process]:
    """All processes below this one, but for `others` and what is below them."""
    children = psutil.Process().children(recursive=True)
    parents = {child.pid: _parent(child) for child in children}
    kept = {process.pid for process in others}

    def is_kept(pid: int | None) -> bool:
        while pid is not None and pid not in kept:
            pid = parents.get(pid)
        return pid is not None

    return [child for child in children if not is_kept(child.pid)]


def _parent(process: psutil.Process) -> int | None:
    with suppress(psutil.Error):
        return process.ppid()
    return None


def _excess(below: list[psutil.Process], memory_bytes: int) -> str:
    """What these processes use too much of, "" if nothing."""
    if len(below) > MAX_PROCESSES:
        return f"started more than {MAX_PROCESSES} processes"
    used, shares = 0, len(below) > 3  # forked processes share most of what they seem to use
    for process in below:
        with suppress(psutil.Error):
            used += process.memory_info().rss
    if used > memory_bytes and shares:
        used = 0
        for process in below:
            with suppress(psutil.Error):
                used += getattr(process.memory_full_info(), "pss", 0)
    return f"used more than {memory_bytes / 2**30:g} GiB of memory" if used > memory_bytes else ""


def _adopt_orphans() -> None:
    """Become the parent of what descendants leave behind when they end."""
    if sys.platform.startswith("linux"):
        word = ctypes.c_ulong
        ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, word(1), word(0), word(0), word(0))


class _Drain(threading.Thread):
    """Read all that a process prints and keep the end of it."""

    def __init__(self, process: subprocess.Popen) -> None:
        super().__init__(daemon=True)
        self._pipe, self._kept = process.stdout, b""
        self.start()

    def run(self) -> None:
        """Read until nobody can write any more."""
        assert self._pipe is not None
        with self._pipe:
            while chunk := self._pipe.read(1 << 16):
                self._kept = (self._kept + chunk)[-KEPT_OUTPUT:]

    def text(self) -> str:
        """The end of the output, once all writers have ended."""
        self.join(5)
        return self._kept.decode(errors="replace")
