"""Recordings of moving scenes: bins of path length and its rate, and phasors with Doppler shift."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..runtime import checks
from .contribution import CameraSample, Contribution, rate_of
from .exposure import Exposure
from .phasor_sum import Factor, PhasorSum
from .recording import BinRecording, PhasorRecording
from .time_bins import TimeBins
from .transient import TransientHDRFilm
from .windowed import transient_film


@dataclass(frozen=True)
class Axis:
    """Bins of equal width."""

    count: int  # Number of bins
    start: float  # Start of the first bin
    width: float  # Width of a bin

    def bin_of(self, value: mi.Float) -> mi.Float:
        """Return the index of the bin that contains a value, as a float."""
        return dr.floor((value - self.start) / self.width)


BinPosition = Callable[[mi.Float, mi.Float], mi.Float]
"""Function of a path length [m] and a rate [m/s]. It returns the center of their bin on the time
axis of the film, or -1 outside of all bins.
"""


@dataclass
class RateBins(TimeBins):
    """Bins of path length and rate, stored as the time bins of a film."""

    # A function, so that the path loop does not carry the axes as state
    position_of: BinPosition | None = None

    def add(self, contribution: Contribution) -> None:
        """Add a contribution. Contributions outside of the bins are only added to the picture."""
        assert self.position_of is not None
        position = self.position_of(contribution.opl, rate_of(contribution))
        super().add(replace(contribution, opl=position))


def rate_film(film: mi.Film, opl: Axis, rate: Axis) -> TransientHDRFilm:
    """Return a film with the pixels of another film, and bins of all rates for each path length.

    Args:
        film: The other film.
        opl: Bins of path length [m].
        rate: Bins of the rate of change of path length [m/s].

    Raises:
        ValueError: If the number of all bins is too large.
    """
    count = opl.count * rate.count
    if count > checks.MAX_BINS:
        raise ValueError(
            f"bins = {opl.count}, rate_bins = {rate.count}: must be at most {checks.MAX_BINS} "
            "in all"
        )
    return transient_film(film, count, 0.0, 1.0)


class RateRecording(BinRecording):
    """Recording of bins of path length [m] and rate [m/s] on a `rate_film`."""

    needs_rates = True

    def __init__(self, film: TransientHDRFilm, opl: Axis, rate: Axis) -> None:
        super().__init__(film, Exposure())
        self.opl = opl
        self.rate = rate

    @property
    def width_opl(self) -> float:
        """Width of a bin [m]."""
        return self.opl.width

    def measurement(self, camera: CameraSample, one_writer: bool = False) -> RateBins:
        """Create the measurement of the bins."""
        bins = RateBins.of_film(
            film=self.film,
            camera=camera,
            weight=self.accumulation.sample_weight(camera.weight),
            pulse=None,
            splat_steady=self._splat(camera),
            one_writer=one_writer,
        )
        return replace(bins, position_of=self._position_of)

    def _position_of(self, opl: mi.Float, rate: mi.Float) -> mi.Float:
        """Return the center of the film's bin for a length and a rate, -1 outside of all bins."""
        i = self.opl.bin_of(opl)
        j = self.rate.bin_of(rate)
        inside = (i >= 0) & (i < self.opl.count) & (j >= 0) & (j < self.rate.count)
        return dr.select(inside, i * self.rate.count + j + 0.5, -1)


class DopplerRecording(PhasorRecording):
    """Recording of phasors with a factor that depends on the rate of change of path length."""

    needs_rates = True
    emitters_apart = False  # All poses must use the same samples

    def __init__(self, film: mi.Film, exposure: Exposure, factor: Factor) -> None:
        super().__init__(film, exposure)
        self.factor = factor

    def measurement(self, camera: CameraSample, one_writer: bool = False) -> PhasorSum:
        """Create the sums of phasors."""
        return PhasorSum.zero(self.film.frequencies_hz, self._splat(camera), self.factor)
