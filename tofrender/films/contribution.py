"""Contributions of paths, as measurements receive them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi


@dataclass
class Contribution:
    """Light that one path carries from an emitter to the sensor.

    Attributes:
        spectrum: Radiance, in polarised variants a Stokes vector, of type `mi.SpectrumEntry`; the
            weight of the camera ray is not in it.
        opl: Optical path length from the emitter to the sensor [m].
        active: Lanes that have such a contribution.
        position: Position on the film [pixels] of a splat; None for that of the camera ray.
    """

    spectrum: mi.Spectrum
    opl: mi.Float
    active: mi.Bool
    position: mi.Point2f | None = None


@dataclass
class AsSplats:
    """Adds all contributions as splats, at the positions of their camera rays.

    Attributes:
        measurement: The measurement that they are added to.
        position: Positions on the film [pixels].
    """

    measurement: Any
    position: mi.Point2f

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        self.measurement.add(replace(contribution, position=self.position))
