"""Seals: checksums after the end of a file, where its format does not read, to detect damage.

Other programs read such a file as any, and drop the seal when they write it. Files without a seal
are accepted.
"""

from __future__ import annotations

import zlib
from pathlib import Path

_MARK = b"\ntofrender crc32 "
_LENGTH = len(_MARK) + 9
_STEP = 1 << 22


def seal(content: bytes) -> bytes:
    """Append a seal to the content of a file."""
    return content + _line(zlib.crc32(content))


def seal_file(path: Path) -> None:
    """Append a seal to a file on the disk."""
    with path.open("r+b") as file:
        checksum = 0
        while part := file.read(_STEP):
            checksum = zlib.crc32(part, checksum)
        file.write(_line(checksum))


def require_unbroken(path: Path) -> None:
    """Raise a ValueError for a file that differs from its seal; one without a seal passes."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _LENGTH))
        found = file.read()
        if _MARK[:10] not in found:
            return
        file.seek(0)
        checksum, left = 0, size - _LENGTH
        while part := file.read(max(0, min(_STEP, left))):
            checksum = zlib.crc32(part, checksum)
            left -= len(part)
    if found != _line(checksum):
        raise ValueError(
            f"path = {path}: is damaged or cut short, its checksum differs; must be as it was saved"
        )


def _line(checksum: int) -> bytes:
    return _MARK + b"%08x\n" % checksum
