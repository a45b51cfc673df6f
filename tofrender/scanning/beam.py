"""Plan of lidar shots: light that returns on its own way, and connections to the laser spot."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ..integrators.plan import Plan
from ..nlos.light.laser_spot import LaserSpot, Spot, scatter_beam
from ..nlos.light.scan import Scan
from ..paths.protocols import Endpoint, HistoryUpdates, Parts, Space
from ..paths.records import BSDFEval, BSDFSample, Connection, Limits, Path, Vertex
from ..paths.scattering import Materials
from ..paths.surfaces import has_lobes, materials, name_of
from ..paths.walk import walk
from ..runtime import checks
from ..signals.illuminants import white

MOST = 64  # Segments of a way whose depth is unlimited


def require_followed(scene: mi.Scene, space: Space) -> None:
    """Refuse water around the lidar, fog with mirrors, rough glass, and masks."""
    flags, has = mi.BSDFFlags, mi.has_flag
    checks.require("index around the sensor", space.index, space.index == 1, "1, in air")
    if space.scatters and has_lobes(scene, flags.DeltaReflection, flags.DeltaTransmission):
        raise ValueError("scene: has media; must have none, or no mirrors and clear glass")
    for bsdf in materials(scene):
        each = bsdf.flags()
        clear = has(each, flags.DeltaTransmission) or has(each, flags.Null)
        if has(each, flags.GlossyTransmission) or (clear and has(each, flags.Smooth)):
            raise ValueError(
                f"{name_of(scene, bsdf)} is rough glass or a mask, which is not supported as a "
                "lidar target. Use dielectric, thindielectric or a material without transmission"
            )


def sample_cone(axis: mi.Vector3f, u: mi.Point2f, half_angle: float) -> mi.Vector3f:
    """Sample directions uniformly in cones, also in narrow ones, where 1 - cos would cancel."""
    disk = mi.warp.square_to_uniform_disk_concentric(u) * math.sin(half_angle / 2)
    r2 = dr.squared_norm(disk)
    across = disk * (2 * dr.sqrt(1 - r2))
    return mi.Frame3f(axis).to_world(mi.Vector3f(across.x, across.y, 1 - 2 * r2))


@dataclass
class Wavefront:
    """History of a beam on its way: its light, and its ray differentials to both sides."""

    light: mi.UnpolarizedSpectrum  # throughput of the way out, which shares the lobes chosen back
    p1: mi.Vector3f  # differentials of the point by the direction at the start [m/rad]
    p2: mi.Vector3f
    d1: mi.Vector3f  # differentials of the direction
    d2: mi.Vector3f


class WavefrontUpdates(HistoryUpdates[Wavefront]):
    """Ray differentials on straight ways and at delta lobes (Igehy, SIGGRAPH 1999)."""

    def __init__(self, scene: mi.Scene, ray: mi.Ray3f) -> None:
        self.scene, self.ray = scene, ray

    def start(self) -> Wavefront:
        """Create the wavefront at the start of the rays."""
        across, zero = mi.Frame3f(self.ray.d), dr.zeros(mi.Vector3f, dr.width(self.ray))
        light = white(self.ray.wavelengths) + dr.zeros(mi.Float, dr.width(self.ray))
        return Wavefront(light, zero, mi.Vector3f(zero), across.s + zero, across.t + zero)

    def at_vertex(self, path: Path[Wavefront], vertex: Vertex, active: mi.Bool) -> Wavefront:
        """Spread the wavefront over the segment to a vertex."""
        front, length = path.history, vertex.length
        p1, p2 = dr.fma(front.d1, length, front.p1), dr.fma(front.d2, length, front.p2)
        return replace(front, p1=p1, p2=p2)

    def after_sample(
        self, path: Path[Wavefront], vertex: Vertex, bsdf_sample: BSDFSample
    ) -> Wavefront:
        """Bend the wavefront at a delta lobe; light is not compressed as radiance is."""
        front, sample = path.history, bsdf_sample
        p1, d1 = self._bend(front.p1, front.d1, path, sample)
        p2, d2 = self._bend(front.p2, front.d2, path, sample)
        weight = mi.unpolarized_spectrum(sample.weight) * (sample.pdf * sample.η**2)
        return Wavefront(front.light * weight, p1, p2, d1, d2)

    def _bend(
        self, p: Any, v: Any, path: Path, sample: BSDFSample
    ) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Return differentials of point and direction behind a delta lobe."""
        flags, d = mi.RayFlags.All | mi.RayFlags.dNSdUV, path.ray.d
        si = self.scene.ray_intersect(path.ray, flags, False, path.active)
        # Move along the ray onto the surface, and find how its normal changes there
        p = p - d * (dr.dot(p, si.n) / dr.dot(d, si.n))
        uu, uv, vv = (
            dr.squared_norm(si.dp_du),
            dr.dot(si.dp_du, si.dp_dv),
            dr.squared_norm(si.dp_dv),
        )
        pu, pv, area2 = dr.dot(p, si.dp_du), dr.dot(p, si.dp_dv), uu * vv - uv * uv
        dn = (si.dn_du * (vv * pu - uv * pv) + si.dn_dv * (uu * pv - uv * pu)) / area2
        side = -dr.sign(dr.dot(si.sh_frame.n, d))
        n, dn = mi.Vector3f(si.sh_frame.n) * side, mi.Vector3f(dn) * side
        # Differentiate d + 2 c n, or η d + (η c - c') n with the cosines c and c'
        c, out, η = -dr.dot(d, n), -dr.dot(sample.ray.d, n), 1 / sample.η
        dc = -dr.dot(v, n) - dr.dot(d, dn)
        refracted = η * v + (η * c - out) * dn + η * dc * (1 - η * c / out) * n
        return p, dr.select(out < 0, v + 2 * (dc * n + c * dn), refracted)


