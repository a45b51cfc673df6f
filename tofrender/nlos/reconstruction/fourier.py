"""Fourier transforms of data padded with zeros, and their memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft

from ...runtime import memory

fft: Any = scipy.fft
"""SciPy's transforms, whose types cannot be inferred."""


def require_memory(method: str, shape: Sequence[int], copies: float) -> None:
    """Refuse work on complex arrays that do not fit."""
    needed, free = copies * 8 * math.prod(shape), memory.available()
    if needed > free:
        raise MemoryError(
            f"method = {method!r}: takes {needed / 2**30:.1f} GiB, {free / 2**30:.1f} GiB is free; "
            "must be a capture of fewer points or bins, or method 'bp'"
        )


def forward(values: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Spectrum of real values (rows, columns, bins), padded with zeros to `shape`.

    complex64, (shape[0], shape[1], shape[2] // 2 + 1). One axis at a time, so that rows of zeros
    are transformed as rarely as possible.
    """
    spectrum = fft.rfft(values, shape[2], axis=2, workers=-1)
    spectrum = fft.fft(spectrum, shape[1], axis=1, workers=-1, overwrite_x=True)
    return fft.fft(spectrum, shape[0], axis=0, workers=-1, overwrite_x=True)


def inverse(spectrum: np.ndarray, sides: tuple[int, int], lines: int) -> np.ndarray:
    """Real values (rows, columns, lines) of a half spectrum, cropped to `sides`."""
    values = fft.ifft(spectrum, axis=0, workers=-1, overwrite_x=True)[: sides[0]]
    values = fft.ifft(values, axis=1, workers=-1)[:, : sides[1]]
    return fft.irfft(values, lines, axis=2, workers=-1)
