"""A cosine in turns: whole periods are subtracted first, which keeps the cosine exact."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from tofrender.signals.units import SPEED_OF_LIGHT


class AMCWPulse:
    """m(opl) = cos(ω opl/c + phase_offset)."""

    def __init__(self, frequency_hz: float, phase_offset: float = 0.0) -> None:
        self.frequency_hz = frequency_hz
        self.phase_offset = phase_offset
        self.omega = 2.0 * math.pi * frequency_hz

    def eval(self, opl: mi.Float) -> mi.Float:
        """Weight in [-1, 1]."""
        wavelength = SPEED_OF_LIGHT / self.frequency_hz
        turns = opl / wavelength
        turns -= dr.floor(turns)
        return dr.cos(2.0 * math.pi * turns + self.phase_offset)

    def get_unambiguous_range(self) -> float:
        """Half a wavelength of the modulation [m]."""
        return SPEED_OF_LIGHT / (2.0 * self.frequency_hz)
