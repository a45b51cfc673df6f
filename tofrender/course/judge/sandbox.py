"""Confine a process: it may read, but it may change files only in the folders that it is given.

A process can confine itself with `confine`. Alternatively, this file runs first and then executes
a command. It imports only the standard library and the neighboring file `system_calls`::

    python -I -S sandbox.py '{"writable": ["scratch"]}' python student.py

| protection on Linux | refuses access to |
|---|---|
| Landlock (kernel 5.13 and newer; complete in 6.12) | files and their names, TCP |
| Landlock | descriptions of other processes in `/proc`, and signals to them |
| a filter of system calls (x86_64, aarch64) | sockets, modes and times, shared memory, limits |
| another user, if root starts the process | files of other users |
| namespaces, where allowed | networks, objects and queues of System V |
| `setrlimit` | huge files, unlimited memory, core files |

Other systems lack these protections. `missing_protections` lists what a submission can do
on this machine.
"""

import ctypes
import importlib
import json
import os
import stat
import struct
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress

try:
    from . import system_calls
except ImportError:  # This file runs as a script, see `command`
    sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
    system_calls = importlib.import_module("system_calls")

GIB = 1 << 30
MAX_FILE = 2 * GIB  # largest file that a confined process may write [bytes]

# Rights to files (Landlock)
EXECUTE = 1 << 0
WRITE_FILE = 1 << 1
READ_FILE = 1 << 2
READ_DIR = 1 << 3
CHANGE_TREE = 0b1_1111_1111 << 4  # make and remove folders, files, devices, sockets, pipes, links
REFER = 1 << 13
TRUNCATE = 1 << 14
IOCTL_DEV = 1 << 15
FILE_RIGHTS = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE
RIGHTS_BY_VERSION = {
    1: EXECUTE | WRITE_FILE | READ_FILE | READ_DIR | CHANGE_TREE,
    2: REFER,
    3: TRUNCATE,
    5: IOCTL_DEV,
}
"""Rights to files, by the version of Landlock that added them."""
TCP = 0b11  # bind and connect
OUTSIDE = 0b11  # abstract sockets of processes outside, and signals to them

# System calls of Landlock, with the same numbers on every architecture
CREATE_RULESET = 444
ADD_RULE = 445
RESTRICT_SELF = 446

# Options of prctl
SET_PDEATHSIG = 1
SET_KEEPCAPS = 8
CAPBSET_DROP = 24
SET_NO_NEW_PRIVS = 38
CAP_AMBIENT = 47

# Flags of unshare
NEWIPC = 0x08000000
NEWUSER = 0x10000000
NEWNET = 0x40000000

# Capabilities of root
CHOWN = 0
DAC_OVERRIDE = 1
READ_ALL = 2
KILL = 5
SETGID = 6
SETUID = 7
SETPCAP = 8
SYS_PTRACE = 19
KEPT = {DAC_OVERRIDE, READ_ALL}
"""Capabilities that a submission keeps: reading files of others. Landlock still applies."""
KEPT_BY_JUDGE = KEPT | {CHOWN, KILL, SETGID, SETUID, SETPCAP, SYS_PTRACE}
"""Capabilities that a judge keeps, to start a submission as another user, measure and end it."""

SIGKILL = 9
SPARE_USERS = range(61184, 65520)  # ids of unused users; the range of systemd's dynamic users
MAX_TASKS = 400  # threads of a submission, in addition to four per processor for its arrays
MAX_OPEN_FILES = 256  # open files per process; deleted files that are still open use disk space
SYSTEM = frozenset("bin dev etc lib lib32 lib64 libx32 nix proc sbin sys usr".split())  # noqa: SIM905
"""Top-level folders with programs, libraries and their settings."""
HIDDEN_OF_SYSTEM = ("/dev", "/proc")
READABLE_OF_SYSTEM = (
    "/dev/null",
    "/dev/zero",
    "/dev/full",
    "/dev/random",
    "/dev/urandom",
    "/proc/cpuinfo",
    "/proc/filesystems",
    "/proc/loadavg",
    "/proc/meminfo",
    "/proc/stat",
    "/proc/sys",
    "/proc/uptime",
)
"""Harmless devices, and files that describe the machine but no process."""


