"""Description and plan of a laser scan, with a laser spot for each camera ray."""

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

    # The scene
    scene: mi.Scene

    # Space between surfaces, with the media that laser and paths pass
    space: Space

    # Shapes of the relay wall, empty if the wall is unknown
    wall: list[mi.Shape]

    # Upward direction of the camera
    up: list[float]

    # Scattering that samples hidden geometry, None without guiding
    guided: Guided | None

    # Count only paths with a vertex off the wall
    hidden_only: bool

    # Count only paths of so many surface points, including the laser spot. -1 counts all
    bounces: int

    # Whether lengths include the leg from the laser
    counts_legs: bool

    # Whether area lights are invisible to the sensor
    hide_emitters: bool

    # Mirrors and glass, None without such surfaces
    specular: Specular | None = None

    # MIS weight of walked paths, None without corner connections
    mis_weight: Callable[..., mi.Float] | None = None

    # Whether the laser is aimed at the first surface of each camera ray
    follows_camera: bool = False

    # Solid angle of the laser's beam [sr], if its spot is visible
    solid_angle: Any = math.nan

    # Whether a laser spot that is the same for a whole path is traced only once
    reuses_spot: bool = True

    # Light of a single bounce does not count before this path length [m]
    first_opl: float = 0.0

    def reuse(self, beam: Beam, spot: Spot) -> Beam:
        """Return a beam that reuses a traced spot. With derivatives, the spot is traced again."""
        return (lambda sampler, active: spot) if self.reuses_spot else beam


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
            ValueError: The scene has media, mirrors or glass; one line.
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
        """Accumulate light of three bounces, by corner connections."""
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
