"""Write whole or not at all: a temporary sibling that takes its target's place on success."""

from __future__ import annotations

import ctypes
import errno
import hashlib
import os
import secrets
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from . import checks

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None

TEMPORARY_PREFIX = ".tofrender-"
_ASIDE = "-earlier-"
DISK_FULL = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}


@contextmanager
def replacing(
    path: str | os.PathLike, *, folder: bool = False, needed_bytes: int | None = None
) -> Iterator[Path]:
    """Yield a hidden temporary path beside `path` that becomes `path` when the block succeeds.

    Whatever ends the block early (an error, a full disk, Ctrl-C) removes the temporary and leaves
    an earlier `path` as it was. The temporary keeps the suffix of `path`, and missing parent
    folders are made. What was written is on the disk before it takes its place. A folder takes that
    of another in one exchange where the system has that; elsewhere the other is moved aside first.

    Args:
        path: File or folder to write. A symbolic link is followed, not replaced.
        folder: Yield an empty folder instead of the name of a file that does not exist yet.
        needed_bytes: Size to name when the disk is full [bytes].

    Yields:
        The path to write to.

    Raises:
        ValueError: An argument is wrong; one line.
        OSError: The disk is full; one line that names `path` and the bytes needed and free.

    Example:
        >>> import tempfile
        >>> target = Path(tempfile.mkdtemp()) / "note.txt"
        >>> with replacing(target) as temporary:
        ...     _ = temporary.write_text("hello")
        >>> target.read_text()
        'hello'
    """
    target = Path(os.path.realpath(checks.path("path", path)))
    checks.boolean("folder", folder)
    if needed_bytes is not None:
        checks.integer("needed_bytes", needed_bytes, 0, sys.maxsize)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = hidden(target, f"-{secrets.token_hex(4)}{target.suffix}")
    try:
        if folder:
            temporary.mkdir()
        yield temporary
        to_disk(temporary)
        _take_place(temporary, target)
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        remove(temporary)  # before measuring what is free
        raise disk_full(path, needed_bytes) from None
    finally:
        remove(temporary)


def hidden(path: str | os.PathLike, ending: str) -> Path:
    """A hidden name beside `path` that belongs to it, whatever the length of its own."""
    target = Path(os.path.realpath(path))
    digest = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]
    return target.with_name(f"{TEMPORARY_PREFIX}{digest}{ending}")


def remove_leftovers(path: str | os.PathLike) -> None:
    """Remove what writers of `path` that were killed have left beside it.

    A folder that one of them had moved aside goes back. None may be at work: hold the lock.
    """
    target = Path(os.path.realpath(path))
    for left in target.parent.glob(f"{hidden(path, '').name}-*"):
        if left.name.startswith(hidden(path, _ASIDE).name) and not target.exists():
            os.rename(left, target)
        else:
            remove(left)


@contextmanager
def locked(path: str | os.PathLike, name: str = "path") -> Iterator[None]:
    """Be the only one that writes `path`, which need not exist; an error calls it `name`.

    Where a file system or system has no locks, nobody is kept out.

    Raises:
        FileExistsError: Another process holds the lock; one line.

    Example:
        >>> import tempfile
        >>> with locked(tempfile.mkdtemp() + "/film"):
        ...     pass
    """
    lock = hidden(path, ".lock")
    lock.parent.mkdir(parents=True, exist_ok=True)
    file = _lock(path, name, lock)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(file)


def _lock(path: str | os.PathLike, name: str, lock: Path) -> int:
    while True:
        file = os.open(lock, os.O_CREAT | os.O_RDWR, 0o666)
        try:
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(file).st_ino == os.stat(lock).st_ino:
                return file
        except FileNotFoundError:  # Its holder has just removed it
            pass
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
                return file
            os.close(file)
            raise FileExistsError(
                f"{name} = {path}: another process writes it; wait until it is done"
            ) from None
        os.close(file)


def check_writable(path: str | os.PathLike) -> None:
    """Refuse a place where nothing can be made, by trying (modes say nothing to root).

    Raises:
        PermissionError: Nothing may be made there; one line.
        OSError: There is no room for another file; one line.
    """
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError):  # Nothing there, or see below
        pass
    except OSError as error:  # A loop of links, say
        raise PermissionError(
            f"path = {path}: cannot be written ({error.strerror}); must lie in a folder that you "
            "may write to"
        ) from None
    parent = nearest_folder(path)
    try:
        os.rmdir(tempfile.mkdtemp(".probe", TEMPORARY_PREFIX, parent))
    except OSError as error:
        if error.errno in DISK_FULL:
            raise disk_full(path, None) from None
        raise PermissionError(
            f"path = {path}: cannot write in {parent} ({error.strerror}); "
            "must lie in a folder that you may write to"
        ) from None


def disk_full(path: str | os.PathLike, needed_bytes: int | None) -> OSError:
    """The one-line error for a disk without room for `needed_bytes` at `path`."""
    folder = nearest_folder(path)
    free = f"{readable(shutil.disk_usage(folder).free)} is free"
    if hasattr(os, "statvfs"):
        disk = os.statvfs(folder)
        if disk.f_files and not disk.f_favail:  # Some file systems count no inodes
            free = "no inode is free for another file"
    needed = "more" if needed_bytes is None else f"up to {readable(needed_bytes)}"
    error = OSError(f"path = {path}: too little room; needs {needed}, {free}")
    error.errno = errno.ENOSPC
    return error


def readable(count: float) -> str:
    """A number of bytes in a readable unit."""
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if count < 1024:
            return f"{count:.4g} {unit}"
        count /= 1024
    return f"{count:.4g} TiB"


def nearest_folder(path: str | os.PathLike) -> Path:
    """The closest parent of `path` that exists."""
    parent = Path(os.path.realpath(path)).parent
    while not os.path.exists(parent):
        parent = parent.parent
    return parent


def remove(path: Path) -> None:
    """Remove a file or a folder with all that is in it, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def to_disk(path: Path, deep: bool = True) -> None:
    """Wait until a file, or a folder with all that is in it if `deep`, is on the disk."""
    is_folder = path.is_dir()
    if is_folder and deep:
        for child in path.iterdir():
            to_disk(child)
    if is_folder and os.name == "nt":  # It opens none
        return
    file = os.open(path, os.O_RDONLY if os.name != "nt" else os.O_RDWR)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def _take_place(temporary: Path, target: Path) -> None:
    if not temporary.is_dir():
        os.replace(temporary, target)
    elif not target.exists():
        os.rename(temporary, target)
    else:
        shutil.copymode(target, temporary)
        if not _exchange(temporary, target):
            _move_aside(temporary, target)
    with suppress(OSError):
        to_disk(target.parent, deep=False)


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders swap their places in one step; False where the system cannot."""
    if not sys.platform.startswith("linux"):
        return False
    exchange = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    here, swap = -100, 2
    names = os.fsencode(one), os.fsencode(other)
    return exchange is not None and exchange(here, names[0], here, names[1], swap) == 0


def _move_aside(temporary: Path, target: Path) -> None:
    """Replace a folder in two steps, with a way back."""
    aside = hidden(target, f"{_ASIDE}{secrets.token_hex(4)}")
    try:
        os.rename(target, aside)
        os.rename(temporary, target)
    except BaseException:
        if aside.exists() and not target.exists():
            os.rename(aside, target)
        raise
    remove(aside)
