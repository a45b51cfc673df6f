"""Contributions of paths, and the camera rays of their samples."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class CameraSample:
    """Camera rays through random points of pixels, one ray per lane."""

    # Rays in world space, which start at the near plane
    ray: mi.Ray3f

    # Point where lengths start [m]: the sensor's position, or the point on its lens
    origin: mi.Point3f

    # Importance of each ray over its density
    weight: mi.UnpolarizedSpectrum

    # Position on the film [pixels], which includes the crop offset. With a box filter, the corner
    # of the pixel, so that rounding cannot move a sample to the next pixel
    position: mi.Point2f

    # Mueller matrix that rotates the Stokes frame of each ray to the frame of the sensor, or None
    frame: mi.Spectrum | None = None


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
