# pyright: reportArgumentType=false, reportCallIssue=false
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
from ...paths.guided import Guided
from ...paths.protocols import Space
from ...paths.records import Limits
from ...paths.scattering import Materials
from .corner import CornerConnections, CornerShare
from .laser_spot import Spot

Beam = Callable[[mi.Sampler, mi.Bool], Spot]


@dataclass
class Scan:
    """Description of a laser scan: its geometry, and how paths find the lit points.

    Attributes:
        scene: The scene.
        space: What laser and paths go through.
        wall: Shapes of the relay wall, empty if it is not known.
        up: The camera's upward direction.
        guided: The scattering that sends paths to hidden geometry, None without.
        share: What walked paths leave to connections around the corner, None without those.
        follows_camera: Whether the laser is turned to where each camera ray meets the scene.
        solid_angle: Solid angle of the laser's beam [sr], if its lit point counts.
        hide_emitters: Whether the sensor looks through the scene's area lights.
        held: Whether a lit point that is the same for a whole path is found only once.
        first_opl: Length before which light of a single bounce does not count [m].
    """

    scene: mi.Scene
    space: Space
    wall: list[mi.Shape]
    up: list[float]
    guided: Guided | None = None
    share: CornerShare | None = None
    follows_camera: bool = False
    solid_angle: Any = math.nan
    hide_emitters: bool = False
    held: bool = True
    first_opl: float = 0.0

    def hold(self, beam: Beam, spot: Spot) -> Beam:
        """A beam that lands on the same point each time, given the first."""
        return (lambda sampler, active: spot) if self.held else beam


class ScanPlan(Plan):
    """The plan of a scan: what is lit depends on each camera ray.

    Args:
        scan: What is scanned.
        light: Takes the scan, rays, their origins and the active lanes; gives what their paths
            connect to, and what the camera sees of the lit point itself, if that does not find it.
        limits: Which paths count.
        counts_spot: Whether the lit point itself does.
    """

    def __init__(
        self, scan: Scan, light: Callable[..., Any], limits: Limits, counts_spot: bool
    ) -> None:
        scattering = scan.space.with_phase_functions(scan.guided or Materials(scan.scene))
        endpoint: Any = None  # There is one when there are rays
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
        other = copy(self)
        if self.space.scatters:
            raise ValueError(
                "medium: has no derivatives around the corner; must be left out of the scene"
            )
        other.scan = replace(self.scan, share=None, held=False)
        return other

    def counting_from(self, first_opl: float) -> ScanPlan:
        """Plan that leaves out light of a single bounce arriving before `first_opl` [m]."""
        other = copy(self)
        other.scan = replace(self.scan, first_opl=first_opl)
        return other

    def illuminate(self, ray, origin, sampler, active):
        """The lit point, and what the camera sees of it."""
        ray = self._behind(ray)
        laser, seen = self.light(self.scan, ray, origin, sampler, active)
        if seen is None or not self.counts_spot:
            return laser, []
        if self.scan.first_opl > 0:
            seen.active &= seen.opl >= self.scan.first_opl
        return laser, [seen]

    def connect_camera(self, endpoint, ray, origin, sampler, measurement, active):
        """Light around the corner, by connections."""
        if self.scan.share is None:
            return super().connect_camera(endpoint, ray, origin, sampler, measurement, active)
        corner = CornerConnections(self.space, self.scan.share, endpoint)
        start = self._behind(ray), origin, self.limits.camera_unwarp
        return corner.add(*start, sampler, measurement, active)

    def _behind(self, ray):
        """The ray past area lights, if those are hidden."""
        return behind_emitters(self.scan.scene, ray) if self.scan.hide_emitters else ray