def confine(
    writable: Iterable[str] = (),
    hidden: Iterable[str] = (),
    readable: Iterable[str] = (),
    listed: Iterable[str] = (),
    memory_bytes: int | None = None,
    uid: int | None = None,
    reads_all: bool = False,
    judge: bool = False,
) -> None:
    """Confine this process and all its children. This cannot be undone.

    Call this function before the process starts threads, because existing threads stay
    unconfined. The process ends with the thread that started it.

    Args:
        writable: Existing paths below which everything is allowed.
        hidden: Paths with files that must not be read.
        readable: Paths inside `hidden` that can be read nevertheless.
        listed: Folders that contain hidden files, but may be listed.
        memory_bytes: Expected memory of the process, which determines the limit of the address
            space; None for no limit.
        uid: User to become, if this process is root's. The user becomes the owner of the
            `writable` paths.
        reads_all: Let the user `uid` keep root's right to read all files.
        judge: Grant the rights of a judge, which confines and ends a submission itself. A
            submission cannot list folders with hidden files, and cannot read files of other
            processes in `/proc`. A judge can do both.
    """
    if not sys.platform.startswith("linux"):
        return
    parent = os.getppid()
    os.umask(0o022)

    # Limits and owners that need root's rights
    if judge:
        _leave_the_network()
    _limit(memory_bytes, uid, judge)
    if uid is not None:
        for path in writable:
            os.chown(path, uid, uid)

    # Capabilities; for users other than root, the call fails and is not needed
    for capability in range(64):
        if capability not in (KEPT_BY_JUDGE if judge else KEPT):
            prctl(CAPBSET_DROP, capability)

    # Files
    prctl(SET_NO_NEW_PRIVS, 1)
    if landlock_version():
        if judge:
            hidden = [*hidden, "/dev"]
            readable = [*readable, *READABLE_OF_SYSTEM]
        else:
            hidden = [*hidden, *HIDDEN_OF_SYSTEM]
            readable = [*readable, *READABLE_OF_SYSTEM, "/proc/self"]
        unrestricted = READ_DIR if judge else 0
        _restrict([*writable, os.devnull], hidden, readable, listed, unrestricted)

    # User
    if uid is not None:
        _become(uid, reads_all)

    # End with the parent; a change of the user would reset this setting
    prctl(SET_PDEATHSIG, SIGKILL)
    if os.getppid() != parent:
        sys.exit("the process that started this process has ended")

    # System calls
    if system_calls.available():
        system_calls.restrict(judge)


def hide(readable: Iterable[str]) -> None:
    """Remove the rights to read files and to run programs, except reading `readable` paths.

    This applies to the current thread and to the threads and processes that it starts. It removes
    rights that `confine` still allows.
    """
    if not landlock_version():
        return
    rights = EXECUTE | READ_FILE
    rules = _syscall(CREATE_RULESET, struct.pack("=Q", rights), ctypes.c_size_t(8), 0)
    for path in readable:
        _allow(rules, path, READ_FILE)
    _syscall(RESTRICT_SELF, rules, 0)
    os.close(rules)


def command(confinement: dict, arguments: Sequence[str]) -> list[str]:
    """Return a command that runs another command in the sandbox.

    Args:
        confinement: Keyword arguments of `confine`.
        arguments: The other command and its arguments.
    """
    if not sys.platform.startswith("linux"):
        return list(arguments)
    return [sys.executable, "-I", "-S", __file__, json.dumps(confinement, default=str), *arguments]


def landlock_version() -> int:
    """Return the version of the kernel's Landlock, 0 if Landlock is missing or not allowed."""
    if not sys.platform.startswith("linux"):
        return 0
    with suppress(OSError):
        return _syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(1))
    return 0


def missing_protections() -> list[str]:
    """Return the actions of a submission that this machine cannot prevent."""
    # Actions that newer versions of Landlock prevent
    version = landlock_version()
    needs = {
        1: "writing to other files of the user, reading the reference solution",
        3: "emptying other files of the user",
        4: "TCP connections",
        6: "signals to other processes of the user",
    }
    missing = [actions for since, actions in needs.items() if version < since]

    # Actions that the filter of system calls prevents
    if not system_calls.available():
        missing.append(
            "changing modes and times of the user's files, sockets, permanent shared memory, "
            "limits of the user's processes"
        )

    # Actions that root can do, unless the submission runs as another user
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        reading = "reading files of root, because"
        with own_user() as uid:
            if uid is None:
                missing.append(f"{reading} root cannot become another user here")
            elif closed := closed_to_others():
                missing.append(f"{reading} Python needs {closed}, which other users cannot enter")
    return missing


def protects_files() -> bool:
    """Return whether the sandbox protects content and modes of all other files from changes."""
    return landlock_version() >= 3 and system_calls.available()


@contextmanager
def own_user() -> Iterator[int | None]:
    """Reserve an unused user for one submission; None if the process cannot become another user.

    An abstract socket marks the user as reserved for all graders on this machine. The socket
    disappears with this process.
    """
    users = spare_users()
    if not users:
        yield None
        return
    import socket

    with socket.socket(socket.AF_UNIX) as mark:
        for uid in users:
            with suppress(OSError):  # Another grader has reserved this user
                mark.bind(f"\0tofrender-user-{uid}")
                break
        else:
            uid = None
        yield uid


