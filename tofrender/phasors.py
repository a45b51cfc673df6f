"""What a phasor says: amplitude, phase and depth, in the convention P = sum L exp(+i 2 pi f opl/c).

All of the package goes by this one: I = Re P, Q = Im P, a later arrival turns the phase forwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .units import SPEED_OF_LIGHT


def phasor_parts(
    I: np.ndarray,  # noqa: E741
    Q: np.ndarray,
    frequency_hz: float | Sequence[float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Amplitude, phase and depth of phasors.

    Args:
        I: Real part, shape (..., height, width, channels) or any other.
        Q: Imaginary part, of the same shape.
        frequency_hz: Modulation frequency [Hz]; a sequence goes with the first axis of `I`.

    Returns:
        Amplitude sqrt(I^2 + Q^2); phase atan2(Q, I) in (-pi, pi] [rad]; depth
        c (phase mod 2 pi) / (4 pi f) in [0, c / 2f) [m]: half the path length, up to whole ranges.

    Example:
        >>> amplitude, phase, depth = phasor_parts(np.zeros(1), np.ones(1), 20e6)
        >>> round(float(depth[0]), 4)  # A quarter of c / 2f = 7.4948 m
        1.8737
    """
    I, Q = np.asarray(I), np.asarray(Q)  # noqa: E741
    phase = np.arctan2(Q, I)
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    frequency = frequency.reshape(frequency.shape + (1,) * (I.ndim - frequency.ndim))
    return np.hypot(I, Q), phase, depth_of_phase(phase, frequency)


def depth_of_phase(phase: np.ndarray, frequency_hz: np.ndarray | float) -> np.ndarray:
    """Depth c (phase mod 2 pi) / (4 pi f) in [0, c / 2f) [m] of phases [rad] at frequencies [Hz]."""
    turns = np.mod(np.asarray(phase, dtype=np.float64) / (2 * np.pi), 1.0)
    turns = np.where(turns >= 1.0, 0.0, turns)  # The remainder of a tiny negative number
    return turns * SPEED_OF_LIGHT / (2.0 * np.asarray(frequency_hz))
