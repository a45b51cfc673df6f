"""Next-event estimation of laser spots: the point of a wall, or of fog, that a beam hits first."""

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

COINCIDENT = 1e-10  # squared distance of two points, over that to a third, below which they are one


def trace_beam(scan: Scan, ray: mi.Ray3f, power: Any, active: Any, origin: Any) -> Spot:
    """Trace a beam of a power [W] to the first surface; the power is 0 where there is none.

    The distance counts from `origin`, if the scan counts it.
    """
    si = first_surface(scan.scene, ray, active)
    power = dr.select(si.is_valid(), power, 0)
    distance = dr.norm(si.p - origin) if scan.counts_legs else mi.Float(0)
    return Spot(si, power, distance, ray, origin)


class OffWallHistory(HistoryUpdates[mi.UInt32]):
    """History of paths: 1 if a vertex so far is off the relay wall, else 0."""

    def __init__(self, wall: list[mi.Shape]) -> None:
        self.wall = wall

    def start(self) -> mi.UInt32:
        """Return 0."""
        return mi.UInt32(0)

    def at_vertex(self, path: Path[mi.UInt32], vertex: Vertex, active: mi.Bool) -> mi.UInt32:
        """Return 1 if the vertex, or one before, is off the wall."""
        return dr.select(active & ~is_on(vertex.si, self.wall), mi.UInt32(1), path.history)


def counted_lanes(
    scan: Scan,
    path: Path,
    bounces: mi.UInt32,
    active: mi.Bool,
    off_wall: mi.Bool | bool = False,
) -> mi.Bool:
    """Lanes whose paths count: with a vertex off the wall, or of so many bounces.

    `off_wall` are lanes with a vertex off the wall that is not in the path's history.
    """
    if scan.bounces >= 0:
        active = active & (bounces == scan.bounces)
    return active & ((path.history != 0) | off_wall) if scan.hidden_only else active


class LaserSpot(Endpoint):
    """Connections to a laser spot, a point light with the material's reflection lobe.

    A laser of power Phi [W] that lands on p makes it a source of intensity

        I(w) = Phi f_p(w_laser, w) cos_p   [W/sr]

    so that a connection from y at the distance r receives I / r^2 and has the optical length
    r + |p - laser|. Rays that hit the spot by chance see no light. `beam` is called for each
    connection, since a beam with a width lands on another point each time. Where the scene has
    mirrors or glass, further connections go by way of those (`SpecularConnections`).

    Args:
        scan: The scan.
        beam: The laser spot of a connection; None for a spot that nothing connects to.
        max_depth: Longest path in segments, -1 for any.
    """

    def __init__(self, scan: Scan, beam: Beam, max_depth: int = -1) -> None:
        self.scan, self.beam, self.hide_emitters = scan, beam, scan.hide_emitters
        self.max_depth = max_depth
        self.history = OffWallHistory(scan.wall) if scan.hidden_only else None
        if scan.specular is not None:
            self.further = SpecularConnections(scan, beam, max_depth)

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect to the laser spot, with a MIS weight where corner connections compete."""
        connection = self.unweighted(vertex, path, sampler, active)
        if self.scan.mis_weight is not None:
            connection.weight *= self.scan.mis_weight(vertex, path)
        return connection

    def unweighted(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect to the laser spot, without a MIS weight."""
        spot = self.beam(sampler, active)
        segments = path.depth + 2 + spot.bounces
        active = counted_lanes(self.scan, path, segments, active, spot.off_wall)
        if self.scan.specular is not None and self.max_depth >= 0:
            active = active & (segments <= self.max_depth)
        to_spot = spot.si.p - vertex.si.p
        r2 = dr.squared_norm(to_spot)
        active = active & (r2 > 0) & dr.any(spot.power > 0)
        d = to_spot * dr.rsqrt(r2)
        f = spot.eval(-d, active)
        weight = spot.power * mi.unpolarized_spectrum(f) / r2
        length, active = dr.sqrt(r2) + spot.distance, active & ~dr.all(weight == 0)
        # Nothing blocks a path back to its previous vertex
        unoccluded = dr.squared_norm(spot.si.p - path.prev.p) <= COINCIDENT * r2
        weight = dr.select(active, weight, 0)
        return Connection(spot.si.p, d, weight, length, active, unoccluded=unoccluded)


def follow_beam(scan: Scan, beam: Beam) -> Beam:
    """Beam that goes on by mirrors and glass where it lands on such, sampled for each connection.

    Where a surface also has smooth lobes, such as plastic, half of the beams go on.
    """

    def followed(sampler: mi.Sampler, active: mi.Bool) -> Spot:
        return _follow_lobes(scan, beam(sampler, active), random_seeds(sampler), active)

    return followed


