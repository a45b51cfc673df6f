"""Problem a4.itof: taps of a correlation camera, their noise, and multi-path light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def expected_taps(
    signal: Any,
    background: Any,
    phase: Any,
    contrast: float,
    taps: int = 4,
    harmonics: Sequence[float] = (),
) -> np.ndarray:
    """Expected photoelectrons of each tap.

    Args:
        signal: Photoelectrons S of the modulated light in all taps together, any shape.
        background: Photoelectrons B of constant light in all taps together, of the same shape or a
            number.
        phase: Phase φ of the modulated light [rad], of the same shape or a number.
        contrast: Modulation contrast M, above 0 and at most 1.
        taps: Number N of taps, at least 3.
        harmonics: Relative amplitudes a_2, a_3, ... of the harmonics of the correlation.

    Returns:
        Photoelectrons of shape (taps, ...), tap k demodulated at the phase 2π k/N.
    """
    raise NotImplementedError("a4.itof: expected_taps")


def sample_taps(
    rng: np.random.Generator, means: Any, read_noise: float = 0.0, full_well: float = np.inf
) -> np.ndarray:
    """Simulate the electrons in the taps, with shot noise and read noise.

    Args:
        rng: Source of all random numbers: the same state gives the same result.
        means: Expected photoelectrons, any shape.
        read_noise: Standard deviation of each tap's read noise [electrons].
        full_well: Largest number of electrons that a tap can show, including read noise.

    Returns:
        Electrons of the same shape; read noise can make them negative.
    """
    raise NotImplementedError("a4.itof: sample_taps")


def demodulate(taps: np.ndarray, contrast: float) -> tuple[np.ndarray, np.ndarray]:
    """Amplitude and phase of the modulated light.

    Args:
        taps: Photoelectrons, shape (taps, ...).
        contrast: Modulation contrast M.

    Returns:
        The signal S [photoelectrons of all taps] and the phase in [0, 2π) [rad], shape (...).
    """
    raise NotImplementedError("a4.itof: demodulate")


def phase_deviation(
    signal: Any, background: Any, contrast: float, taps: int = 4, read_noise: float = 0.0
) -> np.ndarray:
    """Standard deviation of the phase [rad] by shot noise and read noise.

    Args:
        signal: Photoelectrons S, any shape; enough that the result is much below 1.
        background: Photoelectrons B, of the same shape or a number.
        contrast: Modulation contrast M.
        taps: Number N of taps, at least 4.
        read_noise: Standard deviation of each tap's read noise [electrons].

    Returns:
        Standard deviations [rad] of the shape of `signal`.
    """
    raise NotImplementedError("a4.itof: phase_deviation")


def multipath_phase_error(ratio: Any, difference: Any) -> np.ndarray:
    """Error of the phase [rad] that a second return causes.

    Args:
        ratio: Amplitude of the second return over the amplitude of the first, at least 0, any
            shape.
        difference: Phase of the second return minus the phase of the first [rad], any value, of the
            same shape or a number.

    Returns:
        Phase of both together minus the phase of the first, in (-π, π], of the shape of `ratio`.
    """
    raise NotImplementedError("a4.itof: multipath_phase_error")
