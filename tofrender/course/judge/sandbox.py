"""Confine a process: it may read, but write nowhere except below the folders that it is given.

Either a process confines itself with `confine`, or this file, which needs nothing but the standard
library, stands between the one that asks and the command that takes its place::

    python -I -S sandbox.py '{"writable": ["scratch"]}' python student.py

On Linux, Landlock (kernel 5.13) refuses files and, with newer kernels, TCP and signals to processes
outside. Where there is none, the limits of `setrlimit` hold alone, and elsewhere nothing does:
`protections` says which.
"""

from __future__ import annotations

import ctypes
import json
import os
import struct
import sys
from collections.abc import Iterable, Iterator, Sequence

GIB = 1 << 30
MAX_FILE = 2 * GIB
"""Largest file that a confined process may write [bytes]."""

EXECUTE, WRITE_FILE, READ_FILE = 1 << 0, 1 << 1, 1 << 2
TREE = 0b1_1111_1111 << 4  # removing and making: folders, files, devices, sockets, pipes, links
REFER, TRUNCATE, IOCTL_DEV = 1 << 13, 1 << 14, 1 << 15
FILE_RIGHTS = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE
SINCE = {1: EXECUTE | WRITE_FILE | READ_FILE | TREE, 2: REFER, 3: TRUNCATE, 5: IOCTL_DEV}
"""Rights to files, by the version of Landlock that knows them."""
TCP = 0b11  # binding and connecting
OUTSIDE = 0b11  # abstract sockets and signals of processes outside

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # system calls, on every architecture
SET_PDEATHSIG, SET_NO_NEW_PRIVS, CAPBSET_DROP = 1, 38, 24  # prctl
KEPT_CAPABILITIES = (1, 2)  # reading what belongs to others, as root does; Landlock still refuses
SIGKILL = 9


def confine(
    writable: Iterable[str] = (),
    hidden: Iterable[str] = (),
    memory_bytes: int | None = None,
) -> None:
    """Confine this process and all that it starts, for good.

    Call it before there are threads: those that exist stay as they are. The process ends with the
    thread that started it.

    Args:
        writable: Files and folders that exist; below them everything is allowed.
        hidden: Files and folders whose content cannot be read. Their names can.
        memory_bytes: Memory that somebody else watches [bytes]. The address space is limited to a
            multiple of it, since Dr.Jit crashes on the real limit and threads reserve much more
            than they use.

    Example:
        A process that has confined itself cannot write into its working folder::

            confine([os.environ["TMPDIR"], os.devnull])
            open("note.txt", "w")  # PermissionError
    """
    if not sys.platform.startswith("linux"):
        return
    parent = os.getppid()
    prctl(SET_PDEATHSIG, SIGKILL)
    if os.getppid() != parent:
        sys.exit("the process that started this one has ended")
    _limit(memory_bytes)
    for capability in range(64):
        if capability not in KEPT_CAPABILITIES:
            prctl(CAPBSET_DROP, capability)  # refused unless root, who has them
    if landlock_version():
        _restrict([*writable, os.devnull], hidden)


def command(wanted: dict, arguments: Sequence[str]) -> list[str]:
    """The command that runs `arguments` confined.

    Args:
        wanted: Arguments of `confine`.
        arguments: Program and arguments. Its environment and working folder stay.
    """
    if not sys.platform.startswith("linux"):
        return list(arguments)
    return [sys.executable, "-I", "-S", __file__, json.dumps(wanted), *arguments]


def landlock_version() -> int:
    """Version of the kernel's Landlock, 0 if it has none or may not be asked."""
    if not sys.platform.startswith("linux"):
        return 0
    try:
        return _syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(1))
    except OSError:
        return 0


def missing_protections() -> list[str]:
    """What this machine cannot keep a submission from; empty where everything holds."""
    version = landlock_version()
    needs = {
        1: "writing to other files of the user, reading the reference solution",
        3: "emptying other files of the user",
        4: "TCP connections",
        6: "signals to other processes of the user",
    }
    return [what for since, what in needs.items() if version < since]


def _limit(memory_bytes: int | None) -> None:
    """Leave no core files, write no huge ones, reserve no endless memory."""
    import resource

    space = resource.RLIM_INFINITY if memory_bytes is None else 2 * memory_bytes + 8 * GIB
    for number, bound in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, MAX_FILE),
        (resource.RLIMIT_AS, space),
    ):
        hard = resource.getrlimit(number)[1]
        if hard != resource.RLIM_INFINITY:
            bound = hard if bound == resource.RLIM_INFINITY else min(bound, hard)
        resource.setrlimit(number, (bound, bound))


# --------------------------------------------------------------------------------- Landlock


def _restrict(writable: Iterable[str], hidden: Iterable[str]) -> None:
    version = landlock_version()
    handled = sum(rights for since, rights in SINCE.items() if since <= version)
    attributes = [handled] + [TCP] * (version >= 4) + [OUTSIDE] * (version >= 6)
    packed = struct.pack(f"={len(attributes)}Q", *attributes)
    rules = _syscall(CREATE_RULESET, packed, ctypes.c_size_t(len(packed)), 0)
    for path in everything_but(hidden):
        _allow(rules, path, (EXECUTE | READ_FILE) & handled)
    for path in writable:
        _allow(rules, path, handled & ~IOCTL_DEV)
    prctl(SET_NO_NEW_PRIVS, 1)
    _syscall(RESTRICT_SELF, rules, 0)
    os.close(rules)


def everything_but(hidden: Iterable[str]) -> Iterator[str]:
    """Yield the largest folders, and files, that together hold all but `hidden`.

    Example:
        >>> list(everything_but([]))
        ['/']
        >>> "/usr" in everything_but(["/home"]), "/home" in everything_but(["/home"])
        (True, False)
    """
    away = {os.path.realpath(path) for path in hidden}

    def walk(folder: str) -> Iterator[str]:
        inside = folder.rstrip("/") + "/"
        if folder in away:
            return
        if not any(path.startswith(inside) for path in away):
            yield folder
            return
        try:
            entries = [inside + name for name in os.listdir(folder)]
        except OSError:
            return
        for entry in entries:
            if not os.path.islink(entry):  # what it points to is in the list where it lies
                yield from walk(entry)

    yield from walk("/")


def _allow(rules: int, path: str, rights: int) -> None:
    try:
        fd = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    if not os.path.isdir(path):
        rights &= FILE_RIGHTS
    try:
        _syscall(ADD_RULE, rules, 1, struct.pack("=Qi", rights, fd), 0)
    except OSError:
        pass  # a file system that knows no rules stays forbidden
    finally:
        os.close(fd)


def _syscall(number: int, *arguments) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    result = libc.syscall(ctypes.c_long(number), *arguments)
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def prctl(option: int, value: int) -> int:
    """Linux's system call of this name, with one argument."""
    word = ctypes.c_ulong
    return ctypes.CDLL(None).prctl(option, word(value), word(0), word(0), word(0))


if __name__ == "__main__":
    confine(**json.loads(sys.argv[1]))
    os.execvp(sys.argv[2], sys.argv[2:])
