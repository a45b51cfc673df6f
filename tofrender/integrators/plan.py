"""What an integrator decides before a render: the parts of the path loop."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, Self, TypeVar

import mitsuba as mi

from ..films.contribution import Contribution
from ..paths.protocols import Endpoint, Measurement, Scattering, Space
from ..paths.records import Limits, Path
from ..paths.walk import deliver, walk
from ..runtime.backend import tracing_lock

M = TypeVar("M", bound=Measurement)


class Plan:
    """What is done with camera rays.

    An integrator makes it from its parameters, a scene and a sensor, and keeps nothing of it; a
    render carries it out.

    Args:
        space: How vertices are found.
        endpoint: What they connect to.
        scattering: How paths go on.
        limits: Which paths count.
    """

    splats = False
    """Whether light lands on the film beside the camera rays."""

    def __init__(
        self, space: Space, endpoint: Endpoint, scattering: Scattering, limits: Limits
    ) -> None:
        self.space, self.endpoint, self.scattering = space, endpoint, scattering
        self.limits = limits

    def in_view(self) -> Sequence[mi.Emitter]:
        """Emitters that camera rays may run into at once, whose light may be found apart."""
        return self.endpoint.in_view()

    def resolving(self, width_opl: float | None) -> Self:
        """The same for a film that tells lengths apart by `width_opl` [m], None if it does not."""
        if width_opl is None:
            return self
        other = copy(self)
        other.endpoint = self.endpoint.resolving(width_opl)
        return other

    def attached(self) -> Self:
        """The same as derivatives follow it: what connections depend on is asked for each time."""
        other = copy(self)
        other.endpoint = self.endpoint.attached()
        other.space = self.space.attached()
        return other

    def lit(
        self, ray: mi.Ray3f, origin: Any, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Endpoint, list[Contribution]]:
        """What paths of camera rays connect to, and light that the rays bring beside."""
        return self.endpoint, []

    def start(
        self, endpoint: Endpoint, ray: mi.Ray3f, origin: Any, active: Any = True, frame: Any = None
    ) -> Path:
        """Paths of camera rays, see `trace`."""
        memory, guide = endpoint.memory(), self.scattering.guide()
        space, ray = self.space, endpoint.begin(ray)
        place = space.place(ray)
        return Path.start(ray, origin, active, memory, guide, place, frame, space.index)

    @tracing_lock()
    def trace(
        self,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        origin: Any,
        measurement: M,
        active: Any = True,
        frame: Any = None,
    ) -> tuple[M, Path]:
        """Follow camera rays.

        Args:
            sampler: Random numbers.
            ray: The rays.
            origin: Where their lengths start [m].
            measurement: What becomes of their light.
            active: Lanes with a ray.
            frame: Matrix that turns polarised light of each ray, None to leave it as it is.

        Returns:
            The measurement, and the paths at their ends.
        """
        active, not_finite = mi.Bool(active), mi.UInt32(0)
        endpoint, beside = self.lit(ray, origin, sampler, active)
        measurement, more = self.around(endpoint, ray, origin, sampler, measurement, active)
        for light in beside:
            not_finite += deliver(measurement, light)
        path = self.start(endpoint, ray, origin, active, frame)
        parts = self.space, endpoint, self.scattering, measurement, self.limits
        measurement, path = walk(sampler, path, *parts)
        path.not_finite += not_finite + more
        return measurement, path

    def around(
        self,
        endpoint: Any,
        ray: mi.Ray3f,
        origin: Any,
        sampler: mi.Sampler,
        measurement: M,
        active: mi.Bool,
    ) -> tuple[M, mi.UInt32]:
        """Deliver light of camera rays that no path has to be walked for, by other connections.

        Returns:
            The measurement, and the number of contributions that were left out.
        """
        return measurement, mi.UInt32(0)
