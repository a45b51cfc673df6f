"""Contributions of paths, and the camera rays of their samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi


class CameraRays(Protocol):
    """Interface of the camera rays of samples, see `paths.camera.CameraSample`."""

    ray: mi.RayDifferential3f  # The rays
    weight: mi.UnpolarizedSpectrum  # Weight of the sensor
    position: mi.Point2f  # Position on the film [pixels]


@dataclass
class Contribution:
    """Light that a path carries from an emitter to the sensor."""

    # Radiance without the weight of the camera ray [W m^-2 sr^-1]. In polarized variants, a Stokes
    # vector of type `mi.SpectrumEntry`
    spectrum: mi.Spectrum

    # Optical path length from the emitter to the sensor [m]
    opl: mi.Float

    # Lanes with a contribution
    active: mi.Bool

    # Position of a splat on the film [pixels], None for the position of the camera ray
    position: mi.Point2f | None = None

    # Point on the emitter or, for light paths, on the lens where the path ends [m]; None if unknown
    end: mi.Point3f | None = None

    # Rate of change of `opl` [m/s], None in scenes at rest or if rates are not computed
    rate: mi.Float | None = None


def rate_of(contribution: Contribution) -> mi.Float:
    """Return the rate of change of a contribution's path length [m/s], 0 in scenes at rest."""
    rate = mi.Float(0) if contribution.rate is None else contribution.rate
    return dr.select(contribution.active, rate, 0)