class Receiver(Endpoint):
    """Lidar's receiver: the first vertex that is no delta lobe is seen on the light's own way.

    The way back has the length, the lobes and, but for media, the transmittance of the way there.
    """

    history: WavefrontUpdates

    def __init__(self, scene: mi.Scene, ray: mi.Ray3f, origin: mi.Point3f, blocked: bool) -> None:
        self.history, self.origin, self.blocked = WavefrontUpdates(scene, ray), origin, blocked

    def connect(
        self, vertex: Vertex, path: Path[Wavefront], sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect a vertex to the receiver, with light over the wavefront's area."""
        front, d = path.history, path.ray.d
        area = dr.abs(dr.dot(dr.cross(front.p1, front.p2), d))
        back = Connection(self.origin, -d, front.light / area, path.opl / path.η, active)
        back.unoccluded = mi.Bool(not self.blocked)
        return back


class MirrorsAndGlass(Materials):
    """Materials whose paths end at the first vertex that is no delta lobe."""

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample delta lobes, and evaluate a connection if there is one."""
        _, sample = super().sample(vertex, None, sampler, active & ~self.smooth(vertex))
        return self.eval_connection(vertex, connection), sample


class LidarPlan(Plan):
    """Laser and receiver with one cone, of the solid angle W, around each ray's `d_x`.

    A pulse has 1/W of its energy per steradian. Its light that returns on its own way, from the
    first vertex that is no delta lobe, contributes with the wavefront's area A per solid angle

        W (1/W) f cos / A   [1/m^2 of the aperture],   A = r^2 on a straight way.

    All other light is found by connections to laser spots of rays of the beam, times W.
    """

    def __init__(self, scene: mi.Scene, space: Space, half_angle: float, max_depth: int) -> None:
        self.half_angle = half_angle
        self.scan = Scan(scene, space, [], [], None, False, -1, True, False)
        surfaces = space.with_phase_functions(Materials(scene))
        self.own_way = space.with_phase_functions(MirrorsAndGlass(scene))
        depth = MOST if max_depth < 0 else max_depth
        self.own_depth = min(depth, 2) if space.scatters else depth  # Fog excludes mirrors
        limits = Limits(max_depth - 1 if max_depth > 0 else max_depth)
        super().__init__(scene, space, LaserSpot(self.scan, None), surfaces, limits)

    def illuminate(self, ray, origin, sampler, active):
        """Return the laser spots of the beam around each ray, and light on the ray's own way."""
        power = white(ray.wavelengths) * (4 * math.pi * math.sin(self.half_angle / 2) ** 2)

        def beam(sampler: mi.Sampler, active: mi.Bool) -> Spot:
            d = sample_cone(ray.d_x, sampler.next_2d(), self.half_angle)
            aimed = mi.Ray3f(ray.o, d, ray.time, ray.wavelengths)
            return Spot(dr.zeros(mi.SurfaceInteraction3f), power, mi.Float(0), aimed, origin)

        spots = LaserSpot(self.scan, scatter_beam(self.scan, beam))
        return spots, []

    def connect_camera(self, endpoint, ray, origin, sampler, measurement, active):
        """Add the light that returns on the rays' own ways, by mirrors and clear glass, too."""
        receiver = Receiver(self.scene, ray, origin, self.space.scatters)
        limits = Limits(self.own_depth, rr_depth=MOST)
        parts = Parts(self.space, receiver, self.own_way, limits)
        history, medium = receiver.history.start(), self.space.medium_at_sensor(ray)
        path = Path.start(ray, origin, active, history, medium=medium)
        measurement, path = walk(sampler, path, parts, measurement)
        return measurement, path.not_finite
