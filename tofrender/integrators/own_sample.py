"""Integrators that bring a `sample` of their own, as students write them."""

from __future__ import annotations

from inspect import isfunction
from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.recording import Recording
from ..films.sums import Radiance
from ..paths.camera import CameraSample
from ..signals.polarisation import summed, to_stokes
from .passes import Follow


def brings_sample(integrator: Any) -> bool:
    """Whether a class outside of this package says what a ray sees."""
    sample = getattr(type(integrator), "sample", None)
    return getattr(sample, "__module__", "").partition(".")[0] != __name__.partition(".")[0]


def follows(integrator: Any) -> dict[str, bool]:
    """What of a scene an integrator follows, as `check_view` takes it.

    Media are left to one of another kind, which is asked what a ray sees; None is this package's.
    """
    return {
        "media": getattr(integrator, "follows_media", True),
        "polarisation": getattr(integrator, "follows_polarisation", integrator is None),
    }


def require_sample(integrator: Any, call: str) -> None:
    """Refuse what cannot be asked what a ray sees.

    Args:
        integrator: What should be an integrator.
        call: How it would be asked, for the message.

    Raises:
        TypeError: It has no `sample` of its own; one line.
    """
    if not isfunction(getattr(type(integrator), "sample", None)):  # Mitsuba's own knows no time
        kind = type(integrator).__name__
        raise TypeError(f"integrator = {kind}: has no sample of its own; must have {call}")


def by_sample(integrator: Any, scene: mi.Scene, record: Recording, *more: Any) -> Follow:
    """Follow camera rays by an integrator's `sample(scene, sampler, ray, *more)`.

    Rays start on the sensor instead of at its near plane, since a `sample` measures lengths from
    where its ray starts. Lanes that it says are not valid are black.

    Raises:
        TypeError: The film needs the length of each path, which a `sample` does not tell; one line.
    """
    record.require_no_lengths(type(integrator).__name__)

    def follow(sampler: mi.Sampler, camera: CameraSample, _: Any) -> Any:
        ray = mi.RayDifferential3f(camera.ray)
        ray.o = camera.origin
        spectrum, covered, *_aovs = integrator.sample(scene, sampler, ray, *more)
        total = to_stokes(spectrum if camera.frame is None else camera.frame @ spectrum)
        valid, finite = mi.Bool(covered), dr.isfinite(summed(total))
        radiance = Radiance(dr.select(valid & finite, total, 0))
        return radiance, valid, dr.select(valid & ~finite, mi.UInt32(1), 0)

    return follow
