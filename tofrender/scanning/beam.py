"""Plan of lidar shots: light that returns along the ray, and connections to the laser spot."""

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

# Largest number of segments of a ray without a limit of depth
MOST = 64


def require_followed(scene: mi.Scene, space: Space) -> None:
    """Raise a ValueError if the lidar does not support the scene.

    Raises:
        ValueError: The lidar is in water, or the scene contains fog with mirrors, rough glass, or
            certain masks.
    """
    flags = mi.BSDFFlags
    has = mi.has_flag
    checks.require("index around the sensor", space.index, space.index == 1, "1, in air")
    if space.scatters and has_lobes(scene, flags.DeltaReflection, flags.DeltaTransmission):
        raise ValueError(
            "scene: media are not supported together with mirrors or clear glass. Remove the media "
            "or the mirrors and clear glass"
        )
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
    """Sample uniform directions in cones around `axis`, without cancellation in narrow cones."""
    disk = mi.warp.square_to_uniform_disk_concentric(u) * math.sin(half_angle / 2)
    r2 = dr.squared_norm(disk)
    across = disk * (2 * dr.sqrt(1 - r2))
    return mi.Frame3f(axis).to_world(mi.Vector3f(across.x, across.y, 1 - 2 * r2))


@dataclass
class Beam:
    """History of a beam: its light, and its wavefront."""

    # Throughput on the way out. Only the sampled lobes are shared with the way back
    light: mi.UnpolarizedSpectrum

    # Derivatives of the ray by its initial direction
    front: Wavefront


class BeamUpdates(HistoryUpdates[Beam]):
    """Updates of light and ray differentials on straight segments and at delta lobes.

    Args:
        scene: The scene.
        ray: Rays of the shots.
    """

    def __init__(self, scene: mi.Scene, ray: mi.Ray3f) -> None:
        self.scene = scene
        self.ray = ray

    def start(self) -> Beam:
        """Create the beam at the start of the rays."""
        light = white(self.ray.wavelengths) + dr.zeros(mi.Float, dr.width(self.ray))
        return Beam(light, Wavefront.start(self.ray.d + dr.zeros(mi.Float, dr.width(self.ray))))

    def at_vertex(self, path: Path[Beam], vertex: Vertex, active: mi.Bool) -> Beam:
        """Spread the wavefront over the segment to a vertex."""
        return Beam(path.history.light, path.history.front.spread(vertex.length))

    def after_sample(self, path: Path[Beam], vertex: Vertex, bsdf_sample: BSDFSample) -> Beam:
        """Bend the wavefront at a delta lobe. Radiance has a factor 1/η², power does not."""
        beam = path.history
        sample = bsdf_sample
        flags = mi.RayFlags.All | mi.RayFlags.dNSdUV
        si = self.scene.ray_intersect(path.ray, flags, False, path.active)
        front = beam.front.bend(si, path.ray.d, sample.ray.d, sample.η)
        weight = mi.unpolarized_spectrum(sample.weight) * (sample.pdf * sample.η**2)
        return Beam(beam.light * weight, front)


