"""Measurements that sum light along a path: all of it, or weighted by its length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .contribution import Contribution


@dataclass
class Radiance:
    """The plain sum, as a steady camera measures it.

    Attributes:
        total: Sum of all contributions, of type `mi.UnpolarizedSpectrum`.
    """

    total: Any

    @classmethod
    def zero(cls) -> Radiance:
        """Nothing measured yet."""
        return cls(mi.UnpolarizedSpectrum(0))

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        self.total += dr.select(contribution.active, contribution.spectrum, 0)


@dataclass
class Weighted:
    """The sum of light times a weight of its length: a gate, or the correlation with a modulation.

    Attributes:
        total: Weighted sum of all contributions, of type `mi.UnpolarizedSpectrum`.
        weight: Takes a path length [m], gives the weight.
    """

    total: Any
    weight: Callable[[mi.Float], Any]

    @classmethod
    def zero(cls, weight: Callable[[mi.Float], Any]) -> Weighted:
        """Nothing measured yet."""
        return cls(mi.UnpolarizedSpectrum(0), weight)

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        weighted = contribution.spectrum * self.weight(contribution.opl)
        self.total += dr.select(contribution.active, weighted, 0)
