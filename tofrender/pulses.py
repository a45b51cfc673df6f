"""Temporal profiles of the light: how the energy of one emission is spread over time.

A pulse is a density over the offset t from its centre, in metres of optical path. It offers

    eval(t)      density p(t) [1/m]
    cdf(t)       integral of p up to t, which gives exact bin masses as differences
    sample(xi)   (t, weight) for a uniform xi, with E[weight f(t)] = integral of p f
    support      (first, last) offset [m] outside of which p is 0 or negligible

All three functions take Dr.Jit floats or numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np

from . import checks


class Pulse(Protocol):
    """What every pulse offers; see the module's text."""

    @property
    def support(self) -> tuple[float, float]: ...  # noqa: D102

    def eval(self, t: mi.Float) -> mi.Float: ...  # noqa: D102

    def cdf(self, t: mi.Float) -> mi.Float: ...  # noqa: D102

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]: ...  # noqa: D102


class GaussianPulse:
    """Normalised Gaussian p(t) = exp(-t^2 / (2 s^2)) / (s sqrt(2 pi)).

    Args:
        width_opl: Standard deviation s [m], above 0.

    Attributes:
        width_opl: Standard deviation s [m].
        normalization: 1 / (s sqrt(2 pi)) [1/m].

    Raises:
        ValueError: `width_opl` is not a finite number above 0.

    Example:
        >>> pulse = GaussianPulse(width_opl=0.05)
        >>> round(float(pulse.eval(0.0)), 4)
        7.9788
        >>> float(pulse.cdf(0.0))
        0.5
    """

    def __init__(self, width_opl: float) -> None:
        self.width_opl = checks.metres("width_opl", width_opl, positive=True)
        self.normalization = 1.0 / (self.width_opl * math.sqrt(2.0 * math.pi))

    @property
    def support(self) -> tuple[float, float]:
        """Five standard deviations to each side [m]; 6e-7 of the energy lies beyond."""
        return (-5.0 * self.width_opl, 5.0 * self.width_opl)

    def eval(self, t: mi.Float) -> mi.Float:
        """Density [1/m] at the offset `t` [m]."""
        z = t / self.width_opl
        return self.normalization * dr.exp(-0.5 * z * z)

    def cdf(self, t: mi.Float) -> mi.Float:
        """Fraction of the energy up to the offset `t` [m]: (1 + erf(t / (s sqrt 2))) / 2."""
        return 0.5 + 0.5 * dr.erf(t / (self.width_opl * math.sqrt(2.0)))

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Offset s sqrt(2) erfinv(2 xi - 1) [m] and its weight, 1.

        erfinv is infinite at both ends, and a 24-bit sampler returns 0 now and then, so `xi` is
        kept 2^-24 away from 0 and 1: every offset is finite.
        """
        edge = 2.0**-24
        argument = dr.clip(2.0 * xi - 1.0, -1.0 + 2 * edge, 1.0 - 2 * edge)
        return self.width_opl * math.sqrt(2.0) * dr.erfinv(argument), mi.Float(1.0)

    def __repr__(self) -> str:
        """Name and width."""
        return f"GaussianPulse(width_opl={self.width_opl:g})"


class SampledPulse:
    """A measured pulse: constant within equal bins, scaled so that its energy is 1.

    Args:
        values: Relative energy in each bin, shape (n,), none negative, at least one positive.
        start_opl: Offset at which the first bin starts [m].
        bin_width_opl: Width of a bin [m], above 0.

    Attributes:
        density: Normalised density in each bin [1/m], NumPy array of shape (n,).

    Raises:
        ValueError: A value is negative or not finite, all are 0, or a length is out of range.

    Example:
        >>> pulse = SampledPulse([1.0, 3.0], start_opl=0.0, bin_width_opl=0.5)
        >>> pulse.density.tolist()
        [0.5, 1.5]
        >>> pulse.cdf(0.5)[0]
        0.25
    """

    def __init__(
        self, values: Sequence[float] | np.ndarray, start_opl: float, bin_width_opl: float
    ) -> None:
        energy = np.asarray(values, dtype=np.float64)
        if energy.ndim != 1 or energy.size == 0:
            raise ValueError(f"values: shape {energy.shape}; must be a list of at least one number")
        if not np.all(np.isfinite(energy)) or np.any(energy < 0):
            worst = energy[~np.isfinite(energy) | (energy < 0)][0]
            raise ValueError(f"values: contain {worst:g}; each must be a finite number, 0 or more")
        if not np.any(energy > 0):
            raise ValueError("values: all are 0; at least one must be above 0")
        self.start_opl = checks.metres("start_opl", start_opl)
        self.bin_width_opl = checks.metres("bin_width_opl", bin_width_opl, positive=True)
        mass = energy / energy.sum()
        self.density = mass / self.bin_width_opl
        self._cumulative = np.concatenate([[0.0], np.cumsum(mass)])
        self._cumulative[-1] = 1.0

    @property
    def support(self) -> tuple[float, float]:
        """Start of the first and end of the last bin [m]."""
        return (self.start_opl, self.start_opl + self.density.size * self.bin_width_opl)

    def eval(self, t: mi.Float) -> mi.Float:
        """Density [1/m] at the offset `t` [m]."""
        position = (mi.Float(t) - self.start_opl) / self.bin_width_opl
        inside = (position >= 0) & (position < self.density.size)
        return dr.gather(mi.Float, mi.Float(self.density), mi.UInt32(position), inside)

    def cdf(self, t: mi.Float) -> mi.Float:
        """Fraction of the energy up to the offset `t` [m]."""
        n = self.density.size
        position = dr.clip((mi.Float(t) - self.start_opl) / self.bin_width_opl, 0, n)
        k = dr.minimum(mi.UInt32(position), n - 1)
        table = mi.Float(self._cumulative)
        return dr.lerp(
            dr.gather(mi.Float, table, k), dr.gather(mi.Float, table, k + 1), position - k
        )

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Offset [m] by inversion of the cdf, and its weight, 1."""
        xi = dr.clip(mi.Float(xi), 0, 1)
        table = mi.Float(self._cumulative)
        last = self.density.size - 1
        k = dr.binary_search(0, last, lambda i: dr.gather(mi.Float, table, i + 1) <= xi)
        low, high = dr.gather(mi.Float, table, k), dr.gather(mi.Float, table, k + 1)
        within = dr.select(high > low, (xi - low) / (high - low), 0)
        return self.start_opl + (k + dr.clip(within, 0, 1)) * self.bin_width_opl, mi.Float(1.0)

    def __repr__(self) -> str:
        """Size and place."""
        return (
            f"SampledPulse({self.density.size} values, start_opl={self.start_opl:g}, "
            f"bin_width_opl={self.bin_width_opl:g})"
        )


