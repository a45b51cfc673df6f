"""Measurements that sum light along a path: all of it, or weighted by its length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import no_light
from .contribution import Contribution

Splat = Callable[[list[mi.Spectrum], mi.Point2f, mi.Bool], None]
"""Adds light at positions anywhere on the film [pixels]: one spectrum per picture, active lanes."""


@dataclass
class Radiance:
    """Sums all light, as a steady camera does."""

    total: mi.Spectrum  # An `mi.UnpolarizedSpectrum` or a Stokes vector
    splat: Splat | None = None  # Adds contributions that have a position

    @classmethod
    def zero(cls, splat: Splat | None = None) -> Radiance:
        """Create an empty sum."""
        return cls(no_light(), splat)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        if contribution.position is not None:
            self.splat([contribution.spectrum], contribution.position, contribution.active)
            return
        self.total += dr.select(contribution.active, contribution.spectrum, 0)

    @property
    def sums(self) -> list[mi.Spectrum]:
        """The sums as a list, for `with_sums`."""
        return [self.total]

    def with_sums(self, sums: list[mi.Spectrum]) -> Radiance:
        """Copy the measurement, with other sums."""
        return replace(self, total=sums[0])


@dataclass
class Weighted(Radiance):
    """Sums light times a weight of its length [m]: a gate, or the correlation with a modulation."""

    weight: Callable[[mi.Float], mi.Float] | None = None

    @classmethod
    def zero(cls, weight: Callable[[mi.Float], mi.Float], splat: Splat | None = None) -> Weighted:
        """Create an empty sum."""
        return cls(no_light(), splat, weight)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        weighted = contribution.spectrum * self.weight(contribution.opl)
        super().add(replace(contribution, spectrum=weighted))


@dataclass
class AsSplats:
    """Adds all contributions to a measurement as splats at the positions of their camera rays."""

    measurement: Radiance
    position: mi.Point2f

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        self.measurement.add(replace(contribution, position=self.position))