@dr.syntax
def _follow_lobes(scan: Scan, spot: Spot, seeds: list[mi.UInt32], active: mi.Bool) -> Spot:
    """Follow random delta lobes from a laser spot to the next one."""
    assert scan.specular is not None
    lobes = scan.specular.lobes
    nothing = dr.zeros(mi.Float, dr.width(active))
    si = dr.select(active, spot.si, dr.zeros(mi.SurfaceInteraction3f))
    power = mi.UnpolarizedSpectrum(spot.power) + nothing
    distance = spot.distance + nothing
    η = 1 + nothing
    bounces = mi.UInt32(0)
    off_wall = mi.Bool(False)
    number = mi.UInt32(seeds[0])
    following = active & si.is_valid()
    while following:
        # Does the beam end here? Half of those do that could
        has_lobes = lobes.at(si, following) != 0
        smooth = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth)
        power = dr.select(following & has_lobes & smooth, 2 * power, power)
        following &= has_lobes & (~smooth | (random_number(number, seeds[1]) < 0.5))

        # Follow a lobe; light is not compressed as radiance is
        lobe = lobes.sample(si, random_number(number + 1, seeds[1]), following)
        weight = lobe.f * (dr.square(lobe.η) / lobe.probability)
        power = dr.select(following, power * weight, power)
        off_wall |= following & ~is_on(si, scan.wall)
        ray = spawn_ray(si, lobe.direction, mi.Bool(True))
        found = first_surface(scan.scene, ray, following)

        # Land on the next surface
        η = dr.select(following, η * lobe.η, η)
        segment = dr.fma(η, dr.norm(found.p - si.p), distance)
        distance = dr.select(following, segment, distance)
        power = dr.select(following & ~found.is_valid(), 0, power)
        si = dr.select(following, found, si)
        bounces = dr.select(following, bounces + 1, bounces)
        following &= found.is_valid() & dr.any(power > 0) & (bounces < MOST_VERTICES)
        number += 2
    return Spot(si, power, distance, bounces=bounces, off_wall=off_wall)


@dataclass
class FirstScattering(Spot):
    """First scattering event of a beam, in a medium or on a surface."""

    vertex: Any = None
    scattering: Any = None

    def eval(self, direction: mi.Vector3f, active: mi.Bool) -> Any:
        """Phase function, or BSDF times cosine [1/sr]."""
        return self.scattering.eval_pdf(self.vertex, direction, active).f


def scatter_beam(scan: Scan, beam: Beam) -> Beam:
    """Beam up to its first scattering event in media, sampled anew for each connection.

    It carries the power that would land in clear air. Its free-flight distance is sampled as that
    of paths; light that scatters more than once before the wall is found by the camera's paths,
    which connect to points of the beam from the media around it.
    """
    space, scattering = scan.space, scan.space.with_phase_functions(Materials(scan.scene))

    def scattered(sampler: mi.Sampler, active: mi.Bool) -> Spot:
        spot, nothing = beam(sampler, active), dr.zeros(mi.Float, dr.width(active))
        ray = mi.Ray3f(spot.beam)
        ray.o, ray.d = ray.o + nothing, ray.d + nothing  # One for each lane
        path = Path.start(ray, spot.origin, active, medium=space.medium_at(ray))
        path, vertex = space.next_vertex(path, sampler)
        lit = vertex.valid & dr.any(spot.power > 0)
        power = dr.select(lit, spot.power * path.β, 0)
        distance = vertex.length if scan.counts_legs else mi.Float(0)
        return FirstScattering(vertex.si, power, distance, vertex=vertex, scattering=scattering)

    return scattered


@tracing_lock()
def require_smooth_spot(scan: Scan, si: mi.SurfaceInteraction3f) -> None:
    """Refuse laser spots on mirrors or glass in scenes with media, where no beam follows those."""
    if scan.specular is None or not scan.space.scatters:
        return
    if dr.any(scan.specular.lobes.at(si, mi.Bool(True)) != 0):
        raise ValueError(
            "laser: lights a mirror or glass in a scene with media, which is not supported. Make "
            "the surface rough, or remove the media"
        )


@tracing_lock()
def require_clear_way(scene: mi.Scene, sensor: mi.Sensor, laser: np.ndarray) -> None:
    """Refuse fog between a laser's position [m] and the very points that the sensor looks at."""
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
