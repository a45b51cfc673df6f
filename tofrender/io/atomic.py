"""Write whole or not at all: a temporary sibling that takes its target's place on success."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

TEMPORARY_PREFIX = ".tofrender-"
_DISK_FULL = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}


@contextmanager
def replacing(
    path: str | os.PathLike, *, folder: bool = False, needed_bytes: int | None = None
) -> Iterator[Path]:
    """Yield a hidden temporary path beside `path` that becomes `path` when the block succeeds.

    Whatever ends the block early (an error, a full disk, Ctrl-C) removes the temporary and leaves
    an earlier `path` as it was. The temporary keeps the suffix of `path`, and missing parent
    folders are made. A folder that is replaced is moved aside, then deleted.

    Args:
        path: File or folder to write. A symbolic link is followed, not replaced.
        folder: Yield an empty folder instead of the name of a file that does not exist yet.
        needed_bytes: Size to name when the disk is full [bytes].

    Yields:
        The path to write to.

    Raises:
        OSError: The disk is full; one line that names `path` and the bytes needed and free.

    Example:
        >>> import tempfile
        >>> target = Path(tempfile.mkdtemp()) / "note.txt"
        >>> with replacing(target) as temporary:
        ...     _ = temporary.write_text("hello")
        >>> target.read_text()
        'hello'
    """
    target = Path(os.path.realpath(path))
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f"{TEMPORARY_PREFIX}{secrets.token_hex(4)}{target.suffix}")
    try:
        if folder:
            temporary.mkdir()
        yield temporary
        _take_place(temporary, target)
    except OSError as error:
        if error.errno not in _DISK_FULL:
            raise
        _remove(temporary)  # before measuring what is free
        raise disk_full(path, needed_bytes) from None
    finally:
        _remove(temporary)


def disk_full(path: str | os.PathLike, needed_bytes: int | None) -> OSError:
    """The one-line error for a disk without room for `needed_bytes` at `path`."""
    free = shutil.disk_usage(nearest_folder(path)).free
    needed = "more" if needed_bytes is None else f"up to {_size(needed_bytes)}"
    error = OSError(f"path = {path}: too little room; needs {needed}, {_size(free)} is free")
    error.errno = errno.ENOSPC
    return error


def _size(count: float) -> str:
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


def _take_place(temporary: Path, target: Path) -> None:
    if not temporary.is_dir():
        os.replace(temporary, target)
        return
    aside = temporary.with_name(f"{temporary.name}.old")
    try:
        if target.exists():
            shutil.copymode(target, temporary)
            os.rename(target, aside)
        os.rename(temporary, target)
    except BaseException:
        if aside.exists() and not target.exists():
            os.rename(aside, target)
        raise
    _remove(aside)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
