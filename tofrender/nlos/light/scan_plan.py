"""Plan of a laser scan, with a laser spot for each camera ray."""

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
    """Plan of a scan. The endpoint is created for each camera ray.

    Args:
        scan: The scan.
        light: The method `RelayWallPath.laser`, which creates the endpoint.
        limits: Limits of the paths.
        counts_spot: Whether light of the visible laser spot counts.
    """

    def __init__(
        self, scan: Scan, light: Callable[..., Any], limits: Limits, counts_spot: bool
    ) -> None:
        scattering = scan.space.with_phase_functions(scan.guided or Materials(scan.scene))
        # `illuminate` creates the endpoint
        endpoint: Any = None
        super().__init__(scan.scene, scan.space, endpoint, scattering, limits)
        self.scan = scan
        self.light = light
        self.counts_spot = counts_spot

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """Return an empty tuple, because the light that rays can hit depends on the camera ray."""
        return ()

    def for_bin_width(self, width_opl):
        """Return this plan, because bins do not resolve the extent of a laser spot."""
        return self

    def attached(self):
        """Return the plan for derivatives: the laser spot moves, and only walked paths find it.

        Raises:
            ValueError: The scene has media, mirrors or glass.
        """
        if self.space.scatters:
            raise ValueError(
                "medium: derivatives of light around the corner through media are not supported. "
                "Remove the media"
            )
        if self.scan.specular is not None:
            shapes = ", ".join(repr(shape.id()) for shape in self.scan.specular.targets.shapes)
            raise ValueError(
                f"derivatives of light around the corner by mirrors or glass are not supported; "
                f"make {shapes} rough"
            )
        return self._with(mis_weight=None, reuses_spot=False)

    def counting_from(self, first_opl: float) -> ScanPlan:
        """Return a plan without light of a single bounce that arrives before `first_opl` [m]."""
        return self._with(first_opl=first_opl)

    def _with(self, **changes: Any) -> ScanPlan:
        """Return a copy of this plan with changed fields of its scan."""
        other = copy(self)
        other.scan = replace(self.scan, **changes)
        return other

    def illuminate(self, ray, origin, sampler, active):
        """Create the endpoint for camera rays, and the light of the laser spots that they hit."""
        ray = self._behind(ray)
        laser, seen = self.light(self.scan, ray, origin, sampler, active)

        # Does the visible spot count?
        if seen is None or not self.counts_spot:
            return laser, []
        if self.scan.first_opl > 0:
            seen.active &= seen.opl >= self.scan.first_opl
        return laser, [seen]

    def connect_camera(self, endpoint, ray, origin, sampler, measurement, active):
        """Add paths with three bounces (wall, hidden target, wall) to the measurement.

        See `CornerConnections`: the vertex that the camera sees is connected to the laser spot
        through points on the hidden target shapes. The default connections are used if the scan
        does not sample hidden shapes.

        Returns:
            The measurement, and the number of contributions that are not finite.
        """
        guided = self.scan.guided
        if self.scan.mis_weight is None or guided is None:
            return super().connect_camera(endpoint, ray, origin, sampler, measurement, active)

        # Find the visible vertex
        ray = self._behind(ray)
        start = Path.start(ray, origin, active, medium=self.space.medium_at_sensor(ray))
        path, seen = self.space.next_vertex(start, sampler)
        path.opl = mi.Float(0) if self.limits.camera_unwarp else seen.length

        # Connect this vertex to the laser spot through a lattice of target points
        active = guided.guides_at(seen, active)
        corner = CornerConnections(self.space, guided, endpoint)
        shift = sampler.next_2d()
        return accumulate_corner(corner, seen, path, shift, sampler, measurement, active)

    def _behind(self, ray):
        """Move rays behind area lights, if area lights are hidden."""
        return behind_emitters(self.scan.scene, ray) if self.scan.hide_emitters else ray
