"""What an integrator decides before a render: the parts of the path loop."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, Self, TypeVar

import mitsuba as mi

from ..paths.protocols import Endpoint, Measurement, Scattering, Space
from ..paths.records import Limits, Path
from ..paths.walk import walk
from ..runtime.backend import uncollected

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
        memory, guide = self.endpoint.memory(), self.scattering.guide()
        place = self.space.place(ray)
        ray = self.endpoint.begin(ray)
        path = Path.start(ray, origin, active, memory, guide, place, frame)
        space, endpoint, scattering = self.space, self.endpoint, self.scattering
        with uncollected():
            return walk(sampler, path, space, endpoint, scattering, measurement, self.limits)
