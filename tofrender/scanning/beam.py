"""Beams of a lidar: their wavefronts at mirrors and glass, and connections to their light."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..integrators.plan import Plan
from ..nlos.light.laser_spot import LaserSpot, Spot, scatter_beam
from ..nlos.light.scan import Scan
from ..paths.protocols import Endpoint, HistoryUpdates, Space
from ..paths.records import BSDFSample, Connection, Limits, Path, Vertex
from ..paths.scattering import Materials
from ..paths.surfaces import has_lobes
from ..signals.illuminants import white

DELTA = (mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission)


def sample_cone(axis: mi.Vector3f, u: mi.Point2f, half_angle: float) -> mi.Vector3f:
    """Sample directions uniformly in cones, also in narrow ones, where 1 - cos would cancel."""
    disk = mi.warp.square_to_uniform_disk_concentric(u) * math.sin(half_angle / 2)
    r2 = dr.squared_norm(disk)
    across = disk * (2 * dr.sqrt(1 - r2))
    return mi.Frame3f(axis).to_world(mi.Vector3f(across.x, across.y, 1 - 2 * r2))


@dataclass
class Wavefront:
    """A beam along a path of delta lobes; `p`, `d` are derivatives by the first direction."""

    intact: mi.UInt32  # 1 while all vertices were delta lobes
    weight: mi.UnpolarizedSpectrum  # throughput of the light
    p1: mi.Vector3f  # of the last point [m]
    p2: mi.Vector3f
    d1: mi.Vector3f  # of the current direction
    d2: mi.Vector3f


class Wavefronts(HistoryUpdates[Wavefront]):
    """Ray differentials (Igehy, SIGGRAPH 1999) of a beam at mirrors and clear glass."""

    def __init__(self, scene: mi.Scene) -> None:
        self.scene, self.bends = scene, has_lobes(scene, *DELTA)

    def start(self) -> Wavefront:
        """Return the wavefront at the lidar."""
        return Wavefront(mi.UInt32(1), mi.UnpolarizedSpectrum(1), *[mi.Vector3f(0)] * 4)

    def at_vertex(self, path: Path, vertex: Vertex, active: mi.Bool) -> Wavefront:
        """Move the wavefront to the vertex."""
        front, first, frame = path.history, path.depth == 0, mi.Frame3f(path.ray.d)
        d1, d2 = dr.select(first, frame.s, front.d1), dr.select(first, frame.t, front.d2)
        p1, p2 = dr.fma(d1, vertex.length, front.p1), dr.fma(d2, vertex.length, front.p2)
        return replace(front, p1=p1, p2=p2, d1=d1, d2=d2)

    def after_sample(self, path: Path, vertex: Vertex, bsdf_sample: BSDFSample) -> Wavefront:
        """Reflect or refract the wavefront by a delta lobe."""
        front, sample = copy(path.history), bsdf_sample
        intact = (front.intact != 0) & sample.specular
        front.intact = dr.select(intact, mi.UInt32(1), 0)
        if self.bends:
            # Light is not compressed as radiance is; both ways share one choice of the lobe
            undone = dr.square(sample.η) * sample.pdf
            front.weight = front.weight * mi.unpolarized_spectrum(sample.weight) * undone
            flags, active = mi.RayFlags.All | mi.RayFlags.dNSdUV, intact & path.active
            si = self.scene.ray_intersect(path.ray, flags, False, active)
            front.p1, front.d1 = _bend(front.p1, front.d1, si, path.ray.d, sample)
            front.p2, front.d2 = _bend(front.p2, front.d2, si, path.ray.d, sample)
        return front


def _bend(p: Any, v: Any, si: Any, d: mi.Vector3f, sample: BSDFSample) -> tuple[Any, Any]:
    """Derivatives of point and direction behind a delta lobe, from those before it."""
    # Move along the ray onto the surface, and find how its normal changes there
    p = p - d * (dr.dot(p, si.n) / dr.dot(d, si.n))
    uu, uv, vv = (dr.dot(a, b) for a, b in ((si.dp_du,) * 2, (si.dp_du, si.dp_dv), (si.dp_dv,) * 2))
    pu, pv = dr.dot(p, si.dp_du), dr.dot(p, si.dp_dv)
    dn = (si.dn_du * (vv * pu - uv * pv) + si.dn_dv * (uu * pv - uv * pu)) / (uu * vv - uv * uv)
    side = -dr.sign(dr.dot(si.sh_frame.n, d))
    n, dn = mi.Vector3f(si.sh_frame.n) * side, mi.Vector3f(dn) * side
    # Differentiate d + 2 c n, or η d + (η c - c') n with the cosines c and c'
    c, out, η = -dr.dot(d, n), -dr.dot(sample.ray.d, n), 1 / sample.η
    dc = -dr.dot(v, n) - dr.dot(d, dn)
    refracted = η * v + (η * c - out) * dn + η * dc * (1 - η * c / out) * n
    return p, dr.select(out < 0, v + 2 * (dc * n + c * dn), refracted)


class Beam(Endpoint):
    """Connections to the light of a lidar's pulse.

    Light that goes back on its own way, from the first vertex that is no delta lobe, is sent into
    the receiver's cone of the solid angle W with 1/W of the pulse per steradian. It contributes

        W f cos / (W A) = f cos / A   [1/m^2 of the aperture]

    with the area A [m^2/sr] of the wavefront, r^2 on a straight way. All other light is found by
    connections to laser spots of rays of the beam, times W.
    """

    def __init__(self, scene: mi.Scene, space: Space, half_angle: float, max_depth: int) -> None:
        self.half_angle, self.max_depth, self.history = half_angle, max_depth, Wavefronts(scene)
        self.scattering = space.with_phase_functions(Materials(scene))
        self.scan = Scan(scene, space, [], [], None, False, -1, True, False)
        self.ray: Any = None
        self.laser: Any = None

    def aimed(self, ray: mi.RayDifferential3f) -> Beam:
        """Return the endpoint around rays, whose differential `d_x` is the beam's axis."""
        other = copy(self)
        other.ray, other.laser = ray, LaserSpot(self.scan, scatter_beam(self.scan, other._aim))
        other.further = other if self.half_angle > 0 else None
        return other

    def connect(self, vertex: Any, path: Path, sampler: Any, active: mi.Bool) -> Connection:
        """Connect to the light that has come along the path."""
        front, d = path.history, path.ray.d
        area = dr.abs(dr.dot(dr.cross(front.p1, front.p2), d))
        active = active & (front.intact != 0)
        weight = dr.select(active, white(path.ray.wavelengths) * front.weight / area, 0)
        length = path.opl / path.η
        return Connection(path.prev.p, -d, weight, length, active, unoccluded=mi.Bool(True))

    def count(self, path: Path) -> mi.UInt32:
        """Return 1 where a path with one segment more still counts, else 0."""
        counts = mi.Bool(self.max_depth < 0) | (path.depth + 2 < self.max_depth)
        return dr.select(counts, mi.UInt32(1), 0)

    def sample(self, k: Any, first: Any, vertex: Any, path: Any, sampler: Any, active: Any) -> Any:
        """Connect to the laser spot of a ray of the beam."""
        connection = self.laser.unweighted(vertex, path, sampler, active)
        η = path.η * self.scattering.eval_connection(vertex, connection).η
        r = dr.norm(connection.point - vertex.si.p)
        connection.length = r + (connection.length - r) / η  # The rest, of the beam, is in air
        return connection

    def _aim(self, sampler: mi.Sampler, active: mi.Bool) -> Spot:
        """Sample a ray of the beam, of the power W."""
        d = sample_cone(self.ray.d_x, sampler.next_2d(), self.half_angle)
        ray = mi.Ray3f(self.ray.o, d, self.ray.time, self.ray.wavelengths)
        power = white(ray.wavelengths) * (4 * math.pi * math.sin(self.half_angle / 2) ** 2)
        return Spot(dr.zeros(mi.SurfaceInteraction3f), power, mi.Float(0), ray, ray.o)


class LidarPlan(Plan):
    """Plan of shots, each with a beam of its own."""

    def __init__(self, scene: mi.Scene, space: Space, half_angle: float, limits: Limits) -> None:
        beam = Beam(scene, space, half_angle, limits.max_depth)
        super().__init__(scene, space, beam, beam.scattering, limits)

    def illuminate(self, ray, origin, sampler, active):
        """Return the beam around these rays."""
        return self.endpoint.aimed(ray), []
