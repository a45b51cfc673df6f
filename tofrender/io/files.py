"""Reading and writing of files: seals against damage, errors that name the file, and threads.

A seal is a checksum after the end of a file. The formats ignore these bytes, so that other programs
can read the file. When they write the file again, the seal is lost. Files without a seal are
accepted.
"""

import os
import zlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from ..runtime import checks
from ..runtime.progress import ProgressBar

_MARK = b"\ntofrender crc32 "
_LENGTH = len(_MARK) + 9
_STEP = 1 << 22


def seal(content: bytes) -> bytes:
    """Append a seal to the content of a file."""
    return content + _line(zlib.crc32(content))


def seal_file(path: Path) -> None:
    """Append a seal to a file on the disk."""
    with path.open("r+b") as file:
        file.write(_line(_checksum(file, path.stat().st_size)))


def _require_unbroken(path: Path) -> None:
    """Raise a ValueError for a file that differs from its seal. Accept files without a seal."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _LENGTH))
        found = file.read()
        file.seek(0)
        broken = _MARK[:10] in found and found != _line(_checksum(file, size - _LENGTH))
    if broken:
        raise ValueError("is damaged or cut short (wrong checksum). Restore or write it again")


def _checksum(file: BinaryIO, size: int) -> int:
    """Return the CRC-32 of the next `size` bytes."""
    checksum = 0
    while part := file.read(max(0, min(_STEP, size))):
        checksum = zlib.crc32(part, checksum)
        size -= len(part)
    return checksum


def _line(checksum: int) -> bytes:
    return _MARK + b"%08x\n" % checksum


@contextmanager
def reading(path: str | os.PathLike, allowed: str) -> Iterator[Path]:
    """Check that a file exists and matches its seal, and name it in all errors of the block.

    Libraries raise many types of errors for damaged files. All except MemoryError and ImportError
    become a ValueError. Its message ends with the text `allowed`.
    """
    file = checks.path("path", path)
    # Reading a pipe would wait forever
    if not file.is_file():
        problem = "is not a file" if file.exists() else "does not exist"
        raise FileNotFoundError(f"path = {path}: {problem}; must be {allowed}")
    with named(path):
        try:
            _require_unbroken(file)
            yield file
        except (MemoryError, ImportError):
            raise
        except Exception as error:
            # Shorten the library's message to one line
            reason = " ".join(str(error.args[-1] if error.args else error).split())[:300]
            reason = reason or "cannot be read"
            required = "" if "must" in reason else f"; must be {allowed}"
            raise ValueError(f"{reason}{required}") from None


@contextmanager
def named(path: str | os.PathLike) -> Iterator[None]:
    """Name a file in the errors of the block."""
    try:
        yield
    except (ValueError, MemoryError) as error:
        # Libraries raise a MemoryError without text
        text = str(error) or "does not fit into memory; must be a smaller file"
        text = text if text.startswith("path = ") else f"path = {path}: {text}"
        raise (MemoryError if isinstance(error, MemoryError) else ValueError)(text) from None


def for_each(
    function: Callable[[int], Any], items: Iterable[int], description: str, *, progress: bool
) -> None:
    """Call `function` for each item in threads. The first error or Ctrl-C cancels the others.

    OpenEXR and Pillow release the GIL while they compress and decompress.
    """
    with ThreadPoolExecutor(min(16, os.cpu_count() or 1)) as pool:
        futures = [pool.submit(function, item) for item in items]
        try:
            with ProgressBar(description, len(futures), enabled=progress) as bar:
                for future in as_completed(futures):
                    future.result()
                    bar.update()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def run_concurrently(first: Callable[[], Any], *others: Callable[[], Any]) -> None:
    """Call functions concurrently, the first function in this thread, and wait for all."""
    with ThreadPoolExecutor(max(1, len(others))) as pool:
        futures = [pool.submit(each) for each in others]
        first()
        for each in futures:
            each.result()
