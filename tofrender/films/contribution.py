"""Contributions of paths, and the camera rays that measurements of them belong to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import drjit as dr
import mitsuba as mi


class CameraRays(Protocol):
    """Camera rays as films need them, see `paths.camera.CameraSample`."""

    ray: mi.RayDifferential3f
    weight: mi.UnpolarizedSpectrum
    position: mi.Point2f


@dataclass
class Contribution:
    """Light that one path carries from an emitter to the sensor.

    Attributes:
        spectrum: Radiance, in polarised variants a Stokes vector, of type `mi.SpectrumEntry`; the
            weight of the camera ray is not in it.
        opl: Optical path length from the emitter to the sensor [m].
        active: Lanes that have such a contribution.
        position: Position on the film [pixels] of a splat; None for that of the camera ray.
        end: Where the path ends, on the emitter or, from lights, on the lens [m]; None if unknown.
        rate: Rate of change of `opl` [m/s]; None unless it was asked for, and in scenes at rest.
    """

    spectrum: mi.Spectrum
    opl: mi.Float
    active: mi.Bool
    position: mi.Point2f | None = None
    end: mi.Point3f | None = None
    rate: mi.Float | None = None


def rate_of(contribution: Contribution) -> mi.Float:
    """Return the rate of change of a contribution's length in active lanes [m/s], 0 at rest."""
    rate = mi.Float(0) if contribution.rate is None else contribution.rate
    return dr.select(contribution.active, rate, 0)
