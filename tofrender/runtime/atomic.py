"""Atomic output: temporary files that replace their targets on success, locks, and checks."""

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
except ImportError:
    fcntl = None  # Windows does not have these locks

TEMPORARY_PREFIX = ".tofrender-"
_ASIDE = "-earlier-"
_ALLOWED = "must lie in a folder that you may write to"
DISK_FULL = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}


@contextmanager
def replacing(
    path: str | os.PathLike, *, folder: bool = False, needed_bytes: int | None = None
) -> Iterator[Path]:
    """Yield a hidden temporary path that becomes `path` when the block succeeds.

    If an error, a full disk or Ctrl-C ends the block, the temporary is removed, and an earlier
    `path` stays unchanged. The temporary is in the folder of `path` and has the same suffix.
    Missing parent folders are created. The content is on the disk before the temporary is renamed.
    Symbolic links are followed. On Linux, a folder replaces another folder in one exchange.
    Elsewhere the other folder is moved aside first.

    Args:
        path: File or folder to write.
        folder: Whether the temporary is an empty folder. Otherwise it is a file that does not exist
            yet.
        needed_bytes: Size of the content for the message of a full disk; None if it is unknown.

    Yields:
        The temporary path.

    Raises:
        OSError: The disk is full, or `path` cannot be written.

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
    temporary = sibling(target, f"-{secrets.token_hex(4)}{target.suffix}")
    try:
        if folder:
            temporary.mkdir()
        yield temporary
        sync(temporary)
        move_into_place(temporary, target)
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        remove(temporary)  # The message contains the free space without the temporary
        raise disk_full(path, needed_bytes) from None
    finally:
        remove(temporary)


def sibling(path: str | os.PathLike, ending: str) -> Path:
    """Return a hidden path in the folder of `path`.

    The name contains a hash of the name of `path`, because the name itself may be too long.
    """
    target = Path(os.path.realpath(path))
    digest = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]
    return target.with_name(f"{TEMPORARY_PREFIX}{digest}{ending}")


def part_path(path: Path, number: int) -> Path:
    """Return the file of part `number` of a checkpoint of several renders."""
    return path.with_suffix(f".{number}{path.suffix}")


def remove_leftovers(path: str | os.PathLike) -> None:
    """Remove temporary files of killed writers of `path`, and restore a folder moved aside.

    The caller must hold the lock, so that no other process is writing `path`.
    """
    target = Path(os.path.realpath(path))
    for leftover in target.parent.glob(f"{sibling(path, '').name}-*"):
        if leftover.name.startswith(sibling(path, _ASIDE).name) and not target.exists():
            os.rename(leftover, target)
        else:
            remove(leftover)


@contextmanager
def locked(path: str | os.PathLike, name: str = "path") -> Iterator[None]:
    """Hold the lock for writing `path`, which need not exist.

    The block has no effect if the system or the file system does not support locks.

    Raises:
        FileExistsError: Another process holds the lock. The message names `path` as `name`.
    """
    lock = sibling(path, ".lock")
    lock.parent.mkdir(parents=True, exist_ok=True)
    file = _lock(path, name, lock)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(file)


def _lock(path: str | os.PathLike, name: str, lock: Path) -> int:
    """Create and lock the file `lock`, and return its descriptor.

    Args:
        path: Output that the lock protects, for the error message.
        name: Name of the parameter that contains the path, for the error message.
        lock: Path of the lock file.

    Raises:
        FileExistsError: Another process has locked the file.
    """
    while True:
        file = os.open(lock, os.O_CREAT | os.O_RDWR, 0o666)
        try:
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(file).st_ino == os.stat(lock).st_ino:
                return file
        except FileNotFoundError:
            pass  # Its holder has just removed the file
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
                return file
            os.close(file)
            raise FileExistsError(
                f"{name} = {path}: another process is writing it. Wait until the process ends"
            ) from None
        os.close(file)


def check_file(
    path: str | os.PathLike,
    *suffixes: str,
    overwrite: bool,
    name: str = "path",
    needed_bytes: int = 0,
) -> Path:
    """Require the name of a file that can be written, and return its path.

    Args:
        path: The file.
        *suffixes: Allowed suffixes; without them, all suffixes are allowed.
        overwrite: Whether the file may exist.
        name: Name in messages.
        needed_bytes: Space that the file needs on the disk.

    Raises:
        ValueError: Another suffix.
        OSError: The file exists, cannot be written, or does not fit on the disk.
    """
    target = checks.path(name, path)
    overwrite = checks.boolean("overwrite", overwrite)
    if suffixes and target.suffix.lower() not in suffixes:
        allowed = " or ".join(filter(None, [", ".join(suffixes[:-1]), suffixes[-1]]))
        raise ValueError(f"{name} = {path}: must be a file name that ends in {allowed}")
    if os.path.isdir(target):
        raise FileExistsError(f"{name} = {path}: is a folder; must be the name of a file")
    if os.path.exists(target) and not overwrite:
        raise FileExistsError(f"{name} = {path}: exists; must be new, or pass overwrite=True")
    check_writable(path, needed_bytes)
    return target


def check_writable(path: str | os.PathLike, needed_bytes: int = 0) -> None:
    """Raise an OSError if `path` cannot be created, or if its disk is too full.

    The function tries to create a temporary folder, because permission bits do not apply to root.
    """
    try:
        # Missing parents are tested below. Other errors are, for example, loops of links.
        with suppress(FileNotFoundError, NotADirectoryError):
            os.stat(path)
    except OSError as error:
        raise PermissionError(
            f"path = {path}: cannot be written ({error.strerror}); {_ALLOWED}"
        ) from None
    parent = existing_parent(path)
    try:
        os.rmdir(tempfile.mkdtemp(".probe", TEMPORARY_PREFIX, parent))
    except OSError as error:
        if error.errno in DISK_FULL:
            raise disk_full(path, None) from None
        raise PermissionError(
            f"path = {path}: cannot write in {parent} ({error.strerror}); {_ALLOWED}"
        ) from None
    if shutil.disk_usage(parent).free < needed_bytes:
        raise disk_full(path, needed_bytes)


def disk_full(path: str | os.PathLike, needed_bytes: int | None) -> OSError:
    """Return the error of a disk without space for `needed_bytes` at `path`."""
    folder = existing_parent(path)
    free = f"{readable(shutil.disk_usage(folder).free)} is free"
    if hasattr(os, "statvfs"):
        disk = os.statvfs(folder)
        if disk.f_files and not disk.f_favail:  # Some file systems do not count inodes
            free = "no inode is free for another file"
    needed = "more" if needed_bytes is None else f"up to {readable(needed_bytes)}"
    error = OSError(f"path = {path}: the disk is too full; needs {needed}, {free}")
    error.errno = errno.ENOSPC
    return error


def readable(count: float) -> str:
    """Format a number of bytes with a binary unit."""
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if count < 1024:
            return f"{count:.4g} {unit}"
        count /= 1024
    return f"{count:.4g} TiB"


def existing_parent(path: str | os.PathLike) -> Path:
    """Return the closest parent of `path` that exists."""
    return next(each for each in Path(os.path.realpath(path)).parents if os.path.exists(each))


def remove(path: Path) -> None:
    """Remove a file or a folder with its content, if it exists."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def sync(path: Path, deep: bool = True) -> None:
    """Wait until a file, or a folder with its content if `deep`, is on the disk."""
    is_folder = path.is_dir()
    if is_folder and deep:
        for child in path.iterdir():
            sync(child)
    if is_folder and os.name == "nt":  # Windows cannot open folders
        return
    file = os.open(path, os.O_RDONLY if os.name != "nt" else os.O_RDWR)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def move_into_place(temporary: Path, target: Path) -> None:
    """Rename a file or folder. If `target` is a folder, the old folder may end at `temporary`."""
    if not temporary.is_dir():
        os.replace(temporary, target)
    elif not target.exists():
        os.rename(temporary, target)
    else:
        shutil.copymode(target, temporary)
        if not _exchange(temporary, target):
            _move_aside(temporary, target)
    with suppress(OSError):
        sync(target.parent, deep=False)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders in one step. Return False if the system does not support this."""
    if not sys.platform.startswith("linux"):
        return False
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    at_fdcwd = -100
    rename_exchange = 2
    names = at_fdcwd, os.fsencode(one), at_fdcwd, os.fsencode(other)
    return renameat2 is not None and renameat2(*names, rename_exchange) == 0


def _move_aside(temporary: Path, target: Path) -> None:
    """Replace a folder in two steps. If the second step fails, the first step is undone."""
    aside = sibling(target, f"{_ASIDE}{secrets.token_hex(4)}")
    try:
        os.rename(target, aside)
        os.rename(temporary, target)
    except BaseException:
        if aside.exists() and not target.exists():
            os.rename(aside, target)
        raise
    remove(aside)
