"""Run untrusted commands with limited memory and time, and end all their children.

A child is found even in a session of its own and after its parent's end: this process adopts
orphans (`PR_SET_CHILD_SUBREAPER`, Linux). Nothing that is not below it is ever ended.
"""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from . import sandbox

KEPT_OUTPUT = 20_000
MACHINE_FAILED = 70  # exit status of a judge, as EX_SOFTWARE of sysexits.h
LEAST_BYTES = 64 << 20  # free memory, and free space on the disk
LEAST_FILES = 1000  # free inodes of the disk
MAX_PROCESSES = 200  # of a command at a time
MAX_WRITTEN = 4 << 30  # bytes of files that a command may leave in a watched folder
MAX_FILES = 2000  # files, links and folders that a command may leave in a watched folder
LOOK_EVERY_S = 0.2
END_WITHIN_S = 20.0
SET_CHILD_SUBREAPER = 36


class MachineFailure(RuntimeError):
    """A submission cannot be graded because the machine failed; one line."""


def used_up(folder: Path) -> str:
    """Resource that this machine lacks, "" if there is enough; `folder` is on the disk in use."""
    state = os.statvfs(folder) if hasattr(os, "statvfs") else None
    if shutil.disk_usage(folder).free < LEAST_BYTES:
        return "the disk is full"
    if state is not None and state.f_files > 0 and state.f_favail < LEAST_FILES:
        return "the disk has no room for more files (its inodes are used up)"
    if psutil.virtual_memory().available < LEAST_BYTES:
        return "the memory is used up"
    return ""


class Supervised:
    """A command and all its children: their output, resources and end; one at a time.

    Other children of this process, and those of its session, stay when it ends. `uid` is the user
    whom the command becomes, if it becomes one that nobody else is: it ends with all processes of
    this user.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        cwd: str | os.PathLike,
        env: dict[str, str],
        stdin: int = subprocess.DEVNULL,
        uid: int | None = None,
    ) -> None:
        if sys.platform.startswith("linux"):
            sandbox.prctl(SET_CHILD_SUBREAPER, 1)
        self._uid = uid
        self._free = 0  # most bytes that were free on the disk
        self._others = {child.pid for child in psutil.Process().children()}
        self.process = subprocess.Popen(
            command,
            cwd=cwd,
            env=env,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,
            start_new_session=True,
        )
        self._printed = b""
        self._reader = threading.Thread(target=self._drain, daemon=True)
        self._reader.start()

    def _drain(self) -> None:
        """Read the output until nobody can print any more, and keep the end of it."""
        assert self.process.stdout is not None
        with self.process.stdout as pipe:
            while chunk := pipe.read(1 << 16):
                self._printed = (self._printed + chunk)[-KEPT_OUTPUT:]

    def output(self, wait_s: float = 0.0) -> str:
        """Last output; waits up to `wait_s` seconds for the end of it."""
        self._reader.join(wait_s)
        return self._printed.decode(errors="replace")

    def processor_s(self) -> float:
        """Processor time of all processes, and of those below them that have ended [s]."""
        used = 0.0
        for process in self._descendants():
            with suppress(psutil.Error):
                used += sum(process.cpu_times()[:4])
        return used

    def excess(self, memory_bytes: int | None, folder: Path | None = None) -> str:
        """Limit that is exceeded, "" if none: files in `folder`, processes, memory together."""
        if folder is not None and self._fills_disk(folder):
            return f"wrote more than {MAX_WRITTEN >> 30} GiB"
        if folder is not None and _holds_more_than(folder, MAX_FILES):
            return f"made more than {MAX_FILES} files"
        below = self._descendants()
        if len(below) > MAX_PROCESSES:
            return f"started more than {MAX_PROCESSES} processes"
        if memory_bytes is None or _memory(below, "rss") <= memory_bytes:
            return ""
        # forked processes share most of what they seem to use
        if len(below) > 3 and _memory(below, "pss") <= memory_bytes:
            return ""
        return f"used more than {memory_bytes / 2**30:g} GiB of memory"

    def _fills_disk(self, folder: Path) -> bool:
        """Whether the disk has lost much since the first look, and the folder holds as much."""
        with suppress(OSError):
            free = shutil.disk_usage(folder).free
            self._free = max(free, self._free)
            return self._free - free > MAX_WRITTEN and _size(folder) > MAX_WRITTEN
        return False

    def end(self) -> None:
        """End all processes, also new ones; MachineFailure after `END_WITHIN_S`."""
        deadline = time.monotonic() + END_WITHIN_S
        if self._uid is not None:
            _end_user(self._uid)
        if hasattr(os, "killpg") and self.process.poll() is None:
            with suppress(ProcessLookupError, PermissionError):  # those that no tree shows, too
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.wait()
        while below := self._descendants():
            for action in ("suspend", "kill"):  # first nobody forks any more
                for process in below:
                    with suppress(psutil.Error):
                        getattr(process, action)()
            for process in below:
                with suppress(ChildProcessError):
                    os.waitpid(process.pid, getattr(os, "WNOHANG", 0))
            if time.monotonic() > deadline:
                raise MachineFailure(f"{len(below)} processes of a submission cannot be ended")
            time.sleep(0.005)

    def _descendants(self) -> list[psutil.Process]:
        """All processes below this one, but for earlier ones and those below them."""
        children = psutil.Process().children(recursive=True)
        parents: dict[int, int] = {}
        for child in children:
            with suppress(psutil.Error):
                parents[child.pid] = child.ppid()

        def stays(pid: int) -> bool:
            while pid in parents:  # this process, where the way up ends, is in its own session
                if pid in self._others or _is_in_this_session(pid):
                    return True
                pid = parents[pid]
            return False

        return [child for child in children if not stays(child.pid)]


_END_ALL = """
import os, sys
os.setgroups([])
os.setresgid(*[int(sys.argv[1])] * 3)
os.setresuid(*[int(sys.argv[1])] * 3)
os.kill(-1, 9)
"""
"""Program that ends all other processes of a user, in one step of the kernel."""


def _end_user(uid: int) -> None:
    """End all processes of a user whom only a submission is; no process can start meanwhile."""
    if uid not in sandbox.SPARE_USERS:
        raise ValueError(f"uid = {uid}: must be a user that no person has")
    command = [sys.executable, "-I", "-S", "-c", _END_ALL, str(uid)]
    with suppress(OSError):  # The machine cannot start a process; they are ended one by one
        subprocess.run(command, stderr=subprocess.DEVNULL, check=False)


def _holds_more_than(folder: Path, most: int) -> bool:
    """Whether a folder and the folders in it have more entries than this."""
    count = 0
    waiting = [str(folder)]
    while waiting:
        with suppress(OSError), os.scandir(waiting.pop()) as entries:
            for entry in entries:
                count += 1
                if count > most:
                    return True
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
    return False


def _size(folder: Path) -> int:
    """Size of a folder's files on the disk [bytes]."""
    used = 0
    for inside, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                used += 512 * os.lstat(os.path.join(inside, name)).st_blocks
    return used


