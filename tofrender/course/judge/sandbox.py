"""Confine a process: it may read, but change nothing except below the folders that it is given.

Either a process confines itself with `confine`, or this file, which needs nothing but the standard
library and its neighbour `system_calls`, runs first and then executes the command::

    python -I -S sandbox.py '{"writable": ["scratch"]}' python student.py

| on Linux | refuses |
|---|---|
| Landlock (kernel 5.13 and newer, 6.12 for all) | files and their names, TCP |
| the same | descriptions of other processes in `/proc`, and signals to them |
| a filter of system calls (x86_64, aarch64) | sockets, modes and times, shared memory, limits |
| another user, if root starts it | files of others |
| namespaces, where allowed | a network, objects of System V and queues, once more |
| `setrlimit` | huge files, endless memory, core files |

Elsewhere nothing is refused: `missing_protections` lists it.
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
except ImportError:  # run as a file, by `command`
    sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
    system_calls = importlib.import_module("system_calls")

GIB = 1 << 30
MAX_FILE = 2 * GIB  # largest file that a confined process may write [bytes]

EXECUTE, WRITE_FILE, READ_FILE, READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
TREE = 0b1_1111_1111 << 4  # removing and making: folders, files, devices, sockets, pipes, links
REFER, TRUNCATE, IOCTL_DEV = 1 << 13, 1 << 14, 1 << 15
FILE_RIGHTS = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE
SINCE = {1: EXECUTE | WRITE_FILE | READ_FILE | READ_DIR | TREE, 2: REFER, 3: TRUNCATE, 5: IOCTL_DEV}
"""Rights to files, by the version of Landlock that knows them."""
TCP = 0b11  # binding and connecting
OUTSIDE = 0b11  # abstract sockets and signals of processes outside

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # system calls, on every architecture
SET_PDEATHSIG, SET_KEEPCAPS, CAPBSET_DROP, SET_NO_NEW_PRIVS, CAP_AMBIENT = 1, 8, 24, 38, 47  # prctl
SIGKILL = 9
NEWIPC, NEWUSER, NEWNET = 0x08000000, 0x10000000, 0x40000000
CHOWN, DAC_OVERRIDE, READ_ALL, KILL, SETGID, SETUID, SETPCAP, SYS_PTRACE = 0, 1, 2, 5, 6, 7, 8, 19
KEPT = {DAC_OVERRIDE, READ_ALL}
"""Capabilities of root that stay: reading others' files. Landlock still refuses."""
KEPT_BY_JUDGE = KEPT | {CHOWN, KILL, SETGID, SETUID, SETPCAP, SYS_PTRACE}
"""Also those to start a submission as another user, to measure it and to end it."""
SPARE_USERS = range(61184, 65520)  # range of unused users; systemd's dynamic users are there too
MAX_TASKS = 400  # threads of a submission, in addition to four per processor for its arrays
MAX_OPEN_FILES = 256  # of each process, since files without a name need space as well
SYSTEM = frozenset("bin dev etc lib lib32 lib64 libx32 nix proc sbin sys usr".split())  # noqa: SIM905
"""Folders of the root that hold programs, libraries and their settings."""
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
"""Devices without effect, and files that describe the machine but no process."""


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
    """Confine this process and all its children, for good; it ends with the thread that started it.

    Call it before there are threads: those that exist stay as they are. Everything is allowed below
    `writable` paths, which exist. Files in `hidden` paths cannot be read, except `readable` paths
    in them. `uid` is the user to become, if this is root, who gets all that is writable and with
    `reads_all` keeps root's right to read.

    A submission cannot list a folder with hidden files, unless the folder is `listed`, and it
    cannot read files of other processes in `/proc`. A `judge` can, since it confines and ends a
    submission in turn.
    """
    if not sys.platform.startswith("linux"):
        return
    parent = os.getppid()
    os.umask(0o022)
    if judge:
        _leave_the_network()
    _limit(memory_bytes, uid, judge)
    if uid is not None:
        for path in writable:
            os.chown(path, uid, uid)
    for capability in range(64):
        if capability not in (KEPT_BY_JUDGE if judge else KEPT):
            prctl(CAPBSET_DROP, capability)  # refused unless root, who has them
    prctl(SET_NO_NEW_PRIVS, 1)
    if landlock_version():
        if judge:
            hidden = [*hidden, "/dev"]
            readable = [*readable, *READABLE_OF_SYSTEM]
        else:
            hidden = [*hidden, *HIDDEN_OF_SYSTEM]
            readable = [*readable, *READABLE_OF_SYSTEM, "/proc/self"]
        names = READ_DIR if judge else 0
        _restrict([*writable, os.devnull], hidden, readable, listed, allowed=names)
    if uid is not None:
        _become(uid, reads_all)
    prctl(SET_PDEATHSIG, SIGKILL)  # after all that changes who this is, which forgets it
    if os.getppid() != parent:
        sys.exit("the process that started this one has ended")
    if system_calls.available():
        system_calls.restrict(judge)


