"""Run untrusted commands with limited memory and time, and end all their children.

A child is found even if it starts a new session or its parent has ended, because this process
adopts orphans (`PR_SET_CHILD_SUBREAPER`, Linux). Only descendants of this process are ended.
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

KEPT_OUTPUT = 20_000  # end of a command's output that is kept [bytes]
MACHINE_FAILED = 70  # exit status of a judge, equal to EX_SOFTWARE of sysexits.h
LEAST_BYTES = 64 << 20  # memory and disk space that must be free [bytes]
LEAST_FILES = 1000  # inodes of the disk that must be free
MAX_PROCESSES = 200  # processes of a command at a time
MAX_WRITTEN = 4 << 30  # size of the files that a command may leave in a watched folder [bytes]
MAX_FILES = 2000  # files, links and folders that a command may leave in a watched folder
LOOK_EVERY_S = 0.2  # time between two checks of the limits [s]
END_WITHIN_S = 20.0  # longest time to end all processes of a command [s]
SET_CHILD_SUBREAPER = 36  # option of prctl


class MachineFailure(RuntimeError):
    """The machine failed, so a submission cannot be graded; the message is one line."""


def used_up(folder: Path) -> str:
    """Return a message if the machine has too little memory or disk space, "" otherwise.

    Args:
        folder: A folder on the disk that is checked.
    """
    state = os.statvfs(folder) if hasattr(os, "statvfs") else None
    if shutil.disk_usage(folder).free < LEAST_BYTES:
        return "the disk is full"
    if state is not None and state.f_files > 0 and state.f_favail < LEAST_FILES:
        return "the disk cannot store more files (all inodes are used)"
    if psutil.virtual_memory().available < LEAST_BYTES:
        return "the memory is used up"
    return ""


class Supervised:
    """A running command with all its children: output, use of resources, and end.

    Only one such command may run at a time. Earlier children of this process, and children in the
    session of this process, are not counted or ended.

    Args:
        command: Command and arguments.
        cwd: Working folder.
        env: Environment variables.
        stdin: Standard input, as in `subprocess.Popen`.
        uid: User that the command becomes, if no other process has this user. All processes of
            the user are ended with the command.
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
        self._most_free = 0  # largest free space on the disk that was observed [bytes]
        self._earlier_children = {child.pid for child in psutil.Process().children()}
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
        """Read the output until all processes have closed it, and keep its last part."""
        assert self.process.stdout is not None
        with self.process.stdout as pipe:
            while chunk := pipe.read(1 << 16):
                self._printed = (self._printed + chunk)[-KEPT_OUTPUT:]

    def output(self, wait_s: float = 0.0) -> str:
        """Return the last part of the output, after waiting up to `wait_s` seconds for its end."""
        self._reader.join(wait_s)
        return self._printed.decode(errors="replace")

    def processor_s(self) -> float:
        """Return the processor time of all processes, including ended children [s]."""
        used = 0.0
        for process in self._descendants():
            with suppress(psutil.Error):
                used += sum(process.cpu_times()[:4])
        return used

    def excess(self, memory_bytes: int | None, folder: Path | None = None) -> str:
        """Return a message if the processes exceed a limit, "" otherwise.

        Args:
            memory_bytes: Largest memory of all processes together; None for no limit.
            folder: Watched folder, with a limited size and number of files.
        """
        # Files
        if folder is not None and self._fills_disk(folder):
            return f"wrote more than {MAX_WRITTEN >> 30} GiB"
        if folder is not None and _holds_more_than(folder, MAX_FILES):
            return f"made more than {MAX_FILES} files"

        # Processes
        running = self._descendants()
        if len(running) > MAX_PROCESSES:
            return f"started more than {MAX_PROCESSES} processes"

        # Memory; forked processes share most of their resident memory
        if memory_bytes is None or _memory(running, "rss") <= memory_bytes:
            return ""
        if len(running) > 3 and _memory(running, "pss") <= memory_bytes:
            return ""
        return f"used more than {memory_bytes / 2**30:g} GiB of memory"

    def _fills_disk(self, folder: Path) -> bool:
        """Return whether the folder is too large.

        The folder is measured only if the free space on the disk has shrunk by as much.
        """
        with suppress(OSError):
            free = shutil.disk_usage(folder).free
            self._most_free = max(free, self._most_free)
            return self._most_free - free > MAX_WRITTEN and _size(folder) > MAX_WRITTEN
        return False

    def end(self) -> None:
        """End all processes of the command, also processes that start in the meantime.

        Raises:
            MachineFailure: Processes were still running after `END_WITHIN_S` seconds.
        """
        deadline = time.monotonic() + END_WITHIN_S

        # End the user's processes, then the process group, then the command itself
        if self._uid is not None:
            _end_user(self._uid)
        if hasattr(os, "killpg") and self.process.poll() is None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.wait()

        # End the remaining descendants. Suspend all of them first, so that none starts another
        while running := self._descendants():
            for action in ("suspend", "kill"):
                for process in running:
                    with suppress(psutil.Error):
                        getattr(process, action)()
            for process in running:
                with suppress(ChildProcessError):
                    os.waitpid(process.pid, getattr(os, "WNOHANG", 0))
            if time.monotonic() > deadline:
                raise MachineFailure(f"{len(running)} processes of a submission cannot be ended")
            time.sleep(0.005)

    def _descendants(self) -> list[psutil.Process]:
        """Return the descendants of this process that the command started.

        Earlier children, processes in this session, and their descendants are left out.
        """
        children = psutil.Process().children(recursive=True)
        parents: dict[int, int] = {}
        for child in children:
            with suppress(psutil.Error):
                parents[child.pid] = child.ppid()

        def is_unrelated(pid: int) -> bool:
            """Search the process and its ancestors, up to this process."""
            while pid in parents:
                if pid in self._earlier_children or _is_in_this_session(pid):
                    return True
                pid = parents[pid]
            return False

        return [child for child in children if not is_unrelated(child.pid)]


