"""Endpoint of light paths that connects to the camera, and storage of light-path vertices."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi

from ..media.phases import stored_medium_point
from ..paths.camera import behind_emitters
from ..paths.protocols import Endpoint, HistoryUpdates, Scattering
from ..paths.records import BSDFEval, BSDFSample, Connection, Path, Vertex
from ..paths.sensor_window import Arrival
from ..runtime.lane_memory import packed, tape
from ..signals.polarization import sensor_frame
from .emission import Emission, Emitted
from .lens import Lens
from .mis import BidirectionalMIS, PartialSums


@dataclass
class StoredVertex:
    """A vertex of a light path, stored so that camera paths can be connected to it later."""

    # Surface interaction, see `as_surface` for points of media
    si: mi.SurfaceInteraction3f

    # Number of vertices before this vertex
    depth: mi.UInt32

    # Throughput of the light path, without the emission weight
    β: mi.Spectrum

    # Index of refraction before the vertex, relative to the index at the light
    η: mi.Float

    # Optical path length from the light [m]
    opl: mi.Float

    # Partial MIS sums of the light path, see `PartialSums`
    a: mi.Float
    b: mi.Float

    # Medium that scatters at the vertex, null on surfaces; None in scenes without media
    medium: mi.MediumPtr | None

    # Rate of change of `opl` [m/s], None if rates are not computed
    rate: mi.Float | None

    # Velocity of the vertex [m/s], None if rates are not computed
    velocity: mi.Vector3f | None

    @classmethod
    def allocate(cls, count: int, in_media: bool, moves: bool) -> dr.Local:
        """Allocate lane memory for stored vertices.

        Args:
            count: Number of vertices.
            in_media: Whether vertices may be points of media.
            moves: Whether vertices have rates and velocities.
        """
        zero = mi.Float(0)
        example = cls(
            si=dr.zeros(mi.SurfaceInteraction3f),
            depth=mi.UInt32(0),
            β=dr.zeros(mi.Spectrum),
            η=zero,
            opl=zero,
            a=zero,
            b=zero,
            medium=dr.zeros(mi.MediumPtr) if in_media else None,
            rate=mi.Float(0) if moves else None,
            velocity=dr.zeros(mi.Vector3f) if moves else None,
        )
        return tape(example, count)

    def vertex(self, length: mi.Float, active: mi.Bool) -> Vertex:
        """Return the stored vertex as a vertex at the end of a ray with a length [m]."""
        if self.medium is None:
            return Vertex(self.si, length, active)
        medium = dr.select(active, self.medium, dr.zeros(mi.MediumPtr))
        return Vertex(self.si, length, active, stored_medium_point(self.si, medium))


@dataclass
class LightPath:
    """History of a light path."""

    # Partial MIS sums up to the last vertex
    partial_sums: PartialSums

    # Number of stored vertices
    count: mi.UInt32

    # Stored vertices in lane memory, None if vertices are not stored
    vertices: dr.Local | None


class LightPathHistory(HistoryUpdates[LightPath]):
    """Updates of the partial MIS sums of light paths, and storage of vertices for camera paths.

    Args:
        scene: The scene.
        emission: Emission sampling.
        emitted: The emission samples of the paths.
        scattering: Scattering of light paths.
        mis: The MIS weights.
        capacity: Largest number of stored vertices, 0 to store none.
        in_media: Whether vertices may be points of media.
        moves: Whether rates are computed.
    """

    def __init__(
        self,
        scene: mi.Scene,
        emission: Emission,
        emitted: Emitted,
        scattering: Scattering,
        mis: BidirectionalMIS,
        capacity: int,
        in_media: bool,
        moves: bool = False,
    ) -> None:
        self.scene = scene
        self.emission = emission
        self.emitted = emitted
        self.scattering = scattering
        self.mis = mis
        self.capacity = capacity
        self.in_media = in_media
        self.moves = moves

    def start(self) -> LightPath:
        """Create the history of a path without vertices."""
        vertices = None
        if self.capacity:
            vertices = StoredVertex.allocate(self.capacity, self.in_media, self.moves)
        return LightPath(PartialSums(mi.Float(0), mi.Float(0)), mi.UInt32(0), vertices)

    def at_vertex(self, path: Path[LightPath], vertex: Vertex, active: mi.Bool) -> LightPath:
        """Update the partial sums, and store the vertex if it has a smooth lobe."""
        # Update the partial sums
        history = path.history
        if not self.mis.exponent and not self.capacity:
            return history
        sums = self._partial_sums(path, vertex)
        count = history.count

        # Store the vertex
        if history.vertices is not None:
            store = active & self.scattering.smooth(vertex) & (count < self.capacity)
            record = StoredVertex(
                si=vertex.si,
                depth=path.depth,
                β=path.β,
                η=path.η,
                opl=path.opl,
                a=sums.a,
                b=sums.b,
                medium=vertex.medium_point.medium if self.in_media else None,
                rate=path.rate,
                velocity=path.velocity,
            )
            history.vertices.write(packed(record), dr.select(store, count, 0), store)
            count = count + dr.select(store, mi.UInt32(1), 0)
        return LightPath(sums, count, history.vertices)

    def _partial_sums(self, path: Path[LightPath], vertex: Vertex) -> PartialSums:
        """Return the partial sums at a vertex. At the first vertex, they follow from emission."""
        # Sums at later vertices
        start = self.emitted
        si = vertex.si
        power = self.mis.power
        cos = vertex.cosine(path.ray.d)
        later = self.mis.at_vertex(path.history.partial_sums, path, vertex)
        first = path.depth == 0

        # Density of next-event estimation from the first vertex to the point of emission
        ds = dr.zeros(mi.DirectionSample3f, dr.width(path.depth))
        ds.p = start.origin
        ds.n = start.normal
        ds.uv = start.uv
        ds.emitter = start.emitter
        ds.d = -start.ray.d
        ds.dist = vertex.length
        pdf = self.emission.samples.pdf_direction(si, ds, first & ~start.delta)
        ratio = self.emission.ratio(start.emitter, ds, pdf, vertex.length)

        # Sums at the first vertex, over the strategies that connect to the emitter or hit it
        inverse_cos = dr.select(cos > 0, dr.rcp(cos), 0)
        cannot_be_hit = start.delta | (not self.mis.hits)
        hit = dr.select(cannot_be_hit, 0, power(start.cos * inverse_cos / start.density))
        a = dr.select(first, power(ratio * inverse_cos), later.a)
        return PartialSums(a, dr.select(first, hit, later.b))

    def after_sample(self, path: Path, vertex: Vertex, bsdf_sample: BSDFSample) -> LightPath:
        """Update the partial sums for the next segment."""
        history = path.history
        if not self.mis.exponent:
            return history
        sums = self.mis.after_sample(history.partial_sums, vertex, bsdf_sample)
        return replace(history, partial_sums=sums)


@dataclass
class LensConnection(Connection):
    """Connection to the lens."""

    # The lens point with direction, distance and film position
    lens_sample: Arrival = field(kw_only=True)


class LensEndpoint(Endpoint):
    """Endpoint with the lens, for light paths: all strategies with t = 1.

    The weight of a connection is the camera's importance over the density of the lens point, times
    the geometric factor. The cosine of the importance cancels with the cosine at the lens, which
    leaves

        1 / (A cos³θ d²).

    Args:
        scene: The scene.
        lens: The lens.
        emitted: The emission samples of the paths.
        mis: The MIS weights.
        history: Updates of the paths' histories.
        connects: Whether paths connect to the lens.
        camera_unwarp: Whether path lengths exclude the segment to the lens.
        hide_emitters: Whether the lens sees through area lights.
    """

    importance = True
    finds_all = False

    def __init__(
        self,
        scene: mi.Scene,
        lens: Lens,
        emitted: Emitted,
        mis: BidirectionalMIS,
        history: LightPathHistory,
        connects: bool = True,
        camera_unwarp: bool = False,
        hide_emitters: bool = False,
    ) -> None:
        self.scene = scene
        self.lens = lens
        self.emitted = emitted
        self.mis = mis
        self.history = history
        self.connects = connects
        self.camera_unwarp = camera_unwarp
        self.hide_emitters = hide_emitters

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> LensConnection:
        """Sample a connection to a point on the lens."""
        # Sample a point on the lens
        si = vertex.si
        lens_sample = self._connect_lens(vertex, self.lens.sample(sampler))
        active = active & lens_sample.seen
        end = lens_sample.near

        # Skip hidden emitters
        if self.hide_emitters:
            active &= ~si.shape.is_emitter()
            end = behind_emitters(self.scene, mi.Ray3f(end, -lens_sample.direction)).o

        # Weight and length of the connection
        light = self.emitted.weight * (lens_sample.density / dr.square(lens_sample.distance))
        weight = dr.select(active, light, 0)
        length = mi.Float(0) if self.camera_unwarp else lens_sample.distance
        return LensConnection(
            point=end,
            direction=lens_sample.direction,
            weight=weight,
            length=length,
            active=active,
            pdf=lens_sample.density,
            position=lens_sample.position,
            frame=sensor_frame(self.lens.sensor, mi.Ray3f(si.p, -lens_sample.direction)),
            medium_length=lens_sample.distance,
            rate=mi.Float(0) if self.camera_unwarp else None,
            lens_sample=lens_sample,
        )

    def _connect_lens(self, vertex: Vertex, lens: mi.Point3f) -> Arrival:
        """Connect a vertex to a lens point. The clip planes do not affect points of media."""
        p = vertex.si.p
        if vertex.in_medium is None:
            return self.lens.arrive(p, lens)

        # Points in front of the near plane connect to the lens itself
        lens_sample = self.lens.arrive(p, lens, vertex.medium_point.here)
        before = dr.norm(lens_sample.near - lens) > lens_sample.distance
        lens_sample.near = dr.select(before, lens, lens_sample.near)
        return lens_sample

    def mis_weight(
        self, path: Path[LightPath], vertex: Vertex, connection: LensConnection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return the MIS weight of strategy (s, 1), which connects to the lens."""
        x = mi.Float(0)
        lens_sample = connection.lens_sample
        if self.mis.exponent:
            cos = vertex.cosine(connection.direction)
            density = lens_sample.density * cos / dr.square(lens_sample.distance)
            sums = path.history.partial_sums
            x = self.mis.power(density) * self.mis.sum(sums, bsdf_eval.pdf_reverse)
        return self.mis.weight(x, path.depth + 2, 1)