def hide(readable: Iterable[str]) -> None:
    """Let this thread, and what it starts, read nothing but `readable` paths, and run no program.

    This removes rights that `confine` still allows.
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
    """Command that runs `arguments` confined; `confinement` holds the arguments of `confine`."""
    if not sys.platform.startswith("linux"):
        return list(arguments)
    return [sys.executable, "-I", "-S", __file__, json.dumps(confinement, default=str), *arguments]


def landlock_version() -> int:
    """Version of the kernel's Landlock, 0 if it has none or may not be asked."""
    if not sys.platform.startswith("linux"):
        return 0
    with suppress(OSError):
        return _syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(1))
    return 0


def missing_protections() -> list[str]:
    """Actions of a submission that this machine cannot prevent; empty if none."""
    version = landlock_version()
    needs = {
        1: "writing to other files of the user, reading the reference solution",
        3: "emptying other files of the user",
        4: "TCP connections",
        6: "signals to other processes of the user",
    }
    missing = [actions for since, actions in needs.items() if version < since]
    if not system_calls.available():
        missing.append(
            "changing modes and times of the user's files, sockets, shared memory that stays, "
            "limits of the user's processes"
        )
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        reading = "reading what only root can read, since"
        with own_user() as uid:
            if uid is None:
                missing.append(f"{reading} root may not be another user")
            elif closed := closed_to_others():
                missing.append(f"{reading} Python needs {closed}, which other users cannot enter")
    return missing


def protects_files() -> bool:
    """Whether no submission can change content or modes of others' files."""
    return landlock_version() >= 3 and system_calls.available()


@contextmanager
def own_user() -> Iterator[int | None]:
    """An unused user, for one submission at a time; None if this may not become another.

    A socket without a file marks the user as taken, for all graders; it ends with this process.
    """
    users = spare_users()
    if not users:
        yield None
        return
    import socket

    with socket.socket(socket.AF_UNIX) as mark:
        for uid in users:
            with suppress(OSError):  # another grader has marked it
                mark.bind(f"\0tofrender-user-{uid}")
                break
        else:
            uid = None
        yield uid


