"""Plans: space, endpoint, scattering and limits that an integrator chooses for a render."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Self, TypeVar

import mitsuba as mi

from ..films.contribution import Contribution
from ..paths.camera import behind_emitters
from ..paths.kinds import Kind
from ..paths.protocols import Endpoint, Measurement, Parts, Scattering, Space
from ..paths.records import Limits, Path
from ..paths.walk import accumulate, walk
from ..runtime.backend import tracing_lock

M = TypeVar("M", bound=Measurement)


@dataclass(frozen=True)
class Techniques:
    """Which techniques a render may use for caustics and mirror images, see `caustics`."""

    caustic_photons: bool  # photons whose emission is aimed at mirrors and clear glass
    caustic_rays: bool  # rays from surfaces to emitters by delta lobes
    chain_rays: bool  # rays from the camera to emitters by delta lobes


class Plan(Parts):
    """Space, endpoint, scattering and limits for camera rays, and the trace of those.

    An integrator makes it from its parameters, a scene and a sensor, and keeps nothing of it.
    """

    splats = False  # whether contributions have positions on the film
    techniques = Techniques(caustic_photons=False, caustic_rays=False, chain_rays=False)

    def __init__(
        self,
        scene: mi.Scene,
        space: Space,
        endpoint: Endpoint,
        scattering: Scattering,
        limits: Limits,
    ) -> None:
        super().__init__(space, endpoint, scattering, limits)
        self.scene = scene

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """Return emitters that camera rays may hit first, whose light may be sampled apart."""
        if self.limits.min_depth > 1:
            return ()
        return self.endpoint.visible_emitters()

    def for_bin_width(self, width_opl: float | None) -> Self:
        """Return the plan for a film that resolves lengths by `width_opl` [m]."""
        if width_opl is None:
            return self
        return self.with_endpoint(self.endpoint.for_bin_width(width_opl))

    def attached(self) -> Self:
        """Return the plan with derivatives of space and endpoint."""
        other = self.with_endpoint(self.endpoint.attached())
        other.space = self.space.attached()
        return other

    def by_depth(self, longest: int) -> tuple[Self, Self] | None:
        """Return plans of paths with up to `longest` segments, and with more; None if it cannot.

        It cannot unless its paths start at the camera, or if there are no longer ones.
        """
        limits = self.limits
        if type(self) is not Plan or self.endpoint.importance:
            return None
        if limits.bounded and limits.max_depth <= longest:
            return None
        short, long = copy(self), copy(self)
        short.limits, long.limits = copy(limits), copy(limits)
        short.limits.max_depth, long.limits.min_depth = longest, longest + 1
        return short, long

    def without(self, *kinds: Kind) -> Self:
        """Return the plan without some kinds of paths, which another technique renders."""
        other = copy(self)
        other.limits = copy(self.limits)
        other.limits.left_out = self.limits.left_out.union(kinds)
        return other

    def illuminate(
        self, ray: mi.Ray3f, origin: mi.Point3f, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Endpoint, list[Contribution]]:
        """Return the endpoint for these rays, and light of what they hit that no path finds.

        Only `nlos.light.scan_plan` overrides it: its laser spot may follow the camera ray.
        """
        return self.endpoint, []

    def start(
        self,
        endpoint: Endpoint,
        ray: mi.Ray3f,
        origin: mi.Point3f,
        active: mi.Bool | bool = True,
        frame: mi.Spectrum | None = None,
    ) -> Path:
        """Create the paths of camera rays, see `trace`."""
        if endpoint.hide_emitters:
            ray = behind_emitters(self.scene, ray)
        history = None if endpoint.history is None else endpoint.history.start()
        guide, medium = self.scattering.guide(), self.space.medium_at_sensor(ray)
        velocity = None if self.motion is None else self.motion.at_sensor(origin)
        return Path.start(
            ray=ray,
            origin=origin,
            active=active,
            history=history,
            guide=guide,
            medium=medium,
            frame=frame,
            η=self.space.index,
            velocity=velocity,
            stops=self.space.stops and endpoint.has_hits,
            records_lobes=bool(self.limits.left_out - {Kind.VISIBLE}),
        )

    @tracing_lock()
    def trace(
        self,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        origin: mi.Point3f,
        measurement: M,
        active: mi.Bool | bool = True,
        frame: mi.Spectrum | None = None,
    ) -> tuple[M, Path]:
        """Trace the paths of camera rays, whose lengths start at `origin` [m].

        `frame` is the Mueller matrix into the sensor's frame, None for none. Returns the
        measurement, and the paths at their ends, of which `valid_ray` and `not_finite` are read.
        """
        active, not_finite = mi.Bool(active), mi.UInt32(0)
        endpoint, contributions = self.illuminate(ray, origin, sampler, active)
        measurement, more = self.connect_camera(endpoint, ray, origin, sampler, measurement, active)
        for contribution in contributions:
            not_finite += accumulate(measurement, contribution)
        path = self.start(endpoint, ray, origin, active, frame)
        measurement, path = walk(sampler, path, self.with_endpoint(endpoint), measurement)
        path.not_finite += not_finite + more
        return measurement, path

    def connect_camera(self, endpoint, ray, origin, sampler, measurement, active):
        """Add connections that replace paths around the corner, see `nlos.light.scan_plan`.

        Returns the measurement, and how many contributions were not finite.
        """
        return measurement, mi.UInt32(0)
