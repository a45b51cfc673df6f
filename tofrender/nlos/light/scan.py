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
    """Laser spot on a surface; one, or one for each lane."""

    si: mi.SurfaceInteraction3f  # si.wi points to the laser
    power: Any  # power that arrives, the cosine included [W]
    distance: mi.Float  # optical length from the laser that counts [m]
    beam: mi.Ray3f | None = None
    origin: mi.Point3f | None = None  # start of the beam's length [m]
    # number of delta vertices that the beam has passed, and lanes where one is off the relay wall
    bounces: mi.UInt32 | int = 0
    off_wall: mi.Bool | bool = False

    def eval(self, direction: mi.Vector3f, active: mi.Bool) -> Any:
        """BSDF times cosine for light of the beam that leaves in a direction [1/sr]."""
        return self.si.bsdf().eval(mi.BSDFContext(), self.si, self.si.to_local(direction), active)


Beam = Callable[[mi.Sampler, mi.Bool], Spot]


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
