"""Problem a2.amcw_pulse: modulation of a correlation sensor."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from tofrender.signals.units import SPEED_OF_LIGHT


class AMCWPulse:
    """Amplitude-modulated continuous wave: m(opl) = cos(ω opl/c + phase_offset).

    Args:
        frequency_hz: Modulation frequency f [Hz], above 0.
        phase_offset: Phase of the demodulation [rad]. The in-phase part I of a phasor
            P = Σ L exp(+i ω opl/c) is measured with 0, its quadrature Q = Σ L sin(ω opl/c) with
            another offset, which you have to find.

    Attributes:
        frequency_hz: f [Hz].
        phase_offset: [rad].
        omega: Angular frequency ω [rad/s].
    """

    def __init__(self, frequency_hz: float, phase_offset: float = 0.0) -> None:
        self.frequency_hz = frequency_hz
        self.phase_offset = phase_offset
        raise NotImplementedError("a2.amcw_pulse: set self.omega")

    def eval(self, opl: mi.Float) -> mi.Float:
        """Weight in [-1, 1] of light with the optical path length `opl` [m]."""
        raise NotImplementedError("a2.amcw_pulse: AMCWPulse.eval")

    def get_unambiguous_range(self) -> float:
        """Largest range [m] in which all depths have different phases; a depth is half a path."""
        raise NotImplementedError("a2.amcw_pulse: AMCWPulse.get_unambiguous_range")
