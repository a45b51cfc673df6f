"""The camera as the endpoint of paths from lights, and the vertices stored for other paths."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi

from ..media.phases import stored_medium_point
from ..paths.camera import behind_emitters
from ..paths.protocols import Endpoint, HistoryUpdates, Scattering
from ..paths.records import BSDFEval, BSDFSample, Connection, Path, Vertex
from ..paths.window import Arrival
from ..runtime.lane_memory import packed, tape
from ..signals.polarisation import sensor_frame
from .emission import Emission, Emitted
from .lens import Lens
from .mis import BidirectionalMIS, PartialSums


@dataclass
class StoredVertex:
    """A vertex of a path from a light."""

    si: mi.SurfaceInteraction3f
    depth: mi.UInt32  # number of vertices before it
    β: mi.Spectrum  # throughput, without the emission weight
    η: mi.Float  # index of refraction before it, relative to that at the light
    opl: mi.Float  # optical path length from the light [m]
    a: mi.Float  # partial MIS sums of the path, see `PartialSums`
    b: mi.Float
    medium: mi.MediumPtr | None  # scatters there, null on surfaces; None in scenes without media
    rate: mi.Float | None  # of `opl`, and velocity of the vertex [m/s]; None without rates
    velocity: mi.Vector3f | None

    @classmethod
    def allocate(cls, count: int, in_media: bool, moves: bool) -> dr.Local:
        """Allocate lane memory for stored vertices."""
        si, β, zero = dr.zeros(mi.SurfaceInteraction3f), dr.zeros(mi.Spectrum), mi.Float(0)
        medium = dr.zeros(mi.MediumPtr) if in_media else None
        rates = (mi.Float(0), dr.zeros(mi.Vector3f)) if moves else (None, None)
        return tape(cls(si, mi.UInt32(0), β, zero, zero, zero, zero, medium, *rates), count)

    def vertex(self, length: mi.Float, active: mi.Bool) -> Vertex:
        """Return it as a vertex at the end of a ray."""
        if self.medium is None:
            return Vertex(self.si, length, active)
        medium = dr.select(active, self.medium, dr.zeros(mi.MediumPtr))
        return Vertex(self.si, length, active, stored_medium_point(self.si, medium))


@dataclass
class LightPath:
    """History of a path from a light."""

    partial_sums: PartialSums  # partial MIS sums so far
    count: mi.UInt32  # number of stored vertices
    vertices: dr.Local | None  # the stored vertices, in lane memory


class LightPathHistory(HistoryUpdates[LightPath]):
    """Updates partial MIS sums of paths from lights, and stores vertices for camera paths.

    `capacity` is the number of stored vertices; with `in_media` they may be points of media, with
    `moves` they have rates.
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
        self.scene, self.emission, self.emitted = scene, emission, emitted
        self.scattering, self.mis = scattering, mis
        self.capacity, self.in_media, self.moves = capacity, in_media, moves

    def start(self) -> LightPath:
        """Create the history of a path without vertices."""
        vertices = None
        if self.capacity:
            vertices = StoredVertex.allocate(self.capacity, self.in_media, self.moves)
        return LightPath(PartialSums(mi.Float(0), mi.Float(0)), mi.UInt32(0), vertices)

    def at_vertex(self, path: Path[LightPath], vertex: Vertex, active: mi.Bool) -> LightPath:
        """Update the partial sums, and store the vertex if connections can find light there."""
        history = path.history
        if not self.mis.exponent and not self.capacity:
            return history
        sums, count = self._partial_sums(path, vertex), history.count
        if history.vertices is not None:
            store = active & self.scattering.smooth(vertex) & (count < self.capacity)
            record = StoredVertex(
                *(vertex.si, path.depth, path.β, path.η, path.opl, sums.a, sums.b),
                vertex.medium_point.medium if self.in_media else None,
                *(path.rate, path.velocity),
            )
            history.vertices.write(packed(record), dr.select(store, count, 0), store)
            count = count + dr.select(store, mi.UInt32(1), 0)
        return LightPath(sums, count, history.vertices)

    def _partial_sums(self, path: Path[LightPath], vertex: Vertex) -> PartialSums:
        """Return partial sums at a vertex; those of the first depend on the emission sample."""
        start, si, power = self.emitted, vertex.si, self.mis.power
        cos = vertex.cosine(path.ray.d)
        later = self.mis.at_vertex(path.history.partial_sums, path, vertex)
        first = path.depth == 0

        # Density of next-event estimation from the first vertex to the point of emission
        ds = dr.zeros(mi.DirectionSample3f, dr.width(path.depth))
        ds.p, ds.n, ds.uv, ds.emitter = start.origin, start.normal, start.uv, start.emitter
        ds.d, ds.dist = -start.ray.d, vertex.length
        pdf = self.emission.samples.pdf_direction(si, ds, first & ~start.delta)
        ratio = self.emission.ratio(start.emitter, ds, pdf, vertex.length)

        # Sums over the strategies that connect to it, or hit it
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
    """A connection to the lens."""

    lens_sample: Arrival = field(kw_only=True)


