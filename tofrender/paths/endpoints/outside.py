"""Lights that are not part of a scene: a point source, and a white sky."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...sampling.warps import square_to_cosine_hemisphere, square_to_cosine_hemisphere_pdf
from ...signals.colour import white
from .scene_lights import Connection, Wavefronts


class _Outside:
    """A light that paths cannot run into."""

    connects = True
    finds_all = True

    def __init__(self, scene: mi.Scene) -> None:
        self.scene = scene

    def hit(self, si, previous, ray, active):
        """No light: what emits in the scene is dark."""
        return mi.UnpolarizedSpectrum(0), mi.Float(0), dr.norm(si.p - previous.p)

    def remember(self, memory: mi.Bool, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Nothing."""
        return memory

    def nearest(self, p: mi.Point3f) -> mi.Float:
        """No bound."""
        return mi.Float(0)


class PointSource(_Outside):
    """A point light of Mitsuba's that no scene needs to hold.

    Args:
        scene: What casts shadows.
        emitter: A `point` emitter.
    """

    def __init__(self, scene: mi.Scene, emitter: mi.Emitter) -> None:
        super().__init__(scene)
        self.emitter: Any = emitter

    def connect(self, si, path, sampler, active) -> Connection:
        """The one direction towards the light, with its shadow ray; draws no random number."""
        ds, weight = self.emitter.sample_direction(si, mi.Point2f(0.5), active)
        seen = active & ~self.scene.ray_test(si.spawn_ray_to(ds.p), active)
        weight = dr.select(seen, mi.unpolarized_spectrum(weight), 0)
        return Connection(ds.d, weight, ds.pdf, mi.Bool(True), ds.dist, seen)


class OpenSky(_Outside):
    """Radiance 1 from every direction in which there is no surface.

    Directions are sampled by their cosine to the shading normal, on the side that the path comes
    from. In time, the light of each direction starts on the plane that `Wavefronts` says.

    Args:
        scene: What the sky is hidden by.
        sensor: As in `SceneLights`.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
        super().__init__(scene)
        self.sphere = Wavefronts.around(scene, sensor)

    def connect(self, si, path, sampler, active) -> Connection:
        """Sample a direction of the sky, with its shadow ray."""
        local = square_to_cosine_hemisphere(sampler.next_2d())
        pdf = square_to_cosine_hemisphere_pdf(local)
        d = si.to_world(mi.Vector3f(local.x, local.y, dr.mulsign(local.z, si.wi.z)))
        seen = active & (pdf > 0)
        seen &= ~self.scene.ray_test(si.spawn_ray(d), seen)
        weight = dr.select(seen, white(si.wavelengths) / pdf, 0)
        return Connection(d, weight, pdf, mi.Bool(True), self.sphere.length(si.p, d), seen)
