"""User-defined integrators: classes with a `sample` of their own, as students write them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.recording import Recording
from ..films.sums import Radiance
from ..signals.polarisation import summed, to_stokes
from .plan import Plan


def is_user_defined(integrator: Any) -> bool:
    """Whether an integrator's `sample` is defined outside of this package."""
    sample = getattr(type(integrator), "sample", None)
    return getattr(sample, "__module__", "").partition(".")[0] != __name__.partition(".")[0]


def follows(integrator: Any) -> dict[str, bool]:
    """Return what an integrator models, for `check_view`; None stands for one of this package."""
    return {
        "media": getattr(integrator, "follows_media", True),
        "polarisation": getattr(integrator, "follows_polarisation", integrator is None),
        "beams": follows_beams(integrator),
    }


def follows_beams(integrator: Any) -> bool:
    """Whether paths start at lights, or the scene's lights do not matter; see `check_scene`."""
    ignores_lights = not getattr(integrator, "needs_lights", True)
    return ignores_lights or getattr(integrator, "starts_at_lights", True)


@dataclass
class SampledRays:
    """Outcome of an integrator's `sample`: lanes that it says are valid, and non-finite values."""

    valid_ray: mi.Bool
    not_finite: mi.UInt32


class UserDefinedTracer:
    """Traces camera rays by an integrator's `sample(scene, sampler, ray, *more)`.

    Rays start on the sensor instead of at its near plane, since a `sample` measures lengths from
    where its ray starts. Lanes that it says are not valid are black. A film that needs the length
    of each path is refused, which a `sample` does not tell.
    """

    splats = False

    def __init__(self, integrator: Any, scene: mi.Scene, record: Recording, *more: Any) -> None:
        record.require_no_lengths(type(integrator).__name__)
        self.integrator, self.scene, self.more = integrator, scene, more

    def for_bin_width(self, width_opl: float | None) -> UserDefinedTracer:
        """Return the tracer unchanged."""
        return self

    def trace(self, sampler, ray, origin, measurement, active=True, frame=None):
        """Call `sample` with the rays; as `Plan.trace`, but with a measurement of its own."""
        ray = mi.RayDifferential3f(ray)
        ray.o = origin
        spectrum, valid, *_aovs = self.integrator.sample(self.scene, sampler, ray, *self.more)
        total = to_stokes(spectrum if frame is None else frame @ spectrum)
        valid, finite = mi.Bool(valid), dr.isfinite(summed(total))
        not_finite = dr.select(valid & ~finite, mi.UInt32(1), 0)
        radiance = Radiance(dr.select(valid & finite, total, 0))
        return radiance, SampledRays(valid, not_finite)


Tracer = Plan | UserDefinedTracer  # Has `trace`, `for_bin_width`, `scene` and `splats`
