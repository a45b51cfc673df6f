"""Next-event estimation of laser spots: the first point of a wall or of fog that a beam hits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...paths.protocols import Endpoint, HistoryUpdates
from ...paths.records import Connection, Path, Vertex
from ...paths.scattering import Materials
from ...paths.surfaces import first_surface, is_on, spawn_ray
from ...runtime.backend import tracing_lock
from ...scenes.media import media_of, scatterer_on
from ..device.relay_wall import first_hits
from .scan import Beam, Scan, Spot
from .specular import MOST_VERTICES, SpecularConnections, random_number, random_seeds

# Two points coincide if their squared distance, relative to the squared distance to a third point,
# is smaller
COINCIDENT = 1e-10


def trace_beam(scan: Scan, ray: mi.Ray3f, power: Any, active: Any, origin: Any) -> Spot:
    """Trace a beam to the first surface, and return its laser spot.

    Args:
        scan: The scan.
        ray: The beam.
        power: Power of the beam [W]. Beams that hit no surface get the power 0.
        active: Active lanes.
        origin: Point from which the length is counted, if the scan counts it.
    """
    si = first_surface(scan.scene, ray, active)
    power = dr.select(si.is_valid(), power, 0)
    distance = dr.norm(si.p - origin) if scan.counts_legs else mi.Float(0)
    return Spot(si=si, power=power, distance=distance, beam=ray, origin=origin)


class OffWallHistory(HistoryUpdates[mi.UInt32]):
    """History of paths: 1 if a vertex of the path is not on the relay wall, otherwise 0."""

    def __init__(self, wall: list[mi.Shape]) -> None:
        self.wall = wall

    def start(self) -> mi.UInt32:
        """Return the history of a path without vertices, 0."""
        return mi.UInt32(0)

    def at_vertex(self, path: Path[mi.UInt32], vertex: Vertex, active: mi.Bool) -> mi.UInt32:
        """Return 1 if this vertex or an earlier vertex is not on the wall."""
        return dr.select(active & ~is_on(vertex.si, self.wall), mi.UInt32(1), path.history)


def counted_lanes(
    scan: Scan,
    path: Path,
    bounces: mi.UInt32,
    active: mi.Bool,
    off_wall: mi.Bool | bool = False,
) -> mi.Bool:
    """Return the lanes in which the scan includes the path, by the filters of the scan.

    Args:
        scan: The scan, with its filters `hidden_only` and `bounces`.
        path: The path.
        bounces: Number of surface points of the path, including the laser spot.
        active: Active lanes.
        off_wall: Lanes with another vertex off the wall, which is not part of the path's history.
    """
    if scan.bounces >= 0:
        active = active & (bounces == scan.bounces)
    if scan.hidden_only:
        active = active & ((path.history != 0) | off_wall)
    return active


class LaserSpot(Endpoint):
    """Connections to a laser spot, which acts as a point light with the material's BSDF.

    A laser of power Phi [W] that hits a point p turns this point into a source of intensity

        I(w) = Phi f_p(w_laser, w) cos_p   [W/sr]

    A connection from y at the distance r receives I / r^2. Its optical length is r + |p - laser|.
    Rays that hit the spot by chance find no light. `beam` is called for each connection, because a
    beam with a width hits another point each time. In scenes with mirrors or glass, further
    connections pass through these surfaces (see `SpecularConnections`).

    Args:
        scan: The scan.
        beam: Function that samples the laser spot of a connection.
        max_depth: Longest path in segments, -1 without a limit.
    """

    def __init__(self, scan: Scan, beam: Beam, max_depth: int = -1) -> None:
        self.scan = scan
        self.beam = beam
        self.hide_emitters = scan.hide_emitters
        self.max_depth = max_depth
        self.history = OffWallHistory(scan.wall) if scan.hidden_only else None
        if scan.specular is not None:
            self.further = SpecularConnections(scan, beam, max_depth)

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect to the laser spot, with the MIS weight if corner connections find it as well."""
        connection = self.unweighted(vertex, path, sampler, active)
        if self.scan.mis_weight is not None:
            connection.weight *= self.scan.mis_weight(vertex, path)
        return connection

    def unweighted(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect to the laser spot, without a MIS weight."""
        # Sample the laser spot. Does the path to this spot count?
        spot = self.beam(sampler, active)
        segments = path.depth + 2 + spot.bounces
        active = counted_lanes(self.scan, path, segments, active, spot.off_wall)
        if self.scan.specular is not None and self.max_depth >= 0:
            active = active & (segments <= self.max_depth)

        # Find the direction and the distance
        to_spot = spot.si.p - vertex.si.p
        r2 = dr.squared_norm(to_spot)
        active = active & (r2 > 0) & dr.any(spot.power > 0)
        d = to_spot * dr.rsqrt(r2)

        # Evaluate the light that the spot sends to the vertex
        f = spot.eval(-d, active)
        weight = spot.power * mi.unpolarized_spectrum(f) / r2
        length = dr.sqrt(r2) + spot.distance
        active = active & ~dr.all(weight == 0)

        # A path that returns to its previous vertex is not occluded
        unoccluded = dr.squared_norm(spot.si.p - path.prev.p) <= COINCIDENT * r2
        return Connection(
            point=spot.si.p,
            direction=d,
            weight=dr.select(active, weight, 0),
            length=length,
            active=active,
            unoccluded=unoccluded,
        )


def follow_beam(scan: Scan, beam: Beam) -> Beam:
    """Return a beam that continues through mirrors and glass, sampled for each connection.

    If a surface also has smooth lobes, like plastic, half of the beams continue.
    """

    def followed(sampler: mi.Sampler, active: mi.Bool) -> Spot:
        return _follow_lobes(scan, beam(sampler, active), random_seeds(sampler), active)

    return followed


@dr.syntax
def _follow_lobes(scan: Scan, spot: Spot, seeds: list[mi.UInt32], active: mi.Bool) -> Spot:
    """Follow random delta lobes from a laser spot to the next spot on a rough surface."""
    assert scan.specular is not None
    lobes = scan.specular.lobes
    # ----------------------- Loop state -----------------------

    nothing = dr.zeros(mi.Float, dr.width(active))

    # Last surface point of the beam
    si = dr.select(active, spot.si, dr.zeros(mi.SurfaceInteraction3f))

    # Power that arrives at this point [W]
    power = mi.UnpolarizedSpectrum(spot.power) + nothing

    # Optical length from the laser to this point [m]
    distance = spot.distance + nothing

    # Index of refraction after this point, relative to the index at the laser
    η = 1 + nothing

    # Number of delta vertices, and lanes with a delta vertex off the relay wall
    bounces = mi.UInt32(0)
    off_wall = mi.Bool(False)

    # Index of the next random number
    number = mi.UInt32(seeds[0])

    # Lanes that continue
    following = active & si.is_valid()
    while following:
        # ----------- Does the beam end here? If both is possible, half of the beams end -----------

        has_lobes = lobes.at(si, following) != 0
        smooth = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
        power = dr.select(following & has_lobes & smooth, 2 * power, power)
        following &= has_lobes & (~smooth | (random_number(number, seeds[1]) < 0.5))

        # -------------- Follow a lobe. Radiance has a factor 1/η², power does not --------------

        lobe = lobes.sample(si, random_number(number + 1, seeds[1]), following)
        weight = lobe.f * (dr.square(lobe.η) / lobe.probability)
        power = dr.select(following, power * weight, power)
        off_wall |= following & ~is_on(si, scan.wall)
        ray = spawn_ray(si, lobe.direction, mi.Bool(True))
        found = first_surface(scan.scene, ray, following)

        # ---------------------- Move to the next surface ----------------------

        η = dr.select(following, η * lobe.η, η)
        segment = dr.fma(η, dr.norm(found.p - si.p), distance)
        distance = dr.select(following, segment, distance)
        power = dr.select(following & ~found.is_valid(), 0, power)
        si = dr.select(following, found, si)
        bounces = dr.select(following, bounces + 1, bounces)
        following &= found.is_valid() & dr.any(power > 0) & (bounces < MOST_VERTICES)
        number += 2
    return Spot(si=si, power=power, distance=distance, bounces=bounces, off_wall=off_wall)


@dataclass
class FirstScattering(Spot):
    """First scattering event of a beam, in a medium or on a surface."""

    # Vertex at which the beam scatters
    vertex: Any = None

    # Scattering that evaluates the phase function or the BSDF at this vertex
    scattering: Any = None

    def eval(self, direction: mi.Vector3f, active: mi.Bool) -> Any:
        """Return the phase function, or BSDF times cosine [1/sr]."""
        return self.scattering.eval_pdf(self.vertex, direction, active).f


def scatter_beam(scan: Scan, beam: Beam) -> Beam:
    """Return a beam that ends at its first scattering event in media, sampled for each connection.

    The free-flight distance is sampled as for paths. The power is the power that would arrive
    without absorption and scattering. Light that scatters several times before it reaches the wall
    is found by camera paths: they connect from the surrounding medium to points of the beam.
    """
    space = scan.space
    scattering = space.with_phase_functions(Materials(scan.scene))

    def scattered(sampler: mi.Sampler, active: mi.Bool) -> Spot:
        # Repeat the beam in each lane
        spot = beam(sampler, active)
        nothing = dr.zeros(mi.Float, dr.width(active))
        ray = mi.Ray3f(spot.beam)
        ray.o = ray.o + nothing
        ray.d = ray.d + nothing

        # Sample the first scattering event
        path = Path.start(ray, spot.origin, active, medium=space.medium_at(ray))
        path, vertex = space.next_vertex(path, sampler)
        lit = vertex.valid & dr.any(spot.power > 0)
        power = dr.select(lit, spot.power * path.β, 0)
        distance = vertex.length if scan.counts_legs else mi.Float(0)
        return FirstScattering(
            si=vertex.si, power=power, distance=distance, vertex=vertex, scattering=scattering
        )

    return scattered


@tracing_lock()
def require_smooth_spot(scan: Scan, si: mi.SurfaceInteraction3f) -> None:
    """Raise a ValueError in scenes with media if a laser spot is on a mirror or on glass."""
    if scan.specular is None or not scan.space.scatters:
        return
    if dr.any(scan.specular.lobes.at(si, mi.Bool(True)) != 0):
        raise ValueError(
            "laser: the laser hits a mirror or glass in a scene with media, which is not "
            "supported. Make the surface rough, or remove the media"
        )


@tracing_lock()
def require_clear_way(scene: mi.Scene, sensor: mi.Sensor, laser: np.ndarray) -> None:
    """Raise a ValueError for media that scatter on sensor rays, or from their ends to the laser.

    A point laser that the sensor sees in fog has an infinite radiance.

    Args:
        scene: The scene.
        sensor: The sensor.
        laser: Position of the laser [m].

    Raises:
        ValueError: A medium scatters on one of these segments.
    """
    if not media_of(scene, sensor):
        return

    # Search the rays of the sensor
    ray, si = first_hits(scene, sensor)
    around = sensor.get_medium()
    lanes = dr.width(si.p)
    start = dr.full(mi.MediumPtr, around, lanes) if around else dr.zeros(mi.MediumPtr, lanes)
    found, there = scatterer_on(scene, ray, start, sensor)

    # Search the segments from the surface points to the laser
    if found is None:
        back = si.spawn_ray_to(mi.Point3f(*laser.tolist()))
        found, _ = scatterer_on(scene, back, there, sensor)
    if found is not None:
        raise ValueError(
            f"{found.id() or 'medium'}: the medium scatters light on the rays of the sensor or of "
            "the laser, so that the radiance is infinite. Make it absorb only, move it, give the "
            "laser a spot_sigma, or light a single point"
        )