_END_ALL = """
import os, sys
os.setgroups([])
os.setresgid(*[int(sys.argv[1])] * 3)
os.setresuid(*[int(sys.argv[1])] * 3)
os.kill(-1, 9)
"""
"""Program that becomes a user and ends all other processes of this user with one system call."""


def _end_user(uid: int) -> None:
    """End all processes of a user that only runs a submission.

    One system call ends all of them, so none can start another in the meantime.
    """
    if uid not in sandbox.SPARE_USERS:
        first = sandbox.SPARE_USERS[0]
        last = sandbox.SPARE_USERS[-1]
        raise ValueError(f"uid = {uid}: must be from {first} to {last}, which no person uses")
    command = [sys.executable, "-I", "-S", "-c", _END_ALL, str(uid)]
    with suppress(OSError):  # If no process can start, `Supervised.end` ends them one by one
        subprocess.run(command, stderr=subprocess.DEVNULL, check=False)


def _holds_more_than(folder: Path, most: int) -> bool:
    """Return whether a folder and its subfolders have more than `most` entries."""
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
    """Return the disk space that a folder's files use [bytes]."""
    used = 0
    for inside, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                used += 512 * os.lstat(os.path.join(inside, name)).st_blocks
    return used


def _is_in_this_session(pid: int) -> bool:
    """Return whether another process is in the session of this process."""
    with suppress(AttributeError, OSError):  # Windows has no sessions; the process may have ended
        return pid != os.getpid() and os.getsid(pid) == os.getsid(0)
    return False


def _memory(processes: list[psutil.Process], kind: str) -> int:
    """Return the memory of all processes together [bytes].

    Args:
        processes: The processes.
        kind: "rss" for resident memory, or "pss", which counts shared memory once but is slower.
    """
    used = 0
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            try:
                read = process.memory_info if kind == "rss" else process.memory_full_info
                used += getattr(read(), kind, 0)
            except psutil.AccessDenied:
                # Only the user of the process may read "pss"; "rss" is an upper bound
                used += process.memory_info().rss
    return used


@dataclass(frozen=True)
class Ended:
    """Result of a command that has ended."""

    reason: str  # limit that was exceeded, "" if the command ended by itself
    status: int  # exit status; negative for a signal
    output: str  # last output of the command and its children


def run(
    command: Sequence[str],
    *,
    timeout_s: float,
    memory_bytes: int,
    folder: Path | None = None,
    **options: Any,
) -> Ended:
    """Run a command within limits, and end all its children in any case.

    Args:
        command: Command and arguments.
        timeout_s: Longest time [s].
        memory_bytes: Largest memory of all processes together [bytes].
        folder: Watched folder, see `Supervised.excess`.
        **options: Further arguments of `Supervised`.
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
    output = started.output(wait_s=5.0)
    return Ended(reason=reason, status=started.process.returncode, output=output)
