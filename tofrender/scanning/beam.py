"""Plan of lidar shots: light that returns on its own way, and connections to the laser spot."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ..integrators.plan import Plan
from ..nlos.light.laser_spot import LaserSpot, scatter_beam
from ..nlos.light.scan import Scan, Spot
from ..paths.delta_lobes import DeltaLobes, Wavefront
from ..paths.protocols import Endpoint, HistoryUpdates, Parts, Space
from ..paths.records import BSDFEval, BSDFSample, Connection, Limits, Path, Vertex
from ..paths.scattering import MASK, Materials
from ..paths.surfaces import bsdfs_in, has_lobes, materials, name_of, spawn_ray
from ..paths.walk import walk
from ..runtime import checks
from ..signals.illuminants import white

MOST = 64  # Segments of a way whose depth is unlimited


def require_followed(scene: mi.Scene, space: Space) -> None:
    """Refuse water around the lidar, fog with mirrors, rough glass, and most masks."""
    flags, has = mi.BSDFFlags, mi.has_flag
    checks.require("index around the sensor", space.index, space.index == 1, "1, in air")
    if space.scatters and has_lobes(scene, flags.DeltaReflection, flags.DeltaTransmission):
        raise ValueError("scene: has media; must have none, or no mirrors and clear glass")
    for bsdf in materials(scene):
        each = bsdf.flags()
        clear = has(each, flags.DeltaTransmission) or has(each, flags.Null)
        masks = any(part.class_name() == MASK for part in bsdfs_in(bsdf))
        if has(each, flags.GlossyTransmission):
            fact = "is rough glass"
            remedy = "use dielectric, thindielectric or a material without transmission"
        elif clear and has(each, flags.Smooth):
            fact = "transmits straight and has a smooth lobe"
            remedy = "use the material without a mask, and do not blend it with clear materials"
        elif masks and DeltaLobes.are_mixed(bsdf):
            fact = "is a mask over a pane or over a blend of mirrors"
            remedy = "blend with null instead, or remove the mask"
        else:
            continue
        name = name_of(scene, bsdf)
        raise ValueError(f"{name} {fact}, which the lidar does not support; {remedy}")


def sample_cone(axis: mi.Vector3f, u: mi.Point2f, half_angle: float) -> mi.Vector3f:
    """Sample directions uniformly in cones, also in narrow ones, where 1 - cos would cancel."""
    disk = mi.warp.square_to_uniform_disk_concentric(u) * math.sin(half_angle / 2)
    r2 = dr.squared_norm(disk)
    across = disk * (2 * dr.sqrt(1 - r2))
    return mi.Frame3f(axis).to_world(mi.Vector3f(across.x, across.y, 1 - 2 * r2))


@dataclass
class Beam:
    """History of a beam on its way: its light, and its wavefront."""

    light: mi.UnpolarizedSpectrum  # throughput of the way out, which shares the lobes chosen back
    front: Wavefront


class BeamUpdates(HistoryUpdates[Beam]):
    """Light and ray differentials on straight ways and at delta lobes."""

    def __init__(self, scene: mi.Scene, ray: mi.Ray3f) -> None:
        self.scene, self.ray = scene, ray

    def start(self) -> Beam:
        """Create the beam at the start of the rays."""
        light = white(self.ray.wavelengths) + dr.zeros(mi.Float, dr.width(self.ray))
        return Beam(light, Wavefront.start(self.ray.d + dr.zeros(mi.Float, dr.width(self.ray))))

    def at_vertex(self, path: Path[Beam], vertex: Vertex, active: mi.Bool) -> Beam:
        """Spread the wavefront over the segment to a vertex."""
        return Beam(path.history.light, path.history.front.spread(vertex.length))

    def after_sample(self, path: Path[Beam], vertex: Vertex, bsdf_sample: BSDFSample) -> Beam:
        """Bend the wavefront at a delta lobe; light is not compressed as radiance is."""
        beam, sample = path.history, bsdf_sample
        flags = mi.RayFlags.All | mi.RayFlags.dNSdUV
        si = self.scene.ray_intersect(path.ray, flags, False, path.active)
        front = beam.front.bend(si, path.ray.d, sample.ray.d, sample.η)
        weight = mi.unpolarized_spectrum(sample.weight) * (sample.pdf * sample.η**2)
        return Beam(beam.light * weight, front)


class Receiver(Endpoint):
    """Lidar's receiver: smooth lobes are seen on the light's own way, by delta lobes before.

    The way back has the length, the lobes and, but for media, the transmittance of the way there.
    """

    history: BeamUpdates

    def __init__(self, scene: mi.Scene, ray: mi.Ray3f, origin: mi.Point3f, blocked: bool) -> None:
        self.history, self.origin, self.blocked = BeamUpdates(scene, ray), origin, blocked

    def connect(
        self, vertex: Vertex, path: Path[Beam], sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect a vertex to the receiver, with light over the wavefront's area."""
        beam, d = path.history, path.ray.d
        area = beam.front.area(d)
        back = Connection(self.origin, -d, beam.light / area, path.opl / path.η, active)
        back.unoccluded = mi.Bool(not self.blocked)
        return back


class MirrorsAndGlass(Materials):
    """Materials whose paths follow delta lobes only, also of surfaces that have smooth lobes."""

    def __init__(self, scene: mi.Scene) -> None:
        super().__init__(scene)
        self.lobes = DeltaLobes(scene)
        self.has_mixtures = any(DeltaLobes.are_mixed(bsdf) for bsdf in materials(scene))

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample delta lobes, and evaluate a connection if there is one."""
        # A BSDF would choose also among smooth lobes, and among those that share a direction
        alone = active & ~self.smooth(vertex)
        mixed = mi.Bool(False)
        if self.has_mixtures:
            mixed = active & self.lobes.mixed_at(vertex.si, active)
            alone &= ~mixed
        _, sample = super().sample(vertex, None, sampler, alone)
        if self.has_mixtures:
            lobe = self.lobes.sample(vertex.si, sampler.next_1d(), mixed)
            mixed &= dr.any(lobe.f > 0)
            ray = spawn_ray(vertex.si, lobe.direction, mi.Bool(True))
            weight = mi.Spectrum(lobe.f / lobe.probability)
            sample = replace(
                sample,
                ray=dr.select(mixed, ray, sample.ray),
                weight=dr.select(mixed, weight, sample.weight),
                pdf=dr.select(mixed, lobe.probability, sample.pdf),
                η=dr.select(mixed, lobe.η, sample.η),
                specular=sample.specular | mixed,
            )
        return self.eval_connection(vertex, connection), sample


class LidarPlan(Plan):
    """Laser and receiver with one cone, of the solid angle W, around each ray's `d_x`.

    A pulse has 1/W of its energy per steradian. Its light that returns on its own way, from smooth
    lobes behind any number of delta lobes, contributes with the wavefront's area A per solid angle

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
