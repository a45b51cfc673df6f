"""The measurement that sums phasors along a path."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import no_light
from ..signals.units import SPEED_OF_LIGHT
from .contribution import Contribution, rate_of
from .sums import Radiance, Splat

Factor = Callable[[int, mi.Float], tuple[mi.Float, mi.Float]]


@dataclass
class PhasorSum(Radiance):
    """Sums light, and real and imaginary parts of L exp(+i 2 pi f opl / c) for frequencies f."""

    real: list[mi.Spectrum] = field(default_factory=list)
    imaginary: list[mi.Spectrum] = field(default_factory=list)
    turns_per_metre: tuple[float, ...] = ()  # f / c [1/m]
    # complex factor of phasor k of light whose length changes at a rate [m/s], by k and rate
    factor: Factor | None = None

    @classmethod
    def zero(
        cls,
        frequencies_hz: Sequence[float],
        splat: Splat | None = None,
        factor: Factor | None = None,
    ) -> PhasorSum:
        """Create empty sums."""
        zeros = [[no_light() for _ in frequencies_hz] for _ in range(2)]
        turns = tuple(frequency / SPEED_OF_LIGHT for frequency in frequencies_hz)
        return cls(no_light(), splat, *zeros, turns, factor)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        spectrum = dr.select(contribution.active, contribution.spectrum, 0)
        opl = dr.select(contribution.active, contribution.opl, 0)
        real, imaginary = [], []
        for k, turns in enumerate(self.turns_per_metre):
            phase = opl * turns
            sine, cosine = dr.sincos(2 * math.pi * (phase - dr.round(phase)))
            if self.factor is not None:
                re, im = self.factor(k, rate_of(contribution))
                cosine, sine = cosine * re - sine * im, sine * re + cosine * im
            real.append(spectrum * cosine)
            imaginary.append(spectrum * sine)
        if contribution.position is not None:
            spectra = [spectrum, *real, *imaginary]
            self.splat(spectra, contribution.position, contribution.active)
            return
        self.total += spectrum
        for k in range(len(real)):
            self.real[k] += real[k]
            self.imaginary[k] += imaginary[k]

    @property
    def sums(self) -> list[mi.Spectrum]:
        """The sums as a list, for `with_sums`."""
        return [self.total, *self.real, *self.imaginary]

    def with_sums(self, sums: list[mi.Spectrum]) -> PhasorSum:
        """Copy the measurement, with other sums."""
        n = len(self.real)
        return replace(self, total=sums[0], real=sums[1 : n + 1], imaginary=sums[n + 1 :])
