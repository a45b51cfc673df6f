"""Films and captures that are read in pieces, so that a film on disk may exceed the memory."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Iterator, Sequence
from types import EllipsisType
from typing import Any

import numpy as np

from ..runtime import checks, memory
from ..signals.color import luminance

# Size of a piece that is read from disk [bytes], unless the chunks on disk are larger
PIECE_BYTES = 8 << 20

# Size of a piece of an array in memory [bytes]. The piece and results of it fit into CPU caches
VIEW_BYTES = 1 << 20

# Blocks of rows and frames are read as a whole. They use at most 1 / SHARE of the free memory
SHARE = 8

# Position of a piece: a slice for each axis
Place = tuple[slice, ...]

# Index of an array
Index = int | slice | EllipsisType | tuple[int | slice | EllipsisType | None, ...]


class Cube:
    """Values with the axes (..., bins, channels) that are read in pieces of whole chunks.

    Attributes:
        shape, dtype: Shape and type of the values, as of an array.
        in_memory: Whether the pieces are views of an array in memory.

    Example:
        >>> cube = Cube(np.ones((4, 6, 10, 3)))
        >>> cube.frame(2).shape, cube.read((0, 1)).shape
        ((4, 6, 3), (10, 3))
        >>> sum(values.size for _, values in cube.pieces())
        720
    """

    def __init__(self, values: Any) -> None:
        held = values.data if hasattr(values, "dims") else values
        self.in_memory = not hasattr(held, "dask")
        self._held: Any = np.asarray(held) if self.in_memory else held
        self.shape: tuple[int, ...] = self._held.shape
        self.dtype: np.dtype = self._held.dtype
        self._frames: list[slice] = []
        self._kept: dict[int, np.ndarray] = {}
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[Cube], tuple[object]]:
        """Pickle only the values, without lock and cache."""
        return Cube, (self._held,)

    @classmethod
    def of(cls, name: str, values: object) -> Cube:
        """Return a cube of real numbers.

        Args:
            name: Name of the values, for messages.
            values: A cube, a variable of a Dataset, or an object that NumPy converts.

        Raises:
            ValueError: The values are not real numbers.
        """
        # Keep arrays on disk, and convert other values to an array
        cube = values if isinstance(values, Cube) else None
        if cube is None and hasattr(values, "chunks") and hasattr(values, "dtype"):
            cube = cls(values)
        if cube is None or cube.in_memory:
            cube = cls(checks.real_array(name, values if cube is None else cube.read()))
        if cube.dtype.kind not in "fiu":
            raise ValueError(f"{name} of type {cube.dtype}: must hold real numbers")
        return cube

    @property
    def nbytes(self) -> int:
        """Size of all values [bytes]."""
        return math.prod(self.shape) * self.dtype.itemsize

    def view(self, place: Index) -> Cube:
        """Return a part of the cube, selected by an index, without reading it."""
        return Cube(self._held[place])

    def read(self, place: Index = ...) -> np.ndarray:
        """Read the values that an index selects."""
        return np.asarray(self._held[place])

    def pieces(self) -> Iterator[tuple[Place, np.ndarray]]:
        """Yield positions and values of pieces of a few megabytes, which cover the cube.

        Pieces of the same pixels follow each other in time. In memory, each piece has all bins.
        """
        for place in itertools.product(*self._cuts()):
            yield place, self.read(place)

    def rows(self) -> Iterator[tuple[Place, np.ndarray]]:
        """Yield positions and values of blocks in C order; joined, the blocks are the array."""
        for place in self.row_blocks():
            yield place, self._gather(place)

    def row_blocks(self) -> list[Place]:
        """Return the positions of the blocks of `rows`. Each block has all bins."""
        # Find the first axis along which a row fits into memory
        most = self._most()
        axis = 0
        while axis < len(self.shape) - 3 and self._row_bytes(axis) > most:
            axis += 1

        # Divide this axis, for each index of the axes before
        row = self._row_bytes(axis)
        blocks = _blocks(self._chunks()[axis], self._wanted() // row, most // row)
        return [
            (*(slice(i, i + 1) for i in index), block)
            for index in np.ndindex(*self.shape[:axis])
            for block in blocks
        ]

    def frames(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield bins and values of blocks of bins, (..., bins, channels), which cover the cube."""
        for bins in self._blocks_of_frames():
            yield bins, self._gather((..., bins, slice(None)))

    def frame(self, index: int) -> np.ndarray:
        """Return bin `index`, (..., channels). The block of bins around it is cached.

        The method is thread-safe.
        """
        if self.in_memory:
            return self._held[..., index, :]
        with self._lock:
            # Read the block of the bin
            bins = next(bins for bins in self._blocks_of_frames() if index < bins.stop)
            if bins.start not in self._kept:
                # Keep the latest block in the cache, because another thread may still use it
                for first in list(self._kept)[:-1]:
                    del self._kept[first]
                self._kept[bins.start] = self._gather((..., bins, slice(None)))
            return self._kept[bins.start][..., index - bins.start, :]

    def take(self, positions: np.ndarray) -> np.ndarray:
        """Return the values at some positions of the flattened array, in undefined order."""
        if self.in_memory:
            return self._held.reshape(-1)[positions]

        # Find the index of the piece that contains each position
        cuts = self._cuts()
        stride = math.prod(self.shape)
        number = np.zeros(len(positions), np.int32)
        for size, cut in zip(self.shape, cuts, strict=True):
            stride //= size
            starts = [piece.start for piece in cut]
            number *= len(cut)
            number += np.searchsorted(starts, positions // stride % size, side="right") - 1

        # Sort the positions by piece, and read each piece that contains positions
        positions = positions[np.argsort(number, kind="stable")]
        found = []
        last = 0
        for place, count in zip(itertools.product(*cuts), np.bincount(number), strict=False):
            here = positions[last : last + count]
            last = last + count
            if count:
                at = zip(np.unravel_index(here, self.shape), place, strict=True)
                found.append(self.read(place)[tuple(along - s.start for along, s in at)])
        return np.concatenate(found)

    def _gather(self, place: Index) -> np.ndarray:
        """Read the values that an index selects, with less memory than `read`."""
        if self.in_memory:
            return self.read(place)

        # Read piece by piece: `read` would need the memory of all chunks and of the result
        block = self.view(place)
        values = np.empty(block.shape, self.dtype)
        for here, part in block.pieces():
            values[here] = part
        return values

    def require_finite(self, name: str) -> None:
        """Raise a ValueError if a value is NaN or infinite."""
        if self.dtype.kind == "f":
            parts = (([along.start for along in place], part) for place, part in self.pieces())
            checks.finite_parts(name, parts)

    def luminance(self, name: str) -> np.ndarray:
        """Return the luminance of all values, (..., bins); a view if there is one channel.

        Args:
            name: Name of the values, for messages.

        Raises:
            MemoryError: The array does not fit into memory.
        """
        # Does the array fit into memory?
        channels = self.shape[-1]
        if self.in_memory and channels == 1:
            return luminance(self._held)
        if not self.in_memory:
            memory.require_free(name, self.nbytes // channels + self._piece_bytes())

        # Convert piece by piece
        result = np.empty(self.shape[:-1], np.result_type(self.dtype, 0.0))
        for place, values in self.pieces():
            result[place[:-1]] = luminance(values)
        return result

    def _chunks(self) -> list[Sequence[int]]:
        """Return the sizes of the chunks along each axis.

        In memory, each pixel with all its bins is a chunk.
        """
        if not self.in_memory:
            return list(self._held.chunks)
        count = max(0, len(self.shape) - 2)
        return [*((1,) * size for size in self.shape[:count]), *((n,) for n in self.shape[count:])]

    def _cuts(self) -> list[list[slice]]:
        """Return the slices of the pieces along each axis."""
        # Number of values of a piece, and of the largest chunk
        chunks = self._chunks()
        left = self._wanted() // self.dtype.itemsize
        unit = math.prod(max(along, default=1) for along in chunks)

        # Join chunks along the last axis first, then along the axes before. `unit` is the number
        # of values of a piece with length 1 along the current axis
        cuts: list[list[slice]] = []
        for along in reversed(chunks):
            unit //= max(along, default=1) or 1
            # All channels stay together
            size = left // max(unit, 1) if cuts else sum(along)
            cuts.append(_blocks(along, size))
            unit *= max((cut.stop - cut.start for cut in cuts[-1]), default=1)
        return cuts[::-1]

    def _blocks_of_frames(self) -> list[slice]:
        """Return the bins of each block of `frames`."""
        if not self._frames:
            frame = self.nbytes // max(1, self.shape[-2])
            self._frames = _blocks(self._chunks()[-2], PIECE_BYTES // frame, self._most() // frame)
        return self._frames

    def _row_bytes(self, axis: int) -> int:
        """Return the size of the values at one index of an axis [bytes]."""
        return max(1, math.prod(self.shape[axis + 1 :]) * self.dtype.itemsize)

    def _piece_bytes(self) -> int:
        """Return the size of the largest piece [bytes]."""
        sizes = [max(cut.stop - cut.start for cut in along) for along in self._cuts()]
        return math.prod(sizes) * self.dtype.itemsize

    def _wanted(self) -> int:
        """Return the desired size of a piece [bytes]."""
        return VIEW_BYTES if self.in_memory else PIECE_BYTES

    def _most(self) -> int:
        """Return the largest size of a block of rows or frames [bytes]."""
        return PIECE_BYTES if self.in_memory else max(PIECE_BYTES, memory.free_on_host() // SHARE)


def _blocks(chunks: Sequence[int], wanted: int, most: int | None = None) -> list[slice]:
    """Return slices along an axis, made of joined chunks.

    Args:
        chunks: Sizes of the chunks.
        wanted: Chunks are joined up to this size.
        most: Larger chunks are cut to this size.
    """
    # Join the chunks
    blocks: list[slice] = []
    start = stop = 0
    for size in chunks:
        if stop > start and stop + size - start > wanted:
            blocks.append(slice(start, stop))
            start = stop
        stop += size
    blocks.append(slice(start, stop))

    # Cut blocks that are too long
    longest = max(1, stop if most is None else most)
    return [
        slice(first, min(first + longest, block.stop))
        for block in blocks
        for first in range(block.start, block.stop, longest)
    ]