def _is_in_this_session(pid: int) -> bool:
    """Whether another process is in the session of this one."""
    with suppress(AttributeError, OSError):  # Windows has none; the process may have ended
        return pid != os.getpid() and os.getsid(pid) == os.getsid(0)
    return False


def _memory(processes: list[psutil.Process], kind: str) -> int:
    """Memory of processes together [bytes]; "rss" is quick, "pss" counts shared memory once."""
    used = 0
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            try:
                read = process.memory_info if kind == "rss" else process.memory_full_info
                used += getattr(read(), kind, 0)
            except psutil.AccessDenied:  # what only its user may know; then the most it can be
                used += process.memory_info().rss
    return used


@dataclass(frozen=True)
class Ended:
    """End of a command."""

    reason: str  # why it was ended, "" if it ended by itself
    status: int  # exit status, negative for a signal
    output: str  # last output of it and its children


def run(
    command: Sequence[str],
    *,
    timeout_s: float,
    memory_bytes: int,
    folder: Path | None = None,
    **options: Any,
) -> Ended:
    """Run a command with options of `Supervised` and end all its children, whatever happens.

    It may write to `folder` within limits.
    """
    begin = time.monotonic()
    started = Supervised(command, **options)
    reason = ""
    try:
        while not reason:
            with suppress(subprocess.TimeoutExpired):
                started.process.wait(LOOK_EVERY_S)
                break
            if time.monotonic() - begin > timeout_s:
                reason = f"took more than {timeout_s:.0f} s"
            else:
                reason = started.excess(memory_bytes, folder)
    finally:
        started.end()
    return Ended(reason, started.process.returncode, started.output(5.0))
