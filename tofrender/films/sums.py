"""Measurements of the sum of light along a path, with or without a weight by path length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..signals.polarization import no_light
from .contribution import Contribution

Splat = Callable[[list[mi.Spectrum], mi.Point2f, mi.Bool], None]
"""Function that adds light at any position of the film. Its arguments are one spectrum per image,
the position [pixels], and the active lanes.
"""


@dataclass
class Radiance:
    """Sum of all light, as a steady camera measures it."""

    # Sum of the light, an `mi.UnpolarizedSpectrum` or a Stokes vector
    total: mi.Spectrum

    # Function that adds contributions with a position
    splat: Splat | None = None

    @classmethod
    def zero(cls, splat: Splat | None = None) -> Radiance:
        """Create an empty sum."""
        return cls(no_light(), splat)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution to the sum, or to the film if it has a position."""
        if contribution.position is not None:
            self.splat([contribution.spectrum], contribution.position, contribution.active)
            return
        self.total += dr.select(contribution.active, contribution.spectrum, 0)

    @property
    def sums(self) -> list[mi.Spectrum]:
        """The sums as a list, for `with_sums`."""
        return [self.total]

    def with_sums(self, sums: list[mi.Spectrum]) -> Radiance:
        """Return a copy of the measurement with other sums."""
        return replace(self, total=sums[0])


@dataclass
class Weighted(Radiance):
    """Sum of light times a weight by path length [m], such as a gate or a modulation."""

    # Weight by path length
    weight: Callable[[mi.Float], mi.Float] | None = None

    @classmethod
    def zero(cls, weight: Callable[[mi.Float], mi.Float], splat: Splat | None = None) -> Weighted:
        """Create an empty sum."""
        return cls(no_light(), splat, weight)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution, multiplied by its weight."""
        weighted = contribution.spectrum * self.weight(contribution.opl)
        super().add(replace(contribution, spectrum=weighted))


@dataclass
class AsSplats:
    """Measurement that adds the contributions of camera rays as splats."""

    measurement: Radiance  # Measurement with a function for splats
    position: mi.Point2f  # Positions of the camera rays on the film [pixels]

    def add(self, contribution: Contribution) -> None:
        """Add a contribution as a splat at the position of its camera ray."""
        self.measurement.add(replace(contribution, position=self.position))
