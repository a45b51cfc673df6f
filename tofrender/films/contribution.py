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
    """Light that one path carries from an emitter to the sensor."""

    # radiance, in polarised variants a Stokes vector, of type `mi.SpectrumEntry`; the weight of the
    # camera ray is not in it
    spectrum: mi.Spectrum
    opl: mi.Float  # optical path length from the emitter to the sensor [m]
    active: mi.Bool  # lanes that have such a contribution
    # position on the film [pixels] of a splat; None for that of the camera ray
    position: mi.Point2f | None = None
    # where the path ends, on the emitter or, from lights, on the lens [m]; None if unknown
    end: mi.Point3f | None = None
    # rate of change of `opl` [m/s]; None unless it was asked for, and in scenes at rest
    rate: mi.Float | None = None


def rate_of(contribution: Contribution) -> mi.Float:
    """Return the rate of change of a contribution's length in active lanes [m/s], 0 at rest."""
    rate = mi.Float(0) if contribution.rate is None else contribution.rate
    return dr.select(contribution.active, rate, 0)
