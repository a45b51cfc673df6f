"""Problem a2.transient_to_phasor: phasors of a transient."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import numpy as np

from tofrender.signals.units import SPEED_OF_LIGHT


def transient_to_phasor(
    transient_data: np.ndarray, frequency_hz: float, start_opl: float, bin_width_opl: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Convert the bins of a film to phasors, P = Σ L_k exp(+i 2π f opl_k / c).

    Args:
        transient_data: Radiance **per bin**, shape (height, width, bins, channels). Bin k covers
            start_opl + k bin_width_opl to start_opl + (k + 1) bin_width_opl. Treat its light as if
            it arrived at the bin's center.
        frequency_hz: Modulation frequency f [Hz].
        start_opl: Start of the first bin [m].
        bin_width_opl: Width of a bin [m].

    Returns:
        I = Re P, Q = Im P, amplitude |P|, phase in (-π, π] [rad], and depth, half the path length
        that follows from the phase, in [0, c/2f) [m]. Five arrays of shape (height, width,
        channels).
    """
    raise NotImplementedError("a2.transient_to_phasor: transient_to_phasor")


def sum_channels(
    I: np.ndarray,  # noqa: E741
    Q: np.ndarray,
    frequency_hz: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Phasors of a sensor without color filters, from the phasors of the channels.

    Args:
        I: Real parts, channels in the last axis.
        Q: Imaginary parts, of the same shape.
        frequency_hz: Modulation frequency f [Hz].

    Returns:
        I, Q, amplitude, phase and depth of all channels together, as `transient_to_phasor` returns
        them, with a last axis of length 1.
    """
    raise NotImplementedError("a2.transient_to_phasor: sum_channels")
