"""Measurements that sum light along a path: all of it, or weighted by its length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import no_light
from .contribution import Contribution

Land = Callable[[list[Any], mi.Point2f, mi.Bool], None]
"""Takes (spectra, position, active) of light that lands on any pixel; one spectrum a picture."""


@dataclass
class Radiance:
    """The plain sum, as a steady camera measures it.

    Attributes:
        total: Sum of all contributions, an `mi.UnpolarizedSpectrum` or a Stokes vector.
        land: A `Land`, None if no light lands on other pixels.
    """

    total: Any
    land: Any = None

    @classmethod
    def zero(cls, land: Land | None = None) -> Radiance:
        """Nothing measured yet."""
        return cls(no_light(), land)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        if contribution.position is not None:
            self.land([contribution.spectrum], contribution.position, contribution.active)
            return
        self.total += dr.select(contribution.active, contribution.spectrum, 0)

    @property
    def sums(self) -> list[Any]:
        """All that is summed."""
        return [self.total]

    def with_sums(self, sums: list[Any]) -> Radiance:
        """The same with other sums."""
        return replace(self, total=sums[0])


@dataclass
class Weighted:
    """The sum of light times a weight of its length: a gate, or the correlation with a modulation.

    Attributes:
        total: Weighted sum of all contributions, an `mi.UnpolarizedSpectrum` or a Stokes vector.
        weight: Takes a path length [m], gives the weight.
        land: A `Land`, None if no light lands on other pixels.
    """

    total: Any
    weight: Callable[[mi.Float], Any]
    land: Any = None

    @classmethod
    def zero(cls, weight: Callable[[mi.Float], Any], land: Land | None = None) -> Weighted:
        """Nothing measured yet."""
        return cls(no_light(), weight, land)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        weighted = contribution.spectrum * self.weight(contribution.opl)
        if contribution.position is not None:
            self.land([weighted], contribution.position, contribution.active)
            return
        self.total += dr.select(contribution.active, weighted, 0)

    @property
    def sums(self) -> list[Any]:
        """All that is summed."""
        return [self.total]

    def with_sums(self, sums: list[Any]) -> Weighted:
        """The same with other sums."""
        return replace(self, total=sums[0])
