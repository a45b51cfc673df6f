"""Recordings of moving scenes: bins of path length and its rate of change, and Doppler phasors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..runtime import checks
from .contribution import CameraRays, Contribution, rate_of
from .exposure import Exposure
from .image import transient_film
from .phasor_sum import Factor, PhasorSum
from .recording import BinRecording, PhasorRecording
from .time_bins import TimeBins
from .transient import TransientHDRFilm


@dataclass(frozen=True)
class Axis:
    """Bins of equal width."""

    count: int
    start: float
    width: float

    def bin_of(self, value: mi.Float) -> mi.Float:
        """Return the number of the bin that a value falls into, as a float without fraction."""
        return dr.floor((value - self.start) / self.width)


Number = Callable[[mi.Float, mi.Float], mi.Float]
"""Returns the place of a length [m] and a rate [m/s] along all bins, -1 if there is none."""


@dataclass
class RateBins(TimeBins):
    """Adds contributions to bins of path length and rate, which are the time bins of a film."""

    number: Number | None = None  # A function, so that the loop does not carry axes

    def add(self, contribution: Contribution) -> None:
        """Add a contribution; outside of the bins it counts in the picture only."""
        assert self.number is not None
        number = self.number(contribution.opl, rate_of(contribution))
        super().add(replace(contribution, opl=number))


def rate_film(film: mi.Film, opl: Axis, rate: Axis) -> TransientHDRFilm:
    """Return a film with bins of all rates for each length, for the pixels of another film."""
    count = opl.count * rate.count
    if count > checks.MAX_BINS:
        raise ValueError(
            f"bins = {opl.count}, rate_bins = {rate.count}: must be at most {checks.MAX_BINS} "
            "in all"
        )
    return transient_film(film, count, 0.0, 1.0)


class RateRecording(BinRecording):
    """Records bins of path length [m] and rate [m/s] on a `rate_film`."""

    needs_rates = True

    def __init__(self, film: TransientHDRFilm, opl: Axis, rate: Axis) -> None:
        super().__init__(film, Exposure())
        self.opl, self.rate = opl, rate

    @property
    def width_opl(self) -> float:
        """Width of a bin [m]."""
        return self.opl.width

    def measurement(self, camera: CameraRays, spp: int) -> RateBins:
        """Create the measurement of the bins."""
        splat = self.splat(camera, spp)
        bins = RateBins.of_film(self.film, camera, spp, None, splat_steady=splat)
        return replace(bins, number=self._number)

    def _number(self, opl: mi.Float, rate: mi.Float) -> mi.Float:
        """Return the middle of the film's bin for a length and a rate, -1 outside."""
        i, j = self.opl.bin_of(opl), self.rate.bin_of(rate)
        inside = (i >= 0) & (i < self.opl.count) & (j >= 0) & (j < self.rate.count)
        return dr.select(inside, i * self.rate.count + j + 0.5, -1)


class DopplerRecording(PhasorRecording):
    """Records phasors, each multiplied by a factor that depends on the rate of change."""

    needs_rates = True
    emitters_apart = False  # Poses must take equal samples

    def __init__(self, film: mi.Film, exposure: Exposure, factor: Factor) -> None:
        super().__init__(film, exposure)
        self.factor = factor

    def measurement(self, camera: CameraRays, spp: int) -> PhasorSum:
        """Create the phasors' sums."""
        return PhasorSum.zero(self.film.frequencies_hz, self.splat(camera, spp), self.factor)