def spare_users() -> list[int]:
    """Unused users, in random order, if this is root who may become one of them."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        return []
    rights = [CHOWN, DAC_OVERRIDE, KILL, SETGID, SETUID]
    rights += [READ_ALL] if closed_to_others() else []
    needed = sum(1 << right for right in rights)
    effective = [line.split()[1] for line in _lines_of("status") if line.startswith("CapEff")]
    if not effective or int(effective[0], 16) & needed != needed:
        return []
    import pwd
    from random import SystemRandom

    known = {entry.pw_uid for entry in pwd.getpwall()}
    for name in filter(str.isdigit, os.listdir("/proc")):
        with suppress(OSError):
            known.add(os.stat(f"/proc/{name}").st_uid)
    # Few users exist in the namespace of a container
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
    with open(f"/proc/self/{name}", encoding="ascii", errors="replace") as file:
        return file.readlines()


def closed_to_others() -> str:
    """Folder that Python needs and that other users cannot enter, "" if there is none."""
    import tempfile

    needed = {sys.executable, *python_folders(), tempfile.gettempdir()}
    for path in sorted(map(os.path.realpath, needed)):
        while path != os.path.dirname(path):
            if not os.stat(path).st_mode & stat.S_IXOTH:
                return path
            path = os.path.dirname(path)
    return ""


def python_folders() -> list[str]:
    """Folders of Python, its packages and LLVM."""
    import site

    found = {sys.prefix, sys.base_prefix, sys.exec_prefix, *site.getsitepackages()}
    if llvm := os.environ.get("DRJIT_LIBLLVM_PATH"):
        found.add(os.path.dirname(os.path.realpath(llvm)))
    return sorted(path for path in found if os.path.isdir(path))


def private() -> list[str]:
    """Folders that hold no part of the system: homes, other clones, logs of a platform."""
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
    allowed: int,
) -> None:
    """Enter a domain of Landlock, in which the rights `allowed` stay."""
    version = landlock_version()
    handled = sum(rights for since, rights in SINCE.items() if since <= version)
    handled &= ~allowed
    attributes = [handled] + [TCP] * (version >= 4) + [OUTSIDE] * (version >= 6)
    packed = struct.pack(f"={len(attributes)}Q", *attributes)
    rules = _syscall(CREATE_RULESET, packed, ctypes.c_size_t(len(packed)), 0)
    for path in everything_but(hidden, readable):
        _allow(rules, path, (EXECUTE | READ_FILE | READ_DIR) & handled)
    for path in listed:
        _allow(rules, path, READ_DIR & handled)
    for path in writable:
        _allow(rules, path, handled & ~IOCTL_DEV)
    _syscall(RESTRICT_SELF, rules, 0)
    os.close(rules)


def everything_but(hidden: Iterable[str], readable: Iterable[str] = ()) -> Iterator[str]:
    """Yield the largest folders, and files, that hold all but `hidden`, unless `readable` inside.

    Example:
        >>> list(everything_but([]))
        ['/']
        >>> "/usr" in everything_but(["/home"]), "/home" in everything_but(["/home"])
        (True, False)
        >>> "/usr/bin" in everything_but(["/usr"], ["/usr/bin"])
        True
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
    for path in map(os.path.realpath, readable):
        if any(path.startswith(folder.rstrip("/") + "/") for folder in away):
            yield from walk(path)


def _allow(rules: int, path: str, rights: int) -> None:
    try:
        fd = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    if not os.path.isdir(path):
        rights &= FILE_RIGHTS
    with suppress(OSError):  # a file system that knows no rules stays forbidden
        _syscall(ADD_RULE, rules, 1, struct.pack("=Qi", rights, fd), 0)
    os.close(fd)


def _syscall(number: int, *arguments) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    result = libc.syscall(ctypes.c_long(number), *arguments)
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def _become(uid: int, reads_all: bool) -> None:
    """Become another user without any rights, but perhaps that of reading everything."""
    if reads_all:
        prctl(SET_KEEPCAPS, 1)
    os.setgroups([])
    os.setresgid(uid, uid, uid)
    os.setresuid(uid, uid, uid)
    if reads_all:
        bit = 1 << READ_ALL
        header = struct.pack("=Ii", 0x20080522, 0)
        data = struct.pack("=6I", bit, bit, bit, 0, 0, 0)  # effective, permitted, inheritable
        if ctypes.CDLL(None).capset(header, data) != 0:
            raise OSError("root may not keep its right to read")
        prctl(CAP_AMBIENT, 2, READ_ALL)  # through the start of the command


def _leave_the_network() -> None:
    """Enter an empty network and IPC namespace, if the kernel lets this user."""
    if os.geteuid() == 0:
        ctypes.CDLL(None).unshare(NEWNET | NEWIPC)
        return
    child = os.fork()  # some systems allow a part, which would leave this process without a user
    if child == 0:
        os._exit(0 if _unshare_as_user() else 1)
    if os.waitpid(child, 0)[1] == 0:
        _unshare_as_user()


def _unshare_as_user() -> bool:
    """Enter namespaces as an ordinary user; whether it has worked."""
    uid, gid = os.getuid(), os.getgid()
    if ctypes.CDLL(None).unshare(NEWUSER | NEWNET | NEWIPC) != 0:
        return False
    maps = {"setgroups": "deny", "uid_map": f"{uid} {uid} 1", "gid_map": f"{gid} {gid} 1"}
    with suppress(OSError):
        for name, text in maps.items():
            with open(f"/proc/self/{name}", "w", encoding="ascii") as file:
                file.write(text)
        return True
    return False


def prctl(option: int, value: int, more: int = 0) -> int:
    """Linux's system call of this name, with one or two arguments."""
    word = ctypes.c_ulong
    return ctypes.CDLL(None).prctl(option, word(value), word(more), word(0), word(0))


if __name__ == "__main__":
    confine(**json.loads(sys.argv[1]))
    os.execvp(sys.argv[2], sys.argv[2:])
