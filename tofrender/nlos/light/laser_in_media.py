# pyright: reportArgumentType=false, reportOperatorIssue=false, reportCallIssue=false
"""A laser whose beam goes through fog: its light may be scattered before it lands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...paths.protocols import Scattering, Space
from ...paths.records import Path
from ...runtime.backend import tracing_lock
from ...scenes.media import media_of, scatterer_on
from ..device.relay_wall import first_hits
from .laser_spot import LaserSpot, Spot


@dataclass
class FirstScattering(Spot):
    """Where light of a beam is scattered first: a point of a medium, or where it lands.

    Attributes:
        vertex: That point.
        scattering: What becomes of light there.
    """

    vertex: Any = None
    scattering: Any = None

    def throws(self, direction: mi.Vector3f, active: mi.Bool) -> Any:
        """By the phase function, or by the material."""
        return self.scattering.turn(self.vertex, direction, active).f


class LaserInMedia(LaserSpot):
    """Connections to where the beam's light is scattered first, another point each time.

    The beam carries the power that would land in clear air. A point of a medium is chosen as paths
    choose theirs; light that is scattered more often than once before the wall is found by the
    camera's paths, which connect to points of the beam from the media around it.

    Args:
        *as_in_clear_air: As of `LaserSpot`.
        space: What beam and paths go through.
        scattering: What becomes of light in media, and on surfaces.
        counts_legs: Whether the way from the laser counts in lengths.
    """

    def __init__(
        self, *as_in_clear_air: Any, space: Space, scattering: Scattering, counts_legs: bool
    ) -> None:
        super().__init__(*as_in_clear_air)
        self.space, self.scattering, self.counts_legs = space, scattering, counts_legs

    def source(self, sampler: mi.Sampler, active: mi.Bool) -> FirstScattering:
        """Follow the beam up to its first real vertex."""
        lands, nothing = self.beam(sampler, active), dr.zeros(mi.Float, dr.width(active))
        ray = mi.Ray3f(lands.beam)
        ray.o, ray.d = ray.o + nothing, ray.d + nothing
        path = Path.start(ray, lands.origin, active, place=self.space.around(ray))
        path, vertex = self.space.next(path, sampler)
        lit = vertex.valid & dr.any(lands.power > 0)
        return FirstScattering(
            si=vertex.si,
            power=dr.select(lit, lands.power * path.β, 0),
            distance=vertex.length if self.counts_legs else mi.Float(0),
            vertex=vertex,
            scattering=self.scattering,
        )


@tracing_lock()
def require_clear_way(scene: mi.Scene, sensor: mi.Sensor, laser: np.ndarray) -> None:
    """Refuse fog on the way of a laser to the very points that the sensor looks at.

    Args:
        scene: The scene.
        sensor: The sensor.
        laser: Where the laser is [m], shape (3,).

    Raises:
        ValueError: There is some; one line.
    """
    if not media_of(scene, sensor):
        return
    ray, si = first_hits(scene, sensor)
    around = sensor.get_medium()
    lanes = dr.width(si.p)
    start = dr.full(mi.MediumPtr, around, lanes) if around else dr.zeros(mi.MediumPtr, lanes)
    found, there = scatterer_on(scene, ray, start, sensor)
    if found is None:
        back = si.spawn_ray_to(mi.Point3f(*laser.tolist()))
        found, _ = scatterer_on(scene, back, there, sensor)
    if found is not None:
        raise ValueError(
            f"{found.id() or 'medium'}: scatters the light of a laser that the sensor looks "
            "along, or up to where it looks, which would be infinite; must only absorb there, "
            "or be elsewhere, or the laser must have a spot_sigma or light a single point"
        )
