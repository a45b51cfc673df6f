"""Reader of MATLAB files of version 5 to 7, for arrays of real numbers and cells of them.

All sizes in a file are compared with the length of the file before memory is allocated. The parser
is pure Python, so that a damaged file is a ValueError. The layout is described in "MAT-File
Format", MathWorks. There, each part of a file is called an element.
"""

import math
import mmap
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..runtime import memory

HEADER_BYTES = 128
ENDIANNESS = {b"IM": "<", b"MI": ">"}  # Last two bytes of the header
MATRIX = 14  # Types of elements
COMPRESSED = 15
NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
CELL_CLASS = 1  # Classes of arrays
OPAQUE_CLASS = 17
NUMERIC_CLASSES = range(6, 16)
COMPLEX_FLAG = 0x800
MOST_AXES = 32  # Largest number of axes in NumPy
HEAD_BYTES = 4096  # Enough for flags, axes and name of an array
ZLIB_RATIO = 1032  # Largest ratio of bytes to compressed bytes
CUT = "is cut short or damaged; must be a whole MATLAB file"


class Element(NamedTuple):
    """Type of an element and its bytes, without padding."""

    kind: int
    content: memoryview


class Head(NamedTuple):
    """Name, class and axes of an array."""

    name: str
    kind: str  # "numbers", "cell" or "other"
    shape: tuple[int, ...]


def list_arrays(file: Path) -> list[Head]:
    """List the arrays of a file without reading their values."""
    content, order = _open(file)
    heads = []
    for element in _elements(content, HEADER_BYTES, order):
        start = _first_bytes(element, order)
        if start.kind == MATRIX:
            heads.append(_head(_elements(start.content, 0, order), order))
    return heads


def read_array(file: Path, name: str) -> np.ndarray:
    """Read an array by its name: real numbers, or objects that are arrays for cells.

    Raises:
        ValueError: The file is damaged, or the array is missing or has another class.
        MemoryError: The array does not fit into memory.
    """
    content, order = _open(file)
    for element in _elements(content, HEADER_BYTES, order):
        start = _first_bytes(element, order)
        if start.kind != MATRIX:
            continue
        head = _head(_elements(start.content, 0, order), order)
        if head.name == name:
            memory.require_free(name, 16 * math.prod(head.shape))
            return np.array(_array(_decompressed(element, order, name), order))
    raise ValueError(f"{name}: is missing; must be in the file")


def _open(file: Path) -> tuple[memoryview, str]:
    """Map a file into memory, and return the order of bytes in its numbers."""
    if file.stat().st_size < HEADER_BYTES:
        raise ValueError(CUT)
    with file.open("rb") as opened:
        content = memoryview(mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ))
    order = ENDIANNESS.get(bytes(content[126:128]))
    if order is None:
        raise ValueError(CUT)
    return content, order


def _elements(content: memoryview, start: int, order: str) -> Iterator[Element]:
    """Split bytes into elements, and check that each element ends within these bytes."""
    while start < len(content):
        if start + 8 > len(content):
            raise ValueError(CUT)
        kind, size = (int(each) for each in _numbers(content[start : start + 8], order + "u4"))
        if kind >> 16:
            # Up to four bytes are stored in the place of the size
            size = kind >> 16
            kind &= 0xFFFF
            if size > 4:
                raise ValueError(CUT)
            first = start + 4
            following = start + 8
        else:
            first = start + 8
            padding = 0 if kind == COMPRESSED else -size % 8
            following = first + size + padding
        if first + size > len(content):
            raise ValueError(CUT)
        yield Element(kind, content[first : first + size])
        start = following


def _first_bytes(element: Element, order: str) -> Element:
    """Return an array without its values if it is compressed."""
    if element.kind != COMPRESSED:
        return element
    try:
        found = memoryview(zlib.decompressobj().decompress(element.content, HEAD_BYTES))
    except zlib.error:
        raise ValueError(CUT) from None
    kind, _ = _tag(found, order)
    return Element(kind, found[8:])


