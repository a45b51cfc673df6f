"""Plan of a laser scan, whose laser spot may depend on each camera ray."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import mitsuba as mi

from ...integrators.plan import Plan
from ...paths.camera import behind_emitters
from ...paths.records import Limits, Path
from ...paths.scattering import Materials
from .corner import CornerConnections, accumulate_corner
from .scan import Scan


class ScanPlan(Plan):
    """Plan of a scan, whose endpoint depends on each camera ray.

    `light` is `RelayWallPath.laser`; `counts_spot` says whether the laser spot itself counts.
    """

    def __init__(
        self, scan: Scan, light: Callable[..., Any], limits: Limits, counts_spot: bool
    ) -> None:
        scattering = scan.space.with_phase_functions(scan.guided or Materials(scan.scene))
        endpoint: Any = None  # Made for the rays
        super().__init__(scan.scene, scan.space, endpoint, scattering, limits)
        self.scan, self.light, self.counts_spot = scan, light, counts_spot

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """None: what paths may run into depends on their camera ray."""
        return ()

    def for_bin_width(self, width_opl):
        """Return the plan itself, since a laser spot has no extent that bins could resolve."""
        return self

    def attached(self):
        """Plan for derivatives: the laser spot moves, and paths alone find its light."""
        if self.space.scatters:
            mend = "must be left out of the scene"
            raise ValueError(f"medium: has no derivatives around the corner; {mend}")
        if self.scan.specular is not None:
            shapes = ", ".join(repr(shape.id()) for shape in self.scan.specular.targets.shapes)
            raise ValueError(
                f"derivatives of light around the corner by mirrors or glass are not supported; "
                f"make {shapes} rough"
            )
        return self._with(mis_weight=None, reuses_spot=False)

    def counting_from(self, first_opl: float) -> ScanPlan:
        """Plan that leaves out light of a single bounce arriving before `first_opl` [m]."""
        return self._with(first_opl=first_opl)

    def _with(self, **changes: Any) -> ScanPlan:
        other = copy(self)
        other.scan = replace(self.scan, **changes)
        return other

    def illuminate(self, ray, origin, sampler, active):
        """Make the endpoint of camera rays, and radiance of the laser spots that they hit."""
        ray = self._behind(ray)
        laser, seen = self.light(self.scan, ray, origin, sampler, active)
        if seen is None or not self.counts_spot:
            return laser, []
        if self.scan.first_opl > 0:
            seen.active &= seen.opl >= self.scan.first_opl
        return laser, [seen]

    def connect_camera(self, endpoint, ray, origin, sampler, measurement, active):
        """Accumulate light around the corner, by connections."""
        guided = self.scan.guided
        if self.scan.mis_weight is None or guided is None:
            return super().connect_camera(endpoint, ray, origin, sampler, measurement, active)
        ray = self._behind(ray)
        start = Path.start(ray, origin, active, medium=self.space.medium_at_sensor(ray))
        path, seen = self.space.next_vertex(start, sampler)
        path.opl = mi.Float(0) if self.limits.camera_unwarp else seen.length
        active = guided.sends(seen, active)
        corner, shift = CornerConnections(self.space, guided, endpoint), sampler.next_2d()
        return accumulate_corner(corner, seen, path, shift, sampler, measurement, active)

    def _behind(self, ray):
        """Move rays past area lights, if those are hidden."""
        return behind_emitters(self.scan.scene, ray) if self.scan.hide_emitters else ray
