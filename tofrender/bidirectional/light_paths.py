"""Emitters and the stored vertices of a light path, as the endpoint of camera paths."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..paths.endpoints.emitters import EmitterEndpoint
from ..paths.protocols import HistoryUpdates, Scattering
from ..paths.records import BSDFEval, BSDFSample, Connection, Hit, Path, Vertex
from ..signals.polarisation import apply_light_path
from .camera import LightPath, StoredVertex
from .emission import Emission
from .lens import Lens
from .mis import BidirectionalMIS, PartialSums


@dataclass
class EmitterConnection(Connection):
    """A connection to an emitter sample."""

    # density of the connection over that of emission, see `Emission.ratio`
    emission_ratio: mi.Float = field(kw_only=True)


@dataclass
class VertexConnection(Connection):
    """A connection to a stored vertex of a light path."""

    stored: StoredVertex = field(kw_only=True)
    vertex: Vertex = field(kw_only=True)
    # density with which the light path would have gone back from that vertex [1/sr]
    pdf_reverse: mi.Float = field(kw_only=True)


class CameraPathHistory(HistoryUpdates[PartialSums]):
    """Updates partial MIS sums of camera paths, whose rays start in some directions."""

    def __init__(self, mis: BidirectionalMIS, lens: Lens, direction: mi.Vector3f) -> None:
        self.mis, self.lens, self.direction = mis, lens, direction

    def start(self) -> PartialSums:
        """Return the partial sums of the lens."""
        a = mi.Float(0)
        if self.mis.camera_connections and self.mis.exponent:
            a = dr.rcp(self.mis.power(self.lens.density(self.direction)))
        return PartialSums(a, mi.Float(0))

    def at_vertex(self, path: Path[PartialSums], vertex: Vertex, active: mi.Bool) -> PartialSums:
        """Update the partial sums for the segment to a vertex."""
        return self.mis.at_vertex(path.history, path, vertex)

    def after_sample(self, path: Path, vertex: Vertex, bsdf_sample: BSDFSample) -> PartialSums:
        """Update the partial sums for the next segment."""
        if not self.mis.exponent:
            return path.history
        return self.mis.after_sample(path.history, vertex, bsdf_sample)


class StoredVertices:
    """Connections to the stored vertices of a light path with some emission weight."""

    def __init__(
        self, light: LightPath, weight: mi.UnpolarizedSpectrum, adjoint: Scattering, max_depth: int
    ) -> None:
        assert light.vertices is not None
        self.stored, self.stored_count, self.weight = light.vertices, light.count, weight
        self.adjoint, self.max_depth = adjoint, max_depth

    def count(self, path: Path) -> mi.UInt32:
        """Return the number of stored vertices that the path's maximum depth allows."""
        segments_left = mi.Int32(self.max_depth - 2) - mi.Int32(path.depth)
        return dr.minimum(self.stored_count, mi.UInt32(dr.maximum(segments_left, 0)))

    def sample(
        self,
        k: mi.UInt32,
        first: Connection,
        vertex: Vertex,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> VertexConnection:
        """Connect to stored vertex number k."""
        # Read the vertex
        active = active & (k < self.stored_count)
        record = self.stored.read(dr.select(active, k, 0), active)
        absent = dict.fromkeys(("medium", "rate", "velocity"))
        stored = StoredVertex(**absent | vars(record))
        # Lane memory that was never written has invalid pointers, which must not be called
        stored.si.shape = dr.select(active, stored.si.shape, dr.zeros(mi.ShapePtr))
        stored.si.instance = dr.select(active, stored.si.instance, dr.zeros(mi.ShapePtr))

        # Connect to it, and evaluate the adjoint BSDF there
        to_vertex = stored.si.p - vertex.si.p
        d2 = dr.squared_norm(to_vertex)
        distance = dr.sqrt(d2)
        d = to_vertex / distance
        active = active & (d2 > 0) & (stored.depth + path.depth + 3 <= self.max_depth)
        there = stored.vertex(distance, active)
        bsdf_eval = self.adjoint.eval_pdf(there, -d, active)
        weight = apply_light_path(self.weight, stored.β, bsdf_eval.f) / d2
        weight = dr.select(active, weight, 0)
        η = stored.η * bsdf_eval.η
        length, rate = distance + stored.opl / η, None
        if path.velocity is not None and stored.velocity is not None:
            assert stored.rate is not None
            rate = dr.dot(stored.velocity - path.velocity, d) + stored.rate / η
        return VertexConnection(
            *(stored.si.p, d, weight, length, active, bsdf_eval.pdf),
            rate=rate,
            stored=stored,
            vertex=there,
            pdf_reverse=bsdf_eval.pdf_reverse,
        )


class LightPaths(EmitterEndpoint):
    """Emitters, and the stored vertices of a light path: all strategies with t > 1.

    `adjoint` is the scattering of light paths; `options` as for `EmitterEndpoint`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        lens: Lens,
        emission: Emission,
        adjoint: Scattering,
        mis: BidirectionalMIS,
        max_depth: int,
        *options: bool,
    ) -> None:
        super().__init__(scene, sensor, *options)
        self.lens, self.emission, self.mis = lens, emission, mis
        self.adjoint, self.max_depth = adjoint, max_depth

    def for_paths(
        self, direction: mi.Vector3f, light: LightPath | None, weight: mi.UnpolarizedSpectrum | None
    ) -> LightPaths:
        """Return the endpoint for camera rays of some directions, and for their light paths."""
        other = copy(self)
        other.history = CameraPathHistory(self.mis, self.lens, direction)
        if light is not None:
            other.further = StoredVertices(light, weight, self.adjoint, self.max_depth)
        return other

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> EmitterConnection:
        """Sample an emitter, with the density of emission in the same direction."""
        ds, weight = self.sample_direction(vertex, sampler.next_2d(), active)
        ratio = mi.Float(0)
        if self.mis.exponent:
            ratio = self.emission.ratio(ds.emitter, ds, ds.pdf, ds.dist)
        connection = self.connection(vertex, ds, weight, active)
        return EmitterConnection(**vars(connection), emission_ratio=ratio)

    def hit_weight(self, path: Path[PartialSums], vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the MIS weight of strategy (0, t)."""
        x, power = mi.Float(0), self.mis.power
        if self.mis.exponent:
            ds = mi.DirectionSample3f(self.scene, si=vertex.si, ref=path.prev)
            emitted = self.emission.density(path.prev, ds, hit.pdf, vertex.length)
            x = power(hit.pdf) * path.history.a + power(emitted) * path.history.b
        return self.mis.weight(x, 0, path.depth + 2)

    def mis_weight(
        self, path: Path, vertex: Vertex, connection: Connection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return the MIS weight of strategy (1, t), or of a connection to a stored vertex."""
        mis, x = self.mis, mi.Float(0)
        cos = vertex.cosine(connection.direction)
        if isinstance(connection, EmitterConnection):
            if mis.exponent:
                emitted = mis.power(cos / connection.emission_ratio)
                x = emitted * mis.sum(path.history, bsdf_eval.pdf_reverse)
                if mis.hits:
                    ratio = mis.power(bsdf_eval.pdf / connection.pdf)
                    x += dr.select(connection.delta, 0, ratio)
            return mis.weight(x, 1, path.depth + 2)

        assert isinstance(connection, VertexConnection)
        stored = connection.stored
        if mis.exponent:
            d2 = dr.squared_norm(stored.si.p - vertex.si.p)
            from_here = bsdf_eval.pdf * connection.vertex.cosine(connection.direction) / d2
            from_there = connection.pdf * cos / d2
            light_sums = PartialSums(stored.a, stored.b)
            x = mis.power(from_here) * mis.sum(light_sums, connection.pdf_reverse)
            x += mis.power(from_there) * mis.sum(path.history, bsdf_eval.pdf_reverse)
        return mis.weight(x, stored.depth + 2, path.depth + 2)
