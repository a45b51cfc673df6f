"""Storage of the values of a film with a third axis, e.g. time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import memory

# Largest number of samples of a pixel between two flushes. With 2^20 samples, the rounding errors
# of single precision would make sums 0.4 % too low
MAX_ADDED = 1 << 16

PACKET = 4  # Number of floats in a packet

# Host memory that `take` needs on a GPU, in films: the transfer of Dr.Jit, and a copy to write to
TAKEN_COPIES = 2.0

CHUNK = 1 << 16  # Number of cells that are moved together by `take`


class Histogram:
    """A row of `count` cells for each pixel, each cell with 1, 3, 4 or 12 channels.

    RGB is padded to four floats, so that a single scatter operation adds a packet of four floats to
    a cell. 12 channels are three packets.

    Attributes:
        shape: (height, width, count, channels).
        stride: Number of floats of a cell, including padding.

    Raises:
        MemoryError: If the cells do not fit into memory. The message describes what fits.
    """

    def __init__(self, height: int, width: int, count: int, channels: int) -> None:
        memory.require_film(height, width, count, channels)
        self.shape = (height, width, count, channels)
        self.stride = memory.stride(channels)

        # Sums since the last flush
        self._sums = dr.zeros(mi.Float, height * width * count * self.stride)

        # Flushed sums of all cells
        self._flushed: mi.Float | None = None

        # Flushed sums of some pixels: indices of floats, and sums
        self._flushed_pixels: tuple[mi.UInt32, mi.Float] | None = None

    def add(
        self,
        values: Sequence[mi.Float],
        x: mi.Int32,
        y: mi.Int32,
        k: mi.UInt32,
        active: mi.Bool,
        *,
        private: bool,
    ) -> None:
        """Add one value per channel to cell `k` of pixel (x, y); pixels outside are ignored.

        Args:
            values: The value of each channel.
            x: Column of the pixel.
            y: Row of the pixel.
            k: Index of the cell.
            active: Active lanes.
            private: Whether only one thread adds to each pixel, so that atomic additions are not
                needed. Lanes of one vector may share a pixel if there are several channels, but not
                if there is a single channel.
        """
        # Find the cell
        height, width, count, _ = self.shape
        active = active & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        cell = mi.UInt32(y * width + x) * count + k
        mode = dr.ReduceMode.NoConflicts if private else dr.ReduceMode.Auto
        add = dr.ReduceOp.Add
        target = self._sums
        if private and self.stride > 1:
            # Add packets of four floats
            padded = [*values, *[0.0] * (self.stride - len(values))]
            packets = self.stride // PACKET
            for part in range(packets):
                packet = mi.ArrayXf(padded[PACKET * part :][:PACKET])
                index = cell if packets == 1 else cell * packets + part
                dr.scatter_reduce(add, target, packet, index, active, mode)
        else:
            # Add single channels. Dr.Jit first sums the lanes that add to the same float, which
            # reduces rounding errors
            for c, value in enumerate(values):
                dr.scatter_reduce(add, target, value, cell * self.stride + c, active, mode)

    def flush(self) -> None:
        """Move all sums to a second array, because single precision loses small addends."""
        if self._flushed is None:
            self._flushed = self._sums
        else:
            self._add(self._flushed, self._sums)
        self._sums = dr.zeros(mi.Float, dr.width(self._sums))

    def flush_pixels(self, pixels: mi.UInt32) -> None:
        """Move the sums of some pixels to a second array, which needs memory for these pixels only.

        Args:
            pixels: Indices of the pixels, row by row. All calls must pass the same pixels.
        """
        # Gather the sums of the pixels, and add earlier flushed sums
        per_pixel = self.shape[2] * self.stride
        line, column = _divided(len(pixels) * per_pixel, per_pixel)
        index = dr.gather(mi.UInt32, pixels, line) * per_pixel + column
        flushed = dr.gather(mi.Float, self._sums, index)
        if self._flushed_pixels is not None:
            flushed += self._flushed_pixels[1]

        # Evaluate before the sums are cleared, because the scatter would otherwise copy all sums
        dr.eval(flushed, index)
        dr.scatter(self._sums, mi.Float(0), index, mode=dr.ReduceMode.NoConflicts)
        dr.eval(self._sums)
        self._flushed_pixels = index, flushed

    @property
    def sums(self) -> mi.Float:
        """Sums of all cells, with padding."""
        if self._flushed is not None:
            self._add(self._flushed, self._sums)
            self._sums = self._flushed
            self._flushed = None
        if self._flushed_pixels is not None:
            index, flushed = self._flushed_pixels
            dr.scatter_add(self._sums, flushed, index, mode=dr.ReduceMode.NoConflicts)
            self._flushed_pixels = None
        return self._sums

    @staticmethod
    def _add(target: mi.Float, source: mi.Float) -> None:
        """Add one array to another in place, which does not allocate memory."""
        everywhere = dr.arange(mi.UInt32, dr.width(source))
        dr.scatter_add(target, source, everywhere, mode=dr.ReduceMode.NoConflicts)
        dr.eval(target)

    def scale(self, factor: float) -> None:
        """Multiply all cells by a number."""
        self._sums = self.sums * factor
        self._flushed = None

    def state(self) -> dict[str, np.ndarray]:
        """Return the content for a checkpoint, as arrays that may share memory with the cells."""
        dr.eval(self._sums)
        parts = {"sums": self._sums, "flushed": self._flushed}
        if self._flushed_pixels is not None:
            parts |= {
                "flushed_index": self._flushed_pixels[0],
                "flushed_pixels": self._flushed_pixels[1],
            }
        return {name: np.asarray(part) for name, part in parts.items() if part is not None}

    def restore(self, state: Mapping[str, np.ndarray], factor: float) -> None:
        """Restore the content from a `state`, multiplied by a factor."""

        def scaled(name: str) -> mi.Float:
            """Return an array of the state times the factor, as an input of kernels."""
            values = mi.Float(state[name])
            values = values if factor == 1 else values * factor
            dr.make_opaque(values)
            return values

        self._sums = scaled("sums")
        self._flushed = scaled("flushed") if "flushed" in state else None
        if "flushed_index" in state:
            index = mi.UInt32(state["flushed_index"])
            dr.make_opaque(index)
            self._flushed_pixels = index, scaled("flushed_pixels")

    def merge(self, tile: Histogram, x: int, y: int) -> None:
        """Add the cells of a smaller histogram, with its first pixel at pixel (x, y)."""
        height, width, _, _ = tile.shape
        pixel = self.shape[2] * self.stride
        line, column = _divided(height * width * pixel, width * pixel)
        dr.scatter_add(self._sums, tile.sums, ((line + y) * self.shape[1] + x) * pixel + column)

    def tensor(self, pixel_scale: mi.Float | None = None) -> mi.TensorXf:
        """Return all cells without padding as a tensor, times a factor of each pixel."""
        height, width, count, channels = self.shape
        values = self._gather(dr.arange(mi.UInt32, height * width * count))
        return mi.TensorXf(self._scaled(values, count * channels, pixel_scale), self.shape)

    def slice(self, k: int, pixel_scale: mi.Float | None = None) -> mi.TensorXf:
        """Return cell `k` of all pixels as a tensor of shape (height, width, channels)."""
        height, width, count, channels = self.shape
        values = self._gather(dr.arange(mi.UInt32, height * width) * count + k)
        values = self._scaled(values, channels, pixel_scale)
        return mi.TensorXf(values, (height, width, channels))

    def take(self, pixel_scale: mi.Float | None = None) -> np.ndarray:
        """Return `tensor` as a NumPy array that reuses the memory of the cells.

        The histogram cannot be used afterwards.
        """
        # The memory of the cells, or a copy if the cells are on another device
        height, width, _, channels = self.shape
        values = np.asarray(self.sums)
        if not values.flags.writeable:
            values = values.copy()

        # Remove the padding in place
        cells = values.reshape(-1, self.stride)
        if channels < self.stride:
            for first in range(0, len(cells), CHUNK):
                packed = cells[first : first + CHUNK, :channels].ravel()
                values[channels * first :][: packed.size] = packed
        result = values[: channels * len(cells)].reshape(self.shape)

        # Scale the pixels, and release the cells
        if pixel_scale is not None:
            result *= np.asarray(pixel_scale).reshape(height, width, 1, 1)
        del self._sums, self._flushed
        dr.flush_malloc_cache()
        return result

    def _gather(self, cell: mi.UInt32) -> mi.Float:
        """Return the channels of the cells with these indices, without padding, cell by cell."""
        if self.stride == 1:
            return dr.gather(mi.Float, self.sums, cell)
        if self.stride == self.shape[3]:
            line, channel = _divided(dr.width(cell) * self.stride, self.stride)
            first = dr.gather(mi.UInt32, cell, line) * self.stride
            return dr.gather(mi.Float, self.sums, first + channel)
        padded = dr.gather(mi.Vector4f, self.sums, cell)
        return dr.ravel(mi.Color3f(padded.x, padded.y, padded.z))

    @staticmethod
    def _scaled(values: mi.Float, per_pixel: int, pixel_scale: mi.Float | None) -> mi.Float:
        """Multiply the values of each pixel by the pixel's scale."""
        if pixel_scale is None:
            return values
        pixel = dr.arange(mi.UInt32, dr.width(values)) // per_pixel
        return values * dr.gather(mi.Float, pixel_scale, pixel)


def _divided(count: int, divisor: int) -> tuple[mi.UInt32, mi.UInt32]:
    """Return quotients and remainders of the numbers 0, ..., `count` - 1 by a divisor."""
    index = dr.arange(mi.UInt32, count)
    quotient = index // divisor
    return quotient, index - quotient * divisor
