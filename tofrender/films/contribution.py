"""What arrives at a film, or at whatever else measures light."""

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
        position: Where on the film it lands [pixels]; None where the camera's own ray started.
    """

    spectrum: Any
    opl: mi.Float
    active: mi.Bool
    position: Any = None


@dataclass
class Landing:
    """A measurement whose contributions all land as splats, at the camera rays' own positions.

    Attributes:
        measurement: What takes them.
        position: Where on the film [pixels].
    """

    measurement: Any
    position: mi.Point2f

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""
        self.measurement.add(replace(contribution, position=self.position))