class Receiver(Endpoint):
    """Receiver of the lidar, which sees smooth lobes along the way of the light.

    The way back has the same length and the same delta lobes as the way out, and the same
    transmittance except in media.

    Args:
        scene: The scene.
        ray: Rays of the shots.
        origin: Position of the lidar.
        blocked: Whether the way back must be tested for media.
    """

    history: BeamUpdates

    def __init__(self, scene: mi.Scene, ray: mi.Ray3f, origin: mi.Point3f, blocked: bool) -> None:
        self.history = BeamUpdates(scene, ray)
        self.origin = origin
        self.blocked = blocked

    def connect(
        self, vertex: Vertex, path: Path[Beam], sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect a vertex to the receiver. The weight is the light over the wavefront's area."""
        beam = path.history
        d = path.ray.d
        area = beam.front.area(d)
        back = Connection(
            point=self.origin,
            direction=-d,
            weight=beam.light / area,
            length=path.opl / path.η,
            active=active,
        )
        back.unoccluded = mi.Bool(not self.blocked)
        return back


class MirrorsAndGlass(Materials):
    """Materials with paths that follow only delta lobes, also on surfaces with smooth lobes."""

    def __init__(self, scene: mi.Scene) -> None:
        super().__init__(scene)
        self.lobes = DeltaLobes(scene)
        self.has_mixtures = any(DeltaLobes.are_mixed(bsdf) for bsdf in materials(scene))

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample delta lobes, and evaluate a connection if it is not None."""
        # Sample BSDFs that have one delta lobe per direction
        alone = active & ~self.smooth(vertex)
        mixed = mi.Bool(False)
        if self.has_mixtures:
            mixed = active & self.lobes.mixed_at(vertex.si, active)
            alone &= ~mixed

        # In mixtures, sample a delta lobe without smooth lobes and lobes of the same direction
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
    """Plan of laser and receiver with the same cone, of the solid angle W, around each ray's `d_x`.

    A pulse has the fraction 1/W of its energy per steradian. Light that returns along its own way,
    from smooth lobes behind any number of delta lobes, contributes

        W (1/W) f cos / A   [1/m^2 of the aperture],   A = r^2 on a straight way

    with the wavefront's area A per solid angle. All other light is found by connections to laser
    spots of random rays of the beam, times W.

    Args:
        scene: The scene.
        space: Space between surfaces.
        half_angle: Half angle of the cone [rad].
        max_depth: Longest path in segments, -1 without a limit.
    """

    def __init__(self, scene: mi.Scene, space: Space, half_angle: float, max_depth: int) -> None:
        self.half_angle = half_angle
        self.scan = Scan(
            scene=scene,
            space=space,
            wall=[],
            up=[],
            guided=None,
            hidden_only=False,
            bounces=-1,
            counts_legs=True,
            hide_emitters=False,
        )
        surfaces = space.with_phase_functions(Materials(scene))

        # Light that returns along the ray. With fog, mirrors are excluded
        self.returning_scattering = space.with_phase_functions(MirrorsAndGlass(scene))
        depth = MOST if max_depth < 0 else max_depth
        self.returning_depth = min(depth, 2) if space.scatters else depth

        # Other light, by connections to the laser spot
        limits = Limits(max_depth - 1 if max_depth > 0 else max_depth)
        super().__init__(scene, space, LaserSpot(self.scan, None), surfaces, limits)

    def illuminate(self, ray, origin, sampler, active):
        """Return the endpoint at the laser spots of the beam around each ray."""
        power = white(ray.wavelengths) * (4 * math.pi * math.sin(self.half_angle / 2) ** 2)

        def beam(sampler: mi.Sampler, active: mi.Bool) -> Spot:
            d = sample_cone(ray.d_x, sampler.next_2d(), self.half_angle)
            aimed = mi.Ray3f(ray.o, d, ray.time, ray.wavelengths)
            return Spot(
                si=dr.zeros(mi.SurfaceInteraction3f),
                power=power,
                distance=mi.Float(0),
                beam=aimed,
                origin=origin,
            )

        spots = LaserSpot(self.scan, scatter_beam(self.scan, beam))
        return spots, []

    def connect_camera(self, endpoint, ray, origin, sampler, measurement, active):
        """Accumulate light that returns along the rays, also by mirrors and clear glass."""
        receiver = Receiver(self.scene, ray, origin, self.space.scatters)
        limits = Limits(self.returning_depth, rr_depth=MOST)
        parts = Parts(self.space, receiver, self.returning_scattering, limits)
        history = receiver.history.start()
        medium = self.space.medium_at_sensor(ray)
        path = Path.start(ray, origin, active, history, medium=medium)
        measurement, path = walk(sampler, path, parts, measurement)
        return measurement, path.not_finite