class Camera(Endpoint):
    """The lens, for paths from lights: all strategies with t = 1.

    A connection carries the camera's importance over the density of the lens point, whose cosine,
    and that of the area that the lens covers, have cancelled:

        1 / (A cos³θ d²)

    With `camera_unwarp`, the segment to the lens does not count in lengths; with `hide_emitters`,
    the lens sees through area lights. Without `connects` there are no connections.
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
        self.scene, self.lens, self.emitted, self.mis = scene, lens, emitted, mis
        self.history, self.connects = history, connects
        self.camera_unwarp, self.hide_emitters = camera_unwarp, hide_emitters

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> LensConnection:
        """Sample a connection to a point on the lens."""
        si = vertex.si
        lens_sample = self._connect_lens(vertex, self.lens.sample(sampler))
        active = active & lens_sample.seen
        end = lens_sample.near
        if self.hide_emitters:
            active &= ~si.shape.is_emitter()
            end = behind_emitters(self.scene, mi.Ray3f(end, -lens_sample.direction)).o
        light = self.emitted.weight * (lens_sample.density / dr.square(lens_sample.distance))
        weight = dr.select(active, light, 0)
        length = mi.Float(0) if self.camera_unwarp else lens_sample.distance
        return LensConnection(
            *(end, lens_sample.direction, weight, length, active, lens_sample.density),
            position=lens_sample.position,
            frame=sensor_frame(self.lens.sensor, mi.Ray3f(si.p, -lens_sample.direction)),
            medium_length=lens_sample.distance,
            rate=mi.Float(0) if self.camera_unwarp else None,
            lens_sample=lens_sample,
        )

    def _connect_lens(self, vertex: Vertex, lens: mi.Point3f) -> Arrival:
        """Connect a vertex to a lens point; the clip planes hide no point of a medium."""
        p = vertex.si.p
        if vertex.in_medium is None:
            return self.lens.arrive(p, lens)
        lens_sample = self.lens.arrive(p, lens, vertex.medium_point.here)
        before = dr.norm(lens_sample.near - lens) > lens_sample.distance
        lens_sample.near = dr.select(before, lens, lens_sample.near)
        return lens_sample

    def mis_weight(
        self, path: Path[LightPath], vertex: Vertex, connection: LensConnection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return the MIS weight of strategy (s, 1)."""
        x, lens_sample = mi.Float(0), connection.lens_sample
        if self.mis.exponent:
            cos = vertex.cosine(connection.direction)
            density = lens_sample.density * cos / dr.square(lens_sample.distance)
            sums = path.history.partial_sums
            x = self.mis.power(density) * self.mis.sum(sums, bsdf_eval.pdf_reverse)
        return self.mis.weight(x, path.depth + 2, 1)
