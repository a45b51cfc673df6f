"""Measurement of phasors, summed along a path."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi

from ..signals.polarization import no_light
from ..signals.units import SPEED_OF_LIGHT
from .contribution import Contribution, rate_of
from .sums import Radiance, Splat

Factor = Callable[[int, mi.Float], tuple[mi.Float, mi.Float]]
"""Function of the index of a phasor and of the rate of change of the path length [m/s]. It returns
the real and the imaginary part of a factor.
"""


@dataclass
class PhasorSum(Radiance):
    """Sums of light, and of the phasors L exp(+i 2 pi f opl / c) at several frequencies f."""

    # Real parts of the phasors
    real: list[mi.Spectrum] = field(default_factory=list)

    # Imaginary parts of the phasors
    imaginary: list[mi.Spectrum] = field(default_factory=list)

    # f / c [1/m]
    turns_per_meter: tuple[float, ...] = ()

    # Factor of each contribution in moving scenes, None for 1
    factor: Factor | None = None

    @classmethod
    def zero(
        cls,
        frequencies_hz: Sequence[float],
        splat: Splat | None = None,
        factor: Factor | None = None,
    ) -> PhasorSum:
        """Create empty sums."""
        return cls(
            total=no_light(),
            splat=splat,
            real=[no_light() for _ in frequencies_hz],
            imaginary=[no_light() for _ in frequencies_hz],
            turns_per_meter=tuple(frequency / SPEED_OF_LIGHT for frequency in frequencies_hz),
            factor=factor,
        )

    def add(self, contribution: Contribution) -> None:
        """Add a contribution to all sums."""
        # Multiply the light by the phase of each frequency
        spectrum = dr.select(contribution.active, contribution.spectrum, 0)
        opl = dr.select(contribution.active, contribution.opl, 0)
        real = []
        imaginary = []
        for k, turns in enumerate(self.turns_per_meter):
            # Reduce the phase to half a turn, where `sincos` is accurate
            phase = opl * turns
            sine, cosine = dr.sincos(2 * math.pi * (phase - dr.round(phase)))

            # Multiply by the complex factor re + i im
            if self.factor is not None:
                re, im = self.factor(k, rate_of(contribution))
                cosine, sine = cosine * re - sine * im, sine * re + cosine * im
            real.append(spectrum * cosine)
            imaginary.append(spectrum * sine)

        # Add to the film, or to the sums of the camera ray
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
        """All sums as one list, for `with_sums`."""
        return [self.total, *self.real, *self.imaginary]

    def with_sums(self, sums: list[mi.Spectrum]) -> PhasorSum:
        """Return a copy of the measurement with other sums."""
        n = len(self.real)
        return replace(self, total=sums[0], real=sums[1 : n + 1], imaginary=sums[n + 1 :])