def _decompressed(element: Element, order: str, name: str) -> Element:
    """Return an array with all its bytes. Their number must be as in its tag."""
    if element.kind != COMPRESSED:
        return element
    stream = zlib.decompressobj()
    try:
        first = stream.decompress(element.content, 8)
        kind, size = _tag(memoryview(first), order)
        if size > ZLIB_RATIO * len(element.content) + HEAD_BYTES:
            raise ValueError(CUT)
        memory.require_free(name, 2 * size)
        content = stream.decompress(stream.unconsumed_tail, max(size, 1))
        # The end of the stream has a checksum
        more = stream.decompress(stream.unconsumed_tail, 1)
    except zlib.error:
        raise ValueError(CUT) from None
    if len(content) != size or more or not stream.eof:
        raise ValueError(CUT)
    return Element(kind, memoryview(content))


def _tag(content: memoryview, order: str) -> tuple[int, int]:
    """Return type and size of the element inside a compressed element."""
    if len(content) < 8:
        raise ValueError(CUT)
    kind, size = _numbers(content[:8], order + "u4")
    return int(kind), int(size)


def _head(parts: Iterator[Element], order: str) -> Head:
    """Read the head of an array, its first three parts."""
    flags = _next(parts)
    if flags.kind != 6 or len(flags.content) != 8:
        raise ValueError(CUT)
    flag = int(_numbers(flags.content, order + "u4")[0])
    if flag & 0xFF == OPAQUE_CLASS:  # Its parts have another layout
        return Head("", "other", ())

    axes = _next(parts)
    name = _next(parts)
    if axes.kind != 5 or name.kind != 1:
        raise ValueError(CUT)
    shape = tuple(int(each) for each in _numbers(axes.content, order + "i4"))
    if not 2 <= len(shape) <= MOST_AXES or min(shape) < 0:
        raise ValueError(CUT)

    # Which class of array is it?
    kind = "other"
    if flag & 0xFF == CELL_CLASS:
        kind = "cell"
    elif flag & 0xFF in NUMERIC_CLASSES and not flag & COMPLEX_FLAG:
        kind = "numbers"
    return Head(bytes(name.content).decode("latin-1"), kind, shape)


def _array(element: Element, order: str, in_cell: bool = False) -> np.ndarray:
    """Read the values of an array."""
    if element.kind != MATRIX:
        raise ValueError(CUT)
    if not len(element.content):  # An empty cell
        return np.zeros((0, 0))

    # Read the head
    parts = _elements(element.content, 0, order)
    head = _head(parts, order)
    count = math.prod(head.shape)
    if head.kind == "other" or (in_cell and head.kind == "cell"):
        raise ValueError(f"{head.name or 'a cell'}: must hold real numbers")

    # Read an array for each cell
    if head.kind == "cell":
        # A cell has at least eight bytes
        if 8 * count > len(element.content):
            raise ValueError(CUT)
        cells = np.empty(count, object)
        for k in range(count):
            cells[k] = _array(_next(parts), order, in_cell=True)
        return cells.reshape(head.shape, order="F")

    # Read the numbers
    if not count:
        return np.zeros(head.shape)
    numbers = _next(parts)
    if numbers.kind not in NUMBERS:
        raise ValueError(CUT)
    values = _numbers(numbers.content, order + NUMBERS[numbers.kind])
    if values.size != count:
        raise ValueError(CUT)
    return values.reshape(head.shape, order="F")


def _next(elements: Iterator[Element]) -> Element:
    found = next(elements, None)
    if found is None:
        raise ValueError(CUT)
    return found


def _numbers(content: memoryview, dtype: str) -> np.ndarray:
    if len(content) % np.dtype(dtype).itemsize:
        raise ValueError(CUT)
    return np.frombuffer(content, dtype)
