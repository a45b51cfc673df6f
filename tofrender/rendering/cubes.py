"""Films and captures read by pieces, so that one on disk may be larger than memory."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Iterator, Sequence
from types import EllipsisType
from typing import Any

import numpy as np

from ..runtime import checks, memory
from ..signals.colour import luminance

PIECE_BYTES = 8 << 20  # Size of a piece that is read from disk [bytes], unless chunks are larger

VIEW_BYTES = 1 << 20
"""Size of a piece in memory [bytes]: it and what is computed of it fit into caches."""

SHARE = 8  # Blocks that are read as a whole, rows and frames, take at most this part of free memory
Place = tuple[slice, ...]  # Position of a piece: a slice for each axis

Index = int | slice | EllipsisType | tuple[int | slice | EllipsisType | None, ...]


class Cube:
    """Values with the axes (..., bins, channels), read by pieces that end where chunks do.

    Attributes:
        shape, dtype: As of an array.
        in_memory: Whether pieces are views of an array.

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
        """Pickle the values alone, without lock and cache."""
        return Cube, (self._held,)

    @classmethod
    def of(cls, name: str, values: object) -> Cube:
        """A cube of real numbers: of a cube, a Dataset's variable, or what NumPy converts."""
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
        """The part that an index of an array selects, not read yet."""
        return Cube(self._held[place])

    def read(self, place: Index = ...) -> np.ndarray:
        """The values that an index of an array selects."""
        return np.asarray(self._held[place])

    def pieces(self) -> Iterator[tuple[Place, np.ndarray]]:
        """All values in pieces of a few megabytes.

        Those of the same pixels come one after the other in time; in memory each has all bins.
        """
        for place in itertools.product(*self._cuts()):
            yield place, self.read(place)

    def rows(self) -> Iterator[tuple[Place, np.ndarray]]:
        """All values in blocks that are the array in C order, one after the other."""
        for place in self.row_blocks():
            yield place, self._gather(place)

    def row_blocks(self) -> list[Place]:
        """Positions of the blocks of `rows`; each has all bins."""
        most, axis = self._most(), 0
        while axis < len(self.shape) - 3 and self._row_bytes(axis) > most:
            axis += 1
        row = self._row_bytes(axis)
        blocks = _blocks(self._chunks()[axis], self._wanted() // row, most // row)
        return [
            (*(slice(i, i + 1) for i in index), block)
            for index in np.ndindex(*self.shape[:axis])
            for block in blocks
        ]

    def frames(self) -> Iterator[tuple[slice, np.ndarray]]:
        """All values in blocks of bins, (..., bins, channels)."""
        for bins in self._blocks_of_frames():
            yield bins, self._gather((..., bins, slice(None)))

    def frame(self, index: int) -> np.ndarray:
        """Bin `index`, (..., channels). Neighbours are kept, for whatever thread asks for them."""
        if self.in_memory:
            return self._held[..., index, :]
        with self._lock:
            bins = next(bins for bins in self._blocks_of_frames() if index < bins.stop)
            if bins.start not in self._kept:
                for first in list(self._kept)[:-1]:  # The last one may be in use for a while
                    del self._kept[first]
                self._kept[bins.start] = self._gather((..., bins, slice(None)))
            return self._kept[bins.start][..., index - bins.start, :]

    def take(self, positions: np.ndarray) -> np.ndarray:
        """Values at some positions of the flattened array, in any order."""
        if self.in_memory:
            return self._held.reshape(-1)[positions]
        cuts, stride = self._cuts(), math.prod(self.shape)
        number = np.zeros(len(positions), np.int32)  # Of the piece
        for size, cut in zip(self.shape, cuts, strict=True):
            stride //= size
            starts = [piece.start for piece in cut]
            number *= len(cut)
            number += np.searchsorted(starts, positions // stride % size, side="right") - 1
        positions = positions[np.argsort(number, kind="stable")]
        found, last = [], 0
        for place, count in zip(itertools.product(*cuts), np.bincount(number), strict=False):
            here, last = positions[last : last + count], last + count
            if count:
                at = zip(np.unravel_index(here, self.shape), place, strict=True)
                found.append(self.read(place)[tuple(along - s.start for along, s in at)])
        return np.concatenate(found)

    def _gather(self, place: Index) -> np.ndarray:
        """As `read`, with no piece in memory twice."""
        if self.in_memory:
            return self.read(place)
        block = self.view(place)
        values = np.empty(block.shape, self.dtype)
        for here, part in block.pieces():
            values[here] = part
        return values

    def require_finite(self, name: str) -> None:
        """Refuse values that are NaN or infinite."""
        if self.dtype.kind == "f":
            parts = (([along.start for along in place], part) for place, part in self.pieces())
            checks.finite_parts(name, parts)

    def luminance(self, name: str) -> np.ndarray:
        """Luminance of all values as an array (..., bins), a view if they have no colours."""
        channels = self.shape[-1]
        if self.in_memory and channels == 1:
            return luminance(self._held)
        if not self.in_memory:
            memory.require_free(name, self.nbytes // channels + self._piece_bytes())
        result = np.empty(self.shape[:-1], np.result_type(self.dtype, 0.0))
        for place, values in self.pieces():
            result[place[:-1]] = luminance(values)
        return result

    def _chunks(self) -> list[Sequence[int]]:
        """Sizes of chunks along each axis. In memory, any pixel is one, with all its bins."""
        if not self.in_memory:
            return list(self._held.chunks)
        count = max(0, len(self.shape) - 2)
        return [*((1,) * size for size in self.shape[:count]), *((n,) for n in self.shape[count:])]

    def _cuts(self) -> list[list[slice]]:
        """Slices of the pieces along each axis."""
        chunks, left = self._chunks(), self._wanted() // self.dtype.itemsize
        unit = math.prod(max(along, default=1) for along in chunks)  # Values of a chunk
        cuts: list[list[slice]] = []
        for along in reversed(chunks):
            unit //= max(along, default=1) or 1
            size = left // max(unit, 1) if cuts else sum(along)  # Channels stay together
            cuts.append(_blocks(along, size))
            unit *= max((cut.stop - cut.start for cut in cuts[-1]), default=1)
        return cuts[::-1]

    def _blocks_of_frames(self) -> list[slice]:
        if not self._frames:
            frame = self.nbytes // max(1, self.shape[-2])
            self._frames = _blocks(self._chunks()[-2], PIECE_BYTES // frame, self._most() // frame)
        return self._frames

    def _row_bytes(self, axis: int) -> int:
        return max(1, math.prod(self.shape[axis + 1 :]) * self.dtype.itemsize)

    def _piece_bytes(self) -> int:
        sizes = [max(cut.stop - cut.start for cut in along) for along in self._cuts()]
        return math.prod(sizes) * self.dtype.itemsize

    def _wanted(self) -> int:
        """Bytes of a piece."""
        return VIEW_BYTES if self.in_memory else PIECE_BYTES

    def _most(self) -> int:
        """Bytes of a block that is read as a whole."""
        return PIECE_BYTES if self.in_memory else max(PIECE_BYTES, memory.free_on_host() // SHARE)


def _blocks(chunks: Sequence[int], wanted: int, most: int | None = None) -> list[slice]:
    """Chunks along an axis, joined while they are `wanted` long at most, then cut to `most`."""
    blocks: list[slice] = []
    start = stop = 0
    for size in chunks:
        if stop > start and stop + size - start > wanted:
            blocks.append(slice(start, stop))
            start = stop
        stop += size
    blocks.append(slice(start, stop))
    longest = max(1, stop if most is None else most)
    return [
        slice(first, min(first + longest, block.stop))
        for block in blocks
        for first in range(block.start, block.stop, longest)
    ]
