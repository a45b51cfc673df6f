"""The measurement that puts light into the time bins of a film."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..pulses import Pulse


@dataclass
class FilmDeposit:
    """Adds each contribution to a transient film, and sums them as a steady camera does.

    A pulse is convolved by its exact energy in each bin, which adds no noise.

    Attributes:
        total: Radiance over all time, of type `mi.UnpolarizedSpectrum`.
        film: Anything with mitransient's `add_transient_data`, `temporal_bins`, `start_opl` and
            `bin_width_opl`.
        position: Position on the film [pixels].
        wavelengths: Sampled wavelengths of the rays [nm]; empty unless the variant is spectral.
        weight: Factor of every deposit: the camera ray's weight over the samples per pixel.
        pulse: Temporal profile of the light, None for an instant.
    """

    total: Any
    film: Any
    position: mi.Point2f
    wavelengths: Any
    weight: Any
    pulse: Pulse | None

    @classmethod
    def empty(cls, film, position, wavelengths, weight, pulse) -> FilmDeposit:
        """Nothing deposited yet."""
        return cls(mi.UnpolarizedSpectrum(0), film, position, wavelengths, weight, pulse)

    def add(self, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
        """Deposit a contribution."""
        self.total += dr.select(active, spectrum, 0)
        spectrum = spectrum * self.weight
        if self.pulse is None:
            self._put(spectrum, opl, active)
        else:
            self._spread(spectrum, opl, active)

    def _put(self, spectrum, opl, active):
        self.film.add_transient_data(
            self.position, opl, self.wavelengths, spectrum, mi.Float(1), active
        )

    @dr.syntax
    def _spread(self, spectrum, opl, active):
        """Deposit the pulse's energy in each bin that it reaches."""
        bins, start = int(self.film.temporal_bins), float(self.film.start_opl)
        width = float(self.film.bin_width_opl)
        low, high = self.pulse.support
        opl = opl - start
        k = mi.Int32(dr.clip(dr.floor((opl + low) / width), 0, bins))
        last = mi.Int32(dr.clip(dr.floor((opl + high) / width), -1, bins - 1))

        before = self.pulse.cdf(k * width - opl)   # Energy before bin k
        filling = active & (k <= last)
        while filling:
            after = self.pulse.cdf((k + 1) * width - opl)
            self._put(spectrum * (after - before), start + (k + 0.5) * width, filling)
            before = mi.Float(after)
            k += 1
            filling &= k <= last