def convolve(first: Pulse, second: Pulse) -> Pulse:
    """The pulse of two that act one after the other: a laser's and a detector's, say.

    Two Gaussians give a Gaussian. Anything else is convolved on 4096 samples of its joint support.

    Example:
        >>> convolve(GaussianPulse(0.03), GaussianPulse(0.04))
        GaussianPulse(width_opl=0.05)
    """
    if isinstance(first, GaussianPulse) and isinstance(second, GaussianPulse):
        return GaussianPulse(math.hypot(first.width_opl, second.width_opl))
    low = first.support[0] + second.support[0]
    step = (first.support[1] + second.support[1] - low) / 4096
    masses = [_masses(pulse, step) for pulse in (first, second)]
    # Bins [i, i+1) and [j, j+1) of two densities meet in [i+j, i+j+2), half of the mass in each
    joint = np.convolve(masses[0], masses[1])
    joint = 0.5 * (np.append(joint, 0.0) + np.insert(joint, 0, 0.0))
    return SampledPulse(joint, low, step)


def _masses(pulse: Pulse, step: float) -> np.ndarray:
    """Energy of `pulse` in bins of width `step` [m] that cover its support."""
    low, high = pulse.support
    edges = low + step * np.arange(math.ceil((high - low) / step) + 1)
    values: Any = pulse.cdf(mi.Float(edges))
    return np.clip(np.diff(np.array(values, dtype=np.float64)), 0.0, None)
