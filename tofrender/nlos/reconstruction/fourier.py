"""Fourier transforms of zero-padded data, and their memory."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft

from ...runtime import memory

# SciPy's transforms, without types that type checkers could infer
fft: Any = scipy.fft


def require_memory(method: str, shape: Sequence[int], copies: float) -> None:
    """Raise a MemoryError if the complex arrays of a method do not fit into memory.

    Args:
        method: Name of the method, for the message.
        shape: Shape of an array.
        copies: Number of such arrays.
    """
    needed = copies * 8 * math.prod(shape)
    free = memory.free_on_host()
    if needed > free:
        raise MemoryError(
            f"method = {method!r}: it needs {needed / 2**30:.1f} GiB, but {free / 2**30:.1f} GiB "
            "are free. Use a capture of fewer points or bins, or method 'bp'"
        )


def forward(values: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Return the spectrum of real values (rows, columns, bins), padded with zeros to `shape`.

    The result is complex64, (shape[0], shape[1], shape[2] // 2 + 1). The axes are transformed one
    after the other, which avoids most transforms of rows of zeros.
    """
    spectrum = fft.rfft(values, shape[2], axis=2, workers=-1)
    spectrum = fft.fft(spectrum, shape[1], axis=1, workers=-1, overwrite_x=True)
    return fft.fft(spectrum, shape[0], axis=0, workers=-1, overwrite_x=True)


def inverse_sides(spectrum: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Invert the transform of the first two axes, and crop the result to `rows` and `columns`."""
    field = fft.ifft(spectrum, axis=0, workers=-1, overwrite_x=True)[:rows]
    return fft.ifft(field, axis=1, workers=-1)[:, :columns]