def spare_users() -> list[int]:
    """Return the ids of unused users in random order, if this process can become one of them.

    The result is empty for users other than root, and for a root with too few capabilities.
    """
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        return []

    # Has this process the necessary capabilities?
    rights = [CHOWN, DAC_OVERRIDE, KILL, SETGID, SETUID]
    rights += [READ_ALL] if closed_to_others() else []
    needed = sum(1 << right for right in rights)
    effective = [line.split()[1] for line in _lines_of("status") if line.startswith("CapEff")]
    if not effective or int(effective[0], 16) & needed != needed:
        return []

    # Which users have a name or a process?
    import pwd
    from random import SystemRandom

    known = {entry.pw_uid for entry in pwd.getpwall()}
    for name in filter(str.isdigit, os.listdir("/proc")):
        with suppress(OSError):
            known.add(os.stat(f"/proc/{name}").st_uid)

    # Which users and groups exist in this namespace? In a container, only a few do
    maps = [[tuple(map(int, line.split())) for line in _lines_of(f"{k}id_map")] for k in "ug"]
    free = [
        uid
        for uid in SPARE_USERS
        if uid not in known
        and all(any(first <= uid < first + count for first, _, count in spans) for spans in maps)
    ]
    SystemRandom().shuffle(free)
    return free


def _lines_of(name: str) -> list[str]:
    """Read the lines of `/proc/self/NAME`. The file must exist."""
    with open(f"/proc/self/{name}", encoding="ascii", errors="replace") as file:
        return file.readlines()


def closed_to_others() -> str:
    """Return a folder that Python needs but other users cannot enter, "" if all are open."""
    import tempfile

    needed = {sys.executable, *python_folders(), tempfile.gettempdir()}
    for path in sorted(map(os.path.realpath, needed)):
        while path != os.path.dirname(path):
            if not os.stat(path).st_mode & stat.S_IXOTH:
                return path
            path = os.path.dirname(path)
    return ""


def python_folders() -> list[str]:
    """Return the existing folders of Python, its packages and LLVM."""
    import site

    found = {sys.prefix, sys.base_prefix, sys.exec_prefix, *site.getsitepackages()}
    if llvm := os.environ.get("DRJIT_LIBLLVM_PATH"):
        found.add(os.path.dirname(os.path.realpath(llvm)))
    return sorted(path for path in found if os.path.isdir(path))


def private() -> list[str]:
    """Return the top-level folders that are not part of the system, such as home folders."""
    return [entry.path for entry in os.scandir("/") if entry.name not in SYSTEM]


def _most_tasks(uid: int | None) -> int:
    """Return the largest number of threads of the user whom a submission has."""
    most = MAX_TASKS + 4 * (os.cpu_count() or 1)
    with open("/proc/self/uid_map", encoding="ascii") as file:
        users = sum(int(line.split()[2]) for line in file)
    # The kernel counts by user. Does nobody else have this user, or this namespace of users?
    if uid is not None or users == 1:
        return most

    # All other threads of the user count as well
    for name in filter(str.isdigit, os.listdir("/proc")):
        with suppress(OSError):  # The process has ended
            if os.stat(f"/proc/{name}").st_uid == os.getuid():
                most += len(os.listdir(f"/proc/{name}/task"))
    return most


def _limit(memory_bytes: int | None, uid: int | None, judge: bool) -> None:
    """Limit core files, file size, address space, open files and threads."""
    import resource

    unlimited = resource.RLIM_INFINITY
    # Dr.Jit crashes on the real limit, and threads reserve much more than they use
    space = unlimited if memory_bytes is None else 2 * memory_bytes + 8 * GIB
    for number, bound in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, MAX_FILE),
        (resource.RLIMIT_AS, space),
        (resource.RLIMIT_NPROC, unlimited if judge else _most_tasks(uid)),
        (resource.RLIMIT_NOFILE, unlimited if judge else MAX_OPEN_FILES),
    ):
        hard = resource.getrlimit(number)[1]
        if hard != unlimited:
            bound = hard if bound == unlimited else min(bound, hard)
        resource.setrlimit(number, (bound, bound))


def _restrict(
    writable: Iterable[str],
    hidden: Iterable[str],
    readable: Iterable[str],
    listed: Iterable[str],
    unrestricted: int,
) -> None:
    """Enter a domain of Landlock, see `confine`; the rights `unrestricted` are not restricted."""
    # Restrict all rights of this version
    version = landlock_version()
    handled = sum(rights for since, rights in RIGHTS_BY_VERSION.items() if since <= version)
    handled &= ~unrestricted
    attributes = [handled] + [TCP] * (version >= 4) + [OUTSIDE] * (version >= 6)
    packed = struct.pack(f"={len(attributes)}Q", *attributes)
    rules = _syscall(CREATE_RULESET, packed, ctypes.c_size_t(len(packed)), 0)

    # Add the exceptions
    for path in everything_but(hidden, readable):
        _allow(rules, path, (EXECUTE | READ_FILE | READ_DIR) & handled)
    for path in listed:
        _allow(rules, path, READ_DIR & handled)
    for path in writable:
        _allow(rules, path, handled & ~IOCTL_DEV)

    # Enter the domain
    _syscall(RESTRICT_SELF, rules, 0)
    os.close(rules)


