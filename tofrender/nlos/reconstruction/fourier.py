"""Fourier transforms of data padded with zeros, and what they take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft

from ...runtime import memory
from ...runtime.progress import progress_bar

fft: Any = scipy.fft
"""SciPy's transforms; what they return cannot be told from its code."""


class Steps:
    """A bar for a known number of steps, shown if they take long."""

    def __init__(self, description: str, total: int, progress: bool):
        self._bar = progress_bar(description, total, unit="step", enabled=progress)

    def done(self) -> None:
        """One step is done."""
        self._bar.update()

    def __enter__(self) -> Steps:
        self._bar.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._bar.__exit__(*error)


def require_memory(method: str, shape: Sequence[int], copies: float) -> None:
    """Refuse work on complex arrays that do not fit.

    Raises:
        MemoryError: One line with what it takes and what there is.
    """
    needed, free = copies * 8 * math.prod(shape), memory.available()
    if needed > free:
        raise MemoryError(
            f"method = {method!r}: takes {needed / 2**30:.1f} GiB, {free / 2**30:.1f} GiB is free; "
            "must be a capture of fewer points or bins, or method 'bp'"
        )


def forward(values: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Spectrum of real values (rows, columns, bins), padded with zeros to `shape`.

    One axis at a time, so that rows of zeros are transformed as rarely as possible.

    Returns:
        complex64, (shape[0], shape[1], shape[2] // 2 + 1).
    """
    spectrum = fft.rfft(values, shape[2], axis=2, workers=-1)
    spectrum = fft.fft(spectrum, shape[1], axis=1, workers=-1, overwrite_x=True)
    return fft.fft(spectrum, shape[0], axis=0, workers=-1, overwrite_x=True)


def inverse(spectrum: np.ndarray, sides: tuple[int, int], lines: int) -> np.ndarray:
    """Real values (rows, columns, lines) of a half spectrum, of which `sides` are kept."""
    values = fft.ifft(spectrum, axis=0, workers=-1, overwrite_x=True)[: sides[0]]
    values = fft.ifft(values, axis=1, workers=-1)[:, : sides[1]]
    return fft.irfft(values, lines, axis=2, workers=-1)


def even_lags(count: int) -> np.ndarray:
    """Indices that turn lags 0 ... count into those of a transform of length 2 count."""
    return np.concatenate([np.arange(count + 1), np.arange(count - 1, 0, -1)])
