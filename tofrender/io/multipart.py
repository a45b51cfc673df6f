"""Multi-part EXR files, joined from single-part files.

OpenEXR's Python writer needs all parts in memory at once, copies them, and compresses them one by
one. Compressed chunks are the same in both kinds of file. Therefore threads can encode the parts,
and this module appends their chunks in any order ("OpenEXR File Layout", openexr.com).
"""

import struct
from collections.abc import Sequence
from threading import Lock
from typing import BinaryIO

_MULTIPART_FLAG = 0x1000


class MultipartWriter:
    """Writer that joins single-part EXR files of one size in an empty file.

    The headers of all parts after the first must be as long as the header of the `second` part.
    """

    def __init__(self, file: BinaryIO, names: Sequence[str], first: bytes, second: bytes):
        self.file = file
        self.names = names
        self.lock = Lock()
        self.headers = [b""] * len(names)
        self.offsets = [b""] * len(names)
        self.version = struct.unpack_from("<i", first, 4)[0] | _MULTIPART_FLAG

        # Leave space for magic number, version, headers and the tables of chunk offsets
        headers = len(self._header(first, names[0]))
        headers += len(self._header(second, names[1])) * (len(names) - 1)
        file.seek(8 + headers + 1 + 8 * _chunk_count(first) * len(names))

    def add(self, number: int, part: bytes) -> None:
        """Append the chunks of a part; threads may call this in any order."""
        self.headers[number] = self._header(part, self.names[number])
        position = _header_end(part) + 8 * _chunk_count(part)
        chunks = []
        lengths = []
        while position < len(part):
            size = 8 + struct.unpack_from("<i", part, position + 4)[0]  # row, size, data
            chunks.append(struct.pack("<i", number) + part[position : position + size])
            lengths.append(4 + size)
            position += size

        # Append the chunks, and note their offsets for the table
        with self.lock:
            start = self.file.tell()
            self.file.write(b"".join(chunks))
        offsets = [start + sum(lengths[:index]) for index in range(len(lengths))]
        self.offsets[number] = struct.pack(f"<{len(offsets)}q", *offsets)

    def finish(self) -> None:
        """Write the headers and the tables of chunk offsets."""
        self.file.seek(0)
        self.file.write(struct.pack("<2i", 20000630, self.version))
        self.file.write(b"".join(self.headers) + b"\0" + b"".join(self.offsets))

    def _header(self, part: bytes, name: str) -> bytes:
        """Return the header of a part with the attributes that a multi-part file needs."""
        attributes = part[8 : _header_end(part) - 1]
        label = name.encode()
        attributes += b"name\0string\0" + struct.pack("<i", len(label)) + label
        attributes += b"chunkCount\0int\0" + struct.pack("<2i", 4, _chunk_count(part))
        return attributes + b"\0"


def _header_end(part: bytes) -> int:
    """Return the position of the table of chunk offsets."""
    position = 8  # magic number, version
    while part[position]:  # name, type, size, value; an empty name ends the header
        position = part.index(b"\0", part.index(b"\0", position) + 1) + 1
        position += 4 + struct.unpack_from("<i", part, position)[0]
    return position + 1


def _chunk_count(part: bytes) -> int:
    table = _header_end(part)
    return (struct.unpack_from("<q", part, table)[0] - table) // 8
