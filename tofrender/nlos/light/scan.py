"""Description and plan of a laser scan, whose laser spot may depend on each camera ray."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi

from ...integrators.plan import Plan
from ...paths.camera import behind_emitters
from ...paths.protocols import Space
from ...paths.records import Limits, Path
from ...paths.scattering import Materials
from .corner import CornerConnections, accumulate_corner
from .guided import Guided
from .laser_spot import Beam, Spot
from .specular import Specular


@dataclass
class Scan:
    """Description of a laser scan: its geometry, and which paths to the laser spots count."""

    scene: mi.Scene
    space: Space  # with the media that laser and paths go through
    wall: list[mi.Shape]  # relay wall, empty if it is not known
    up: list[float]  # upward direction of the camera
    guided: Guided | None  # scattering that sends paths to hidden geometry
    hidden_only: bool  # count only paths with a vertex off the wall
    bounces: int  # count only paths of so many surface points with the laser spot; -1: all
    counts_legs: bool  # count the leg from the laser in lengths
    hide_emitters: bool  # let the sensor look through area lights
    specular: Specular | None = None  # mirrors and glass, None if there are none
    mis_weight: Callable[..., mi.Float] | None = None  # of walked paths, if connections compete
    follows_camera: bool = False  # aim the laser at the first surface of each camera ray
    solid_angle: Any = math.nan  # of the laser's beam [sr], if its spot is seen
    reuses_spot: bool = True  # trace a spot that is the same for a whole path only once
    first_opl: float = 0.0  # length before which light of a single bounce does not count [m]

    def reuse(self, beam: Beam, spot: Spot) -> Beam:
        """Beam that returns a spot that was traced already, unless derivatives need it anew."""
        return (lambda sampler, active: spot) if self.reuses_spot else beam


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
