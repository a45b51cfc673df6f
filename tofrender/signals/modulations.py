"""Modulations: the weight that a correlation sensor gives to light, as a function of path length.

The light is modulated. The sensor multiplies the light by a demodulation and integrates. Therefore
light of one path length is weighted by the **correlation function** of modulation and demodulation,
which is periodic in the optical path length with the period c/f. In this module, a modulation is
this correlation function:

    eval(opl)                 weight of light with the path length opl [m]
    frequency_hz              repetition frequency f [Hz], from 1e-9 to 1e18
    phase_offset              phase of the demodulation [rad], any finite number
    get_unambiguous_range()   half a period, c / 2f [m]; larger depths wrap around

All correlations are scaled to [-1, 1], like the difference of two taps of a sensor. They are
functions of the phase x = f opl/c + phase_offset/(2 pi), in turns. `eval` accepts a Dr.Jit float or
a number, and returns the same type. Arguments out of range raise a ValueError.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from .units import SPEED_OF_LIGHT, check_frequency


class Modulation(Protocol):
    """Interface of modulations; see the docstring of the module."""

    frequency_hz: float

    def eval(self, opl: mi.Float) -> mi.Float: ...  # noqa: D102

    def get_unambiguous_range(self) -> float: ...  # noqa: D102


class _Periodic:
    """Base class of modulations, which are periodic functions of the phase x in turns."""

    c = SPEED_OF_LIGHT

    def __init__(self, frequency_hz: float, phase_offset: float = 0.0) -> None:
        self.frequency_hz = check_frequency("frequency_hz", frequency_hz)
        self.phase_offset = checks.number("phase_offset", phase_offset, unit="radians")

        # Store the period as the sum of two single-precision numbers, so that opl - n period is
        # computed without rounding error
        period = SPEED_OF_LIGHT / self.frequency_hz
        self._period = float(np.float32(period))
        self._rest = period - self._period
        self._shift = math.remainder(self.phase_offset / (2.0 * math.pi), 1.0)

    def _turns(self, opl: Any) -> Any:
        """Return the phase x in [-1/2, 1/2], as precise as `opl` for up to 2^24 periods."""
        n = dr.round(opl / self._period)
        within = dr.fma(-n, self._rest, dr.fma(-n, self._period, opl))
        x = within / self._period + self._shift
        return x - dr.round(x)

    def get_unambiguous_range(self) -> float:
        """Return the largest unambiguous depth, half of a period: c / 2f [m]."""
        return SPEED_OF_LIGHT / (2.0 * self.frequency_hz)

    def __repr__(self) -> str:
        """Return the class with its arguments, and the phase offset if it is not 0."""
        offset = f", phase_offset={self.phase_offset:g}" if self.phase_offset else ""
        return f"{type(self).__name__}({self._arguments()}{offset})"

    def _arguments(self) -> str:
        """Return the arguments for `repr`."""
        return f"frequency_hz={self.frequency_hz:g}"


class AMCWPulse(_Periodic):
    """Amplitude-modulated continuous wave: m(opl) = cos(omega opl/c + phase_offset).

    A phasor P = sum of L exp(+i omega opl/c) has I = Re P and Q = Im P. I is measured with
    `phase_offset = 0`. **Q is measured with `phase_offset = -pi/2`**, because
    cos(x - pi/2) = sin x. An offset of +pi/2 would give minus sine, and depths with wrong sign.

    Args:
        frequency_hz: Modulation frequency f [Hz], also stored as the attribute `frequency`.
        phase_offset: Phase of the demodulation [rad].

    Attributes:
        omega: 2 pi f [rad/s].
        c: Speed of light in vacuum [m/s].

    Example:
        >>> i, q = AMCWPulse(50e6), AMCWPulse(50e6, phase_offset=-math.pi / 2)
        >>> round(i.get_unambiguous_range(), 4)
        2.9979
        >>> quarter = i.c / 50e6 / 4
        >>> bool(abs(i.eval(quarter)) < 1e-6), round(q.eval(quarter), 6)
        (True, 1.0)
    """

    def __init__(self, frequency_hz: float, phase_offset: float = 0.0) -> None:
        super().__init__(frequency_hz, phase_offset)
        self.frequency = self.frequency_hz
        self.omega = 2.0 * math.pi * self.frequency_hz

    def eval(self, opl: mi.Float) -> mi.Float:
        """Return the weight in [-1, 1] of light with the path length `opl` [m]."""
        return dr.cos((2.0 * math.pi) * self._turns(opl))


class SquareWave(_Periodic):
    """Correlation of square light with a square demodulation, which is a triangle wave.

    Light and demodulation are on for one half of the period and off for the other half. The
    correlation is m(x) = 1 - 4 |x - round(x)|, with m(0) = 1 and m(1/2) = -1. The harmonics
    n = 1, 3, 5, ... have the amplitudes 8/(pi n)^2. Therefore an algorithm for cosines measures a
    slightly wrong phase. This is the "wiggling error" of real cameras.

    Args:
        frequency_hz: Repetition frequency f [Hz].
        phase_offset: Phase of the demodulation [rad]; -pi/2 for Q.

    Example:
        >>> wave = SquareWave(100e6)
        >>> period = 2 * wave.get_unambiguous_range()
        >>> [round(wave.eval(x * period), 4) for x in (0.0, 0.125, 0.5, 1.0)]
        [1.0, 0.5, -1.0, 1.0]
    """

    def eval(self, opl: mi.Float) -> mi.Float:
        """Return the weight in [-1, 1] of light with the path length `opl` [m]."""
        return 1.0 - 4.0 * abs(self._turns(opl))


# Slots of the period where each demodulation switches: first on, then off, on, off, ...
_SWITCHES = {
    3: ((0, 3), (2, 5), (4, 1)),
    4: ((5, 11), (2, 8), (0, 3, 7, 10), (4, 6, 9, 1)),
    5: (
        (15, 0),
        (7, 22),
        (3, 11, 19, 26),
        (1, 5, 9, 13, 17, 20, 24, 28),
        (4, 6, 8, 10, 12, 14, 16, 18, 21, 23, 25, 27, 29, 2),
    ),
}


class HamiltonianCode(_Periodic):
    """One of the k correlations of a Hamiltonian code, a piecewise-linear function.

    The period is divided into n = 6, 12 or 30 slots for k = 3, 4 or 5. The light is a pulse of one
    slot with n times the mean power. Each of the k demodulations d_i is -1 or 1 in every slot. From
    one slot to the next, exactly one demodulation switches. Therefore the correlation

        m_i(x) = n * integral of d_i from x to x + 1/n

    is linear from d_i[j] at x = j/n to d_i[j + 1] at x = (j + 1)/n. As points in k dimensions, the
    k correlations follow edges of a cube on a closed tour of n corners. The tour visits all corners
    except "all on" and "all off" (for k = 4, all except four). This curve is longer than the circle
    of a cosine, so the code distinguishes more depths at the same noise. For k = 3, the
    demodulations are square waves, shifted by thirds of the period. For k = 4 and 5, their shapes
    differ too.

    Source: Gupta, Velten, Nayar and Breitbach, "What Are Optimal Coding Functions for
    Time-of-Flight Imaging?", ACM Transactions on Graphics 37(2), 2018. The slots for k = 4 and 5
    come from ToFSim, a public simulator of the same group, where d_i is 0 or 1.

    Args:
        k: Number of demodulations: 3, 4 or 5.
        frequency_hz: Repetition frequency f [Hz].
        demodulation: Index i, from 0 to k - 1. `HamiltonianCode.all` returns all k correlations.
        phase_offset: Phase of the demodulation [rad].

    Attributes:
        code: d_i in each slot, NumPy array of shape (n,) of -1 and 1.

    Example:
        >>> code = HamiltonianCode(3, 20e6)
        >>> code.code.tolist()
        [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]
        >>> slot = 2 * code.get_unambiguous_range() / code.code.size
        >>> [round(code.eval(x * slot), 3) for x in (0, 2.25, 2.5, 4)]
        [1.0, 0.5, 0.0, -1.0]
    """

    def __init__(
        self, k: int, frequency_hz: float, demodulation: int = 0, phase_offset: float = 0.0
    ) -> None:
        self.k = checks.integer("k", k, 3, 5)
        self.demodulation = checks.integer("demodulation", demodulation, 0, self.k - 1)
        super().__init__(frequency_hz, phase_offset)
        switches = _SWITCHES[self.k]
        slots = sum(len(each) for each in switches)  # Each slot has exactly one switch

        # Set the slots between on and off to 1
        self.code = np.full(slots, -1.0)
        of_this = switches[self.demodulation]
        for on, off in zip(of_this[::2], of_this[1::2], strict=True):
            self.code[np.arange(on, off if off > on else off + slots) % slots] = 1.0

    @classmethod
    def all(cls, k: int, frequency_hz: float) -> list[HamiltonianCode]:
        """Return all k correlations of a code, which determine the depth together.

        Example:
            >>> [code.demodulation for code in HamiltonianCode.all(4, 20e6)]
            [0, 1, 2, 3]
        """
        return [cls(k, frequency_hz, i) for i in range(checks.integer("k", k, 3, 5))]

    def eval(self, opl: mi.Float) -> mi.Float:
        """Return the weight in [-1, 1] of light with the path length `opl` [m]."""
        # Sum the changes of the demodulation up to the slot, with linear interpolation
        x = self._turns(opl)
        slot = self.code.size * (x - dr.floor(x))
        value: Any = float(self.code[0])
        for j, step in enumerate(np.roll(self.code, -1) - self.code):
            if step:
                value = value + float(step) * dr.clip(slot - j, 0.0, 1.0)
        return value

    def _arguments(self) -> str:
        """Return the arguments for `repr`."""
        return f"k={self.k}, {super()._arguments()}, demodulation={self.demodulation}"


class MSequence(_Periodic):
    """Maximal-length binary sequence of N = 2^n_bits - 1 chips, correlated with itself.

    The sequence comes from a linear-feedback shift register with n_bits, which visits all states
    except 0. The periodic autocorrelation of the sequence of +1 and -1 is 1 without shift, -1/N at
    all other integer shifts, and linear between them. It is a triangle that extends one chip
    c/(f N) to each side, on a flat floor:

        m(x) = max(1 - (1 + 1/N) N |x - round(x)|, -1/N)

    Light paths that differ by more than one chip interfere only by the floor. (Light cannot be
    negative. A source with the power 1 + s instead of s adds the mean 1/N of the sequence s, and
    the floor is 0.) `phase_offset` moves the peak to opl = -phase_offset/(2 pi) c/f. Scan the
    offset over a period to sample a transient chip by chip.

    Source: Golomb, "Shift Register Sequences", 1967; for time of flight: Kadambi et al., "Coded
    Time of Flight Cameras", ACM Transactions on Graphics 32(6), 2013.

    Args:
        n_bits: Length of the register, from 2 to 16.
        frequency_hz: Repetition frequency f of the whole sequence [Hz]. The chip rate is N f.
        phase_offset: Phase of the demodulation [rad]; 2 pi is the length of the whole sequence.

    Attributes:
        n_chips: Number of chips N.

    Example:
        >>> sequence = MSequence(3, 10e6)
        >>> sequence.code.tolist()
        [1.0, 1.0, 1.0, -1.0, 1.0, -1.0, -1.0]
        >>> chip = 2 * sequence.get_unambiguous_range() / sequence.n_chips
        >>> [round(sequence.eval(x * chip), 4) for x in (0, 0.5, 1, 3)]
        [1.0, 0.4286, -0.1429, -0.1429]
    """

    def __init__(self, n_bits: int, frequency_hz: float, phase_offset: float = 0.0) -> None:
        self.n_bits = checks.integer("n_bits", n_bits, 2, 16)
        self.n_chips = 2**self.n_bits - 1
        super().__init__(frequency_hz, phase_offset)

    @cached_property
    def code(self) -> np.ndarray:
        """Sequence of -1 and 1 from SciPy's shift register, NumPy array of shape (n_chips,)."""
        from scipy.signal import max_len_seq

        return 2.0 * max_len_seq(self.n_bits)[0] - 1.0

    def eval(self, opl: mi.Float) -> mi.Float:
        """Return the weight in [-1/N, 1] of light with the path length `opl` [m]."""
        slope = self.n_chips + 1.0
        return dr.maximum(1.0 - slope * abs(self._turns(opl)), -1.0 / self.n_chips)

    def _arguments(self) -> str:
        """Return the arguments for `repr`."""
        return f"n_bits={self.n_bits}, {super()._arguments()}"
