"""Plans: the space, endpoint, scattering and limits of a render, chosen by an integrator."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import mitsuba as mi

from ..films.contribution import Contribution
from ..paths.camera import behind_emitters
from ..paths.path_kinds import Kind
from ..paths.protocols import Endpoint, Measurement, Parts, Scattering, Space
from ..paths.records import Limits, Path
from ..paths.walk import accumulate, walk
from ..runtime.backend import tracing_lock

M = TypeVar("M", bound=Measurement)


@dataclass(frozen=True)
class Techniques:
    """Which techniques a render may use in addition to its main paths.

    The module `caustics` describes the techniques for caustics and mirror images, and chooses one
    for each kind of paths. The module `shared_paths` describes shared paths.
    """

    # Photons that are aimed at mirrors and clear glass
    caustic_photons: bool

    # Rays from surfaces through delta lobes to emitters
    caustic_rays: bool

    # Rays from the camera through delta lobes to emitters
    chain_rays: bool

    # Paths that neighboring pixels share
    shared_paths: bool = False


class Plan(Parts):
    """Space, endpoint, scattering and limits of camera paths, and the tracing of these paths.

    An integrator creates a plan from its parameters, a scene and a sensor. The integrator does not
    keep the plan.

    Args:
        scene: The scene.
        space: Vacuum or participating media.
        endpoint: Light-sampling technique.
        scattering: Scattering at surfaces and in media.
        limits: Limits of the paths.
    """

    # Whether contributions have positions on the film
    splats = False

    # Techniques that renders may use in addition to the main paths
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
        """Return emitters that camera rays may hit first, and that extra rays may sample."""
        if self.limits.min_depth > 1:
            return ()
        return self.endpoint.visible_emitters()

    def for_bin_width(self, width_opl: float | None) -> Self:
        """Return the plan for a film with time bins of a width [m], None without time bins."""
        if width_opl is None:
            return self
        return self.with_endpoint(self.endpoint.for_bin_width(width_opl))

    def attached(self) -> Self:
        """Return a copy of the plan for attached sampling.

        In attached sampling, derivatives also go through the sampled points: through free-flight
        distances in media, and through points on moving emitters.
        """
        other = self.with_endpoint(self.endpoint.attached())
        other.space = self.space.attached()
        return other

    def by_depth(self, longest: int) -> tuple[Self, Self] | None:
        """Split the plan into short paths and long paths.

        Args:
            longest: Largest number of segments of the short paths.

        Returns:
            The plans of the short and the long paths. None for light tracing and for subclasses,
            and if `max_depth <= longest`.
        """
        limits = self.limits
        if type(self) is not Plan or self.endpoint.importance:
            return None
        if limits.bounded and limits.max_depth <= longest:
            return None

        # Short paths end after `longest` segments
        short = copy(self)
        short.limits = copy(limits)
        short.limits.max_depth = longest

        # Long paths count from one more segment
        long = copy(self)
        long.limits = copy(limits)
        long.limits.min_depth = longest + 1
        return short, long

    def without_shared_paths(self) -> Self:
        """Return the plan without the technique of shared paths."""
        other = copy(self)
        other.techniques = replace(self.techniques, shared_paths=False)
        return other

    def without(self, *kinds: Kind) -> Self:
        """Return the plan without some kinds of paths, which other techniques render."""
        other = copy(self)
        other.limits = copy(self.limits)
        other.limits.left_out = self.limits.left_out.union(kinds)
        return other

    def illuminate(
        self, ray: mi.Ray3f, origin: mi.Point3f, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Endpoint, list[Contribution]]:
        """Return the endpoint of the paths, and contributions that the paths do not find.

        A subclass may choose the endpoint for each camera ray. For example, the laser spot of
        `nlos.light.scan_plan` may follow the camera rays.

        Args:
            ray: Camera rays.
            origin: Points where path lengths start [m].
            sampler: The sampler.
            active: Active lanes.
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
        """Create the paths of camera rays, with the arguments of `trace`."""
        if endpoint.hide_emitters:
            ray = behind_emitters(self.scene, ray)
        history = None if endpoint.history is None else endpoint.history.start()
        guide = self.scattering.guide()
        medium = self.space.medium_at_sensor(ray)
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
        """Trace the paths of camera rays.

        Args:
            sampler: The sampler.
            ray: Camera rays.
            origin: Points where path lengths start [m].
            measurement: Measurement that light is added to.
            active: Active lanes.
            frame: Mueller matrix to the sensor's frame, None for the identity.

        Returns:
            The measurement, and the final state of the paths. Callers read the fields `valid_ray`
            and `not_finite` of the state.
        """
        # Add the light that the paths do not find
        active = mi.Bool(active)
        not_finite = mi.UInt32(0)
        endpoint, contributions = self.illuminate(ray, origin, sampler, active)
        measurement, camera_not_finite = self.connect_camera(
            endpoint, ray, origin, sampler, measurement, active
        )
        for contribution in contributions:
            not_finite += accumulate(measurement, contribution)

        # Trace the paths
        path = self.start(endpoint, ray, origin, active, frame)
        measurement, path = walk(sampler, path, self.with_endpoint(endpoint), measurement)
        path.not_finite += not_finite + camera_not_finite
        return measurement, path

    def connect_camera(self, endpoint, ray, origin, sampler, measurement, active):
        """Connect the camera rays to the endpoint. By default, no connections are made.

        `nlos.light.scan` overrides this method with connections that replace paths around the
        corner.

        Returns:
            The measurement, and the number of contributions that are not finite.
        """
        return measurement, mi.UInt32(0)
