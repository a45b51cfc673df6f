"""User-defined integrators: classes that define `sample()`, for example by students."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.recording import Recording
from ..films.sums import Radiance
from ..signals.polarization import summed, to_stokes
from .plan import Plan


def is_user_defined(integrator: Any) -> bool:
    """Return whether the method `sample()` of an integrator is defined outside of tofrender."""
    sample = getattr(type(integrator), "sample", None)
    return getattr(sample, "__module__", "").partition(".")[0] != __name__.partition(".")[0]


def follows(integrator: Any) -> dict[str, bool]:
    """Return which effects an integrator supports, as arguments of `check_view`.

    Args:
        integrator: The integrator, None for an integrator of tofrender.
    """
    return {
        "media": getattr(integrator, "follows_media", True),
        "polarization": getattr(integrator, "follows_polarization", integrator is None),
        "beams": follows_beams(integrator),
    }


def follows_beams(integrator: Any) -> bool:
    """Return whether paths start at emitters or emitters are ignored, see `check_scene`."""
    ignores_lights = not getattr(integrator, "needs_lights", True)
    return ignores_lights or getattr(integrator, "starts_at_lights", True)


@dataclass
class SampledRays:
    """Result of a user-defined `sample()`."""

    # Lanes that are valid according to `sample()`
    valid_ray: mi.Bool

    # Number of values that are not finite
    not_finite: mi.UInt32


class UserDefinedTracer:
    """Tracer that calls the method `sample(scene, sampler, ray, *arguments)` of an integrator.

    Rays start on the sensor instead of its near clipping plane, because `sample()` measures path
    lengths from the start of the ray. Lanes that are not valid are black. Films that need path
    lengths are refused, because `sample()` does not report path lengths.

    Args:
        integrator: The integrator.
        scene: The scene.
        record: Recording on the film.
        arguments: Arguments after the ray.
    """

    splats = False

    def __init__(
        self, integrator: Any, scene: mi.Scene, record: Recording, *arguments: Any
    ) -> None:
        record.require_no_lengths(type(integrator).__name__)
        self.integrator = integrator
        self.scene = scene
        self.arguments = arguments

    def for_bin_width(self, width_opl: float | None) -> UserDefinedTracer:
        """Return the tracer unchanged."""
        return self

    def trace(self, sampler, ray, origin, measurement, active=True, frame=None):
        """Call `sample()` with the rays.

        Arguments and results are the same as for `Plan.trace`, but the result is a new measurement.
        """
        # Call `sample()`
        ray = mi.RayDifferential3f(ray)
        ray.o = origin
        spectrum, valid, *_aovs = self.integrator.sample(self.scene, sampler, ray, *self.arguments)

        # Rotate Stokes vectors to the frame of the sensor
        total = to_stokes(spectrum if frame is None else frame @ spectrum)

        # Drop values that are not valid or not finite
        valid = mi.Bool(valid)
        finite = dr.isfinite(summed(total))
        not_finite = dr.select(valid & ~finite, mi.UInt32(1), 0)
        radiance = Radiance(dr.select(valid & finite, total, 0))
        return radiance, SampledRays(valid, not_finite)


Tracer = Plan | UserDefinedTracer
"""Tracer of camera rays, with `trace`, `for_bin_width`, `scene` and `splats`."""