def everything_but(hidden: Iterable[str], readable: Iterable[str] = ()) -> Iterator[str]:
    """Yield folders and files that together contain everything except `hidden` paths.

    The folders are as large as possible. Paths in `readable` are yielded even if they are inside
    a hidden path.

    Example:
        >>> list(everything_but([]))
        ['/']
        >>> "/usr" in everything_but(["/home"]), "/home" in everything_but(["/home"])
        (True, False)
        >>> "/usr/bin" in everything_but(["/usr"], ["/usr/bin"])
        True
    """
    excluded = {os.path.realpath(path) for path in hidden}

    def walk(folder: str) -> Iterator[str]:
        """Yield a folder, or the parts of it that are not excluded."""
        inside = folder.rstrip("/") + "/"
        if folder in excluded:
            return
        if not any(path.startswith(inside) for path in excluded):
            yield folder
            return

        # Something inside is excluded; descend
        try:
            entries = [inside + name for name in os.listdir(folder)]
        except OSError:
            return
        for entry in entries:
            if not os.path.islink(entry):  # The target of a link is found at its own place
                yield from walk(entry)

    yield from walk("/")
    for path in map(os.path.realpath, readable):
        if any(path.startswith(folder.rstrip("/") + "/") for folder in excluded):
            yield from walk(path)


def _allow(rules: int, path: str, rights: int) -> None:
    """Add an exception to the rules of Landlock: rights below a path, if the path exists."""
    try:
        fd = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    if not os.path.isdir(path):
        rights &= FILE_RIGHTS
    with suppress(OSError):  # A file system without support for rules stays forbidden
        _syscall(ADD_RULE, rules, 1, struct.pack("=Qi", rights, fd), 0)
    os.close(fd)


def _syscall(number: int, *arguments) -> int:
    """Make a system call and return its result; raise OSError if it fails."""
    libc = ctypes.CDLL(None, use_errno=True)
    result = libc.syscall(ctypes.c_long(number), *arguments)
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _become(uid: int, reads_all: bool) -> None:
    """Become another user without capabilities, or only with the capability to read all files."""
    if reads_all:
        prctl(SET_KEEPCAPS, 1)
    os.setgroups([])
    os.setresgid(uid, uid, uid)
    os.setresuid(uid, uid, uid)
    if reads_all:
        # Set the effective, permitted and inheritable capabilities
        bit = 1 << READ_ALL
        header = struct.pack("=Ii", 0x20080522, 0)
        data = struct.pack("=6I", bit, bit, bit, 0, 0, 0)
        if ctypes.CDLL(None).capset(header, data) != 0:
            raise OSError("the kernel refused to keep root's right to read")

        # Keep the capability when the command starts
        prctl(CAP_AMBIENT, 2, READ_ALL)


def _leave_the_network() -> None:
    """Enter empty namespaces for network and IPC, if the kernel allows this."""
    if os.geteuid() == 0:
        ctypes.CDLL(None).unshare(NEWNET | NEWIPC)
        return

    # Try in a child first. Some systems allow only the first step, which would leave this process
    # without a user
    child = os.fork()
    if child == 0:
        os._exit(0 if _unshare_as_user() else 1)
    if os.waitpid(child, 0)[1] == 0:
        _unshare_as_user()


def _unshare_as_user() -> bool:
    """Enter namespaces as an ordinary user, and return whether this worked."""
    uid = os.getuid()
    gid = os.getgid()
    if ctypes.CDLL(None).unshare(NEWUSER | NEWNET | NEWIPC) != 0:
        return False
    maps = {"setgroups": "deny", "uid_map": f"{uid} {uid} 1", "gid_map": f"{gid} {gid} 1"}
    with suppress(OSError):
        for name, text in maps.items():
            with open(f"/proc/self/{name}", "w", encoding="ascii") as file:
                file.write(text)
        return True
    return False


def prctl(option: int, value: int, second_value: int = 0) -> int:
    """Make Linux's system call prctl with one or two arguments, and return its result."""
    word = ctypes.c_ulong
    return ctypes.CDLL(None).prctl(option, word(value), word(second_value), word(0), word(0))


if __name__ == "__main__":
    confine(**json.loads(sys.argv[1]))
    os.execvp(sys.argv[2], sys.argv[2:])
