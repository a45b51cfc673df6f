"""Fourier transforms of data padded with zeros, and their memory."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft

from ...runtime import memory

fft: Any = scipy.fft  # SciPy's transforms, whose types cannot be inferred


def require_memory(method: str, shape: Sequence[int], copies: float) -> None:
    """Refuse work on complex arrays that do not fit."""
    needed, free = copies * 8 * math.prod(shape), memory.free_on_host()
    if needed > free:
        sizes = f"takes {needed / 2**30:.1f} GiB, {free / 2**30:.1f} GiB is free"
        mend = "must be a capture of fewer points or bins, or method 'bp'"
        raise MemoryError(f"method = {method!r}: {sizes}; {mend}")


def forward(values: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Spectrum of real values (rows, columns, bins), padded with zeros to `shape`.

    complex64, (shape[0], shape[1], shape[2] // 2 + 1). One axis at a time, so that rows of zeros
    are transformed as rarely as possible.
    """
    spectrum = fft.rfft(values, shape[2], axis=2, workers=-1)
    spectrum = fft.fft(spectrum, shape[1], axis=1, workers=-1, overwrite_x=True)
    return fft.fft(spectrum, shape[0], axis=0, workers=-1, overwrite_x=True)


def inverse_sides(spectrum: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Inverse transform of the first two axes, cropped to `rows` and `columns`."""
    field = fft.ifft(spectrum, axis=0, workers=-1, overwrite_x=True)[:rows]
    return fft.ifft(field, axis=1, workers=-1)[:, :columns]
