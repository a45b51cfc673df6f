"""Description of a laser scan, and of its laser spots."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from ...paths.protocols import Space
from .guided import Guided
from .specular_surfaces import Specular


@dataclass
class Spot:
    """Laser spot on a surface: the same in all lanes, or a different spot in each lane."""

    # Surface interaction at the spot. si.wi points to the laser
    si: mi.SurfaceInteraction3f

    # Power that arrives at the spot, including the cosine [W]
    power: Any

    # Optical length from the laser to the spot [m], or 0 if this length does not count
    distance: mi.Float

    # Beam that lights the spot
    beam: mi.Ray3f | None = None

    # Point from which the beam's length is counted
    origin: mi.Point3f | None = None

    # Number of mirrors and glass surfaces that the beam has passed
    bounces: mi.UInt32 | int = 0

    # Lanes in which one of these surfaces is not the relay wall
    off_wall: mi.Bool | bool = False

    def eval(self, direction: mi.Vector3f, active: mi.Bool) -> Any:
        """Return BSDF times cosine for the beam's light that leaves in a direction [1/sr]."""
        return self.si.bsdf().eval(mi.BSDFContext(), self.si, self.si.to_local(direction), active)


Beam = Callable[[mi.Sampler, mi.Bool], Spot]


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
