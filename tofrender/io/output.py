"""Checks of output paths before a render starts, and again before a file is replaced."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ..runtime import checks
from ..runtime.atomic import TEMPORARY_PREFIX, check_file, check_writable, replacing
from .command_files import is_listed

LAYOUTS = ("frames", "multipart", "npz")
BYTES_PER_VALUE = {"half": 2, "float": 4}
_MARK = b"tofrender"


def check_output(
    path: str | os.PathLike,
    shape: Sequence[int] | None = None,
    *,
    layout: str = "frames",
    precision: str = "float",
    overwrite: bool = False,
) -> Path:
    """Check that an output can be written, before any work starts.

    Args:
        path: Folder (`layout="frames"`) or file (`"multipart"`: .exr, `"npz"`: .npz).
        shape: (height, width, bins, channels) of the transient, to compare its uncompressed size
            with the free space.
        layout: `"frames"`, `"multipart"` or `"npz"`.
        precision: `"half"` or `"float"`.
        overwrite: Allow an earlier output of this package at `path`.

    Returns:
        `path` as a `Path`.

    Raises:
        ValueError: An unknown layout or precision, or a file name with another suffix.
        OSError: `path` may not be replaced or is not writable, or the disk is too full.

    Example:
        >>> check_output("new_folder", (64, 64, 300, 3)).name
        'new_folder'
    """
    target = checks.path("path", path)
    checks.one_of("layout", layout, LAYOUTS)
    checks.one_of("precision", precision, BYTES_PER_VALUE)
    precision = "float" if layout == "npz" else precision
    needed = 0 if shape is None else stack_bytes(shape, precision)
    if layout == "frames":
        _check_folder(path, overwrite)
        check_writable(path, needed)
        return target
    suffix = ".npz" if layout == "npz" else ".exr"
    return check_file(path, suffix, overwrite=overwrite, needed_bytes=needed)


def stack_bytes(shape: Sequence[int], precision: str = "float") -> int:
    """Return the largest size of a stack (height, width, bins, channels) on disk [bytes]."""
    try:
        height, width, bins, channels = (checks.integer("shape", n, 1, 1 << 40) for n in shape)
    except (TypeError, ValueError):
        allowed = "must be four integers, height, width, bins and channels"
        raise ValueError(f"shape = {checks.quote(shape)}: {allowed}") from None
    values = height * width * (bins + 1) * channels
    return values * BYTES_PER_VALUE[precision] + (bins + 1) * (4096 + 8 * height)


@contextmanager
def output_folder(
    path: str | os.PathLike, *, overwrite: bool = False, needed_bytes: int | None = None
) -> Iterator[Path]:
    """Yield an empty temporary folder that becomes `path` when the block succeeds.

    The folder can contain several outputs, such as a stack, a video and a figure. If `path` exists,
    it must be an empty folder, or, with `overwrite`, a folder with an earlier output of this
    package. This is checked again immediately before the folder is replaced.

    Args:
        path: Folder to create.
        overwrite: Replace an earlier output of this package.
        needed_bytes: Size of the output, for the message if the disk is full [bytes].

    Raises:
        OSError: `path` may not be replaced or is not writable, or the disk is full.
    """
    path = checks.path("path", path)
    if needed_bytes is not None:
        checks.integer("needed_bytes", needed_bytes, 0, 1 << 62)
    _check_folder(path, overwrite)
    check_writable(path)
    with replacing(path, folder=True, needed_bytes=needed_bytes) as temporary:
        yield temporary
        _check_folder(path, overwrite)


def _check_folder(path: str | os.PathLike, overwrite: bool) -> None:
    allowed = "must be a new or empty folder, or one that holds only an earlier output of tofrender"
    overwrite = checks.boolean("overwrite", overwrite)
    target = Path(os.path.realpath(path))
    if not os.path.exists(target):  # Path.exists raises without permission to look
        return

    # Can the folder be replaced at all?
    if not os.path.isdir(target):
        raise FileExistsError(f"path = {path}: is a file; {allowed}")
    if target == Path.cwd() or os.path.ismount(target):
        kind = "the current folder" if target == Path.cwd() else "a mount point"
        raise FileExistsError(
            f"path = {path}: is {kind}, which cannot be replaced; must be a folder inside it"
        )

    # Replace a folder only if all its files are described in `contents`
    files = [file for file in target.iterdir() if not file.name.startswith(TEMPORARY_PREFIX)]
    marked = {f.name for f in files if is_listed(f.name, marked=True) and _has_mark(f)}
    unmarked = sorted(f.name for f in files if f.name not in marked)
    foreign = [name for name in unmarked if not _is_unmarked(name) or not marked]
    if foreign:
        raise FileExistsError(f"path = {path}: contains other files ({foreign[0]}); {allowed}")
    if files and not overwrite:
        raise FileExistsError(
            f"path = {path}: contains an earlier output; pass overwrite=True to replace it"
        )


def _is_unmarked(name: str) -> bool:
    """Return whether this package writes a file of this name without its mark.

    Examples are figures, videos and archives. Such a file can be replaced only if its folder also
    contains a file with the mark, see `contents`.
    """
    return is_listed(name) and not is_listed(name, marked=True)


def _has_mark(file: Path) -> bool:
    if file.suffix == ".zarr":
        file /= "zarr.json"
    if not file.is_file():
        return False
    with open(file, "rb") as stream:
        return _MARK in stream.read(1 << 16)
