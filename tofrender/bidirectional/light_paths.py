"""Endpoint of camera paths that connects to emitters and to the stored vertices of a light path."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field

import drjit as dr
import mitsuba as mi

from ..paths.endpoints.emitters import EmitterEndpoint
from ..paths.protocols import HistoryUpdates, Scattering
from ..paths.records import BSDFEval, BSDFSample, Connection, Hit, Path, Vertex
from ..signals.polarization import apply_light_path
from .emission import Emission
from .lens import Lens
from .lens_connections import LightPath, StoredVertex
from .mis import BidirectionalMIS, PartialSums


@dataclass
class EmitterConnection(Connection):
    """Connection to an emitter sample."""

    # Ratio of the densities of the connection and of emission, see `Emission.ratio`
    emission_ratio: mi.Float = field(kw_only=True)


@dataclass
class VertexConnection(Connection):
    """Connection to a stored vertex of a light path."""

    # The stored vertex
    stored: StoredVertex = field(kw_only=True)

    # The stored vertex as a `Vertex` at the end of the connection
    vertex: Vertex = field(kw_only=True)

    # Density of sampling the previous vertex of the light path from the stored vertex [1/sr]
    pdf_reverse: mi.Float = field(kw_only=True)


class CameraPathHistory(HistoryUpdates[PartialSums]):
    """Updates of the partial MIS sums of camera paths.

    Args:
        mis: The MIS weights.
        lens: The lens.
        direction: Directions of the camera rays.
    """

    def __init__(self, mis: BidirectionalMIS, lens: Lens, direction: mi.Vector3f) -> None:
        self.mis = mis
        self.lens = lens
        self.direction = direction

    def start(self) -> PartialSums:
        """Return the partial sums at the lens."""
        a = mi.Float(0)
        if self.mis.camera_connections and self.mis.exponent:
            a = dr.rcp(self.mis.power(self.lens.density(self.direction)))
        return PartialSums(a, mi.Float(0))

    def at_vertex(self, path: Path[PartialSums], vertex: Vertex, active: mi.Bool) -> PartialSums:
        """Update the partial sums for the segment that ends at a vertex."""
        return self.mis.at_vertex(path.history, path, vertex)

    def after_sample(self, path: Path, vertex: Vertex, bsdf_sample: BSDFSample) -> PartialSums:
        """Update the partial sums for the next segment."""
        if not self.mis.exponent:
            return path.history
        return self.mis.after_sample(path.history, vertex, bsdf_sample)


class StoredVertices:
    """Connections to the stored vertices of a light path.

    Args:
        light: The light path.
        weight: Emission weight of the light path.
        adjoint: Scattering of light paths.
        max_depth: Largest number of segments of a complete path.
    """

    def __init__(
        self, light: LightPath, weight: mi.UnpolarizedSpectrum, adjoint: Scattering, max_depth: int
    ) -> None:
        assert light.vertices is not None
        self.stored = light.vertices
        self.stored_count = light.count
        self.weight = weight
        self.adjoint = adjoint
        self.max_depth = max_depth

    def count(self, path: Path) -> mi.UInt32:
        """Return the number of stored vertices that `max_depth` allows to connect to."""
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
        """Connect a vertex of a camera path to the stored vertex with index k.

        Args:
            k: Index of the stored vertex.
            first: The connection of the same vertex to an emitter, which is not used here.
            vertex: The vertex of the camera path.
            path: The camera path.
            sampler: The sampler, which is not used here.
            active: Active lanes.
        """
        # --------------------- Read the stored vertex ---------------------

        active = active & (k < self.stored_count)
        record = self.stored.read(dr.select(active, k, 0), active)
        absent = dict.fromkeys(("medium", "rate", "velocity"))
        stored = StoredVertex(**absent | vars(record))

        # Lane memory that was never written contains invalid pointers. Replace them by null
        stored.si.shape = dr.select(active, stored.si.shape, dr.zeros(mi.ShapePtr))
        stored.si.instance = dr.select(active, stored.si.instance, dr.zeros(mi.ShapePtr))

        # --------------------- Connect to the stored vertex ---------------------

        to_vertex = stored.si.p - vertex.si.p
        d2 = dr.squared_norm(to_vertex)
        distance = dr.sqrt(d2)
        d = to_vertex / distance
        active = active & (d2 > 0) & (stored.depth + path.depth + 3 <= self.max_depth)

        # Evaluate the adjoint BSDF at the stored vertex
        there = stored.vertex(distance, active)
        bsdf_eval = self.adjoint.eval_pdf(there, -d, active)
        weight = apply_light_path(self.weight, stored.β, bsdf_eval.f) / d2
        weight = dr.select(active, weight, 0)

        # --------------------- Length of the rest of the path ---------------------

        # Optical path lengths are measured in units of the camera path's index of refraction
        η = stored.η * bsdf_eval.η
        length = distance + stored.opl / η
        rate = None
        if path.velocity is not None and stored.velocity is not None:
            assert stored.rate is not None
            rate = dr.dot(stored.velocity - path.velocity, d) + stored.rate / η
        return VertexConnection(
            point=stored.si.p,
            direction=d,
            weight=weight,
            length=length,
            active=active,
            pdf=bsdf_eval.pdf,
            rate=rate,
            stored=stored,
            vertex=there,
            pdf_reverse=bsdf_eval.pdf_reverse,
        )


class LightPaths(EmitterEndpoint):
    """Endpoint with emitters and stored vertices of a light path: all strategies with t > 1.

    Args:
        scene: The scene.
        sensor: The sensor.
        lens: The lens of the sensor.
        emission: Emission sampling.
        adjoint: Scattering of light paths.
        mis: The MIS weights.
        max_depth: Largest number of segments of a path.
        *options: The remaining arguments of `EmitterEndpoint`.
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
        self.lens = lens
        self.emission = emission
        self.mis = mis
        self.adjoint = adjoint
        self.max_depth = max_depth

    def for_paths(
        self, direction: mi.Vector3f, light: LightPath | None, weight: mi.UnpolarizedSpectrum | None
    ) -> LightPaths:
        """Return the endpoint for camera rays and their light paths.

        Args:
            direction: Directions of the camera rays.
            light: Light paths, None for endpoints without stored vertices.
            weight: Emission weights of the light paths.
        """
        other = copy(self)
        other.history = CameraPathHistory(self.mis, self.lens, direction)
        if light is not None:
            other.further = StoredVertices(light, weight, self.adjoint, self.max_depth)
        return other

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> EmitterConnection:
        """Sample an emitter, and compute the density of emission in the same direction."""
        ds, weight = self.sample_direction(vertex, sampler.next_2d(), active)
        ratio = mi.Float(0)
        if self.mis.exponent:
            ratio = self.emission.ratio(ds.emitter, ds, ds.pdf, ds.dist)
        connection = self.connection(vertex, ds, weight, active)
        return EmitterConnection(**vars(connection), emission_ratio=ratio)

    def hit_weight(self, path: Path[PartialSums], vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the MIS weight of strategy (0, t), which hits an emitter."""
        x = mi.Float(0)
        power = self.mis.power
        if self.mis.exponent:
            ds = mi.DirectionSample3f(self.scene, si=vertex.si, ref=path.prev)
            emitted = self.emission.density(path.prev, ds, hit.pdf, vertex.length)
            x = power(hit.pdf) * path.history.a + power(emitted) * path.history.b
        return self.mis.weight(x, 0, path.depth + 2)

    def mis_weight(
        self, path: Path, vertex: Vertex, connection: Connection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return the MIS weight of strategy (1, t), or of a connection to a stored vertex."""
        mis = self.mis
        x = mi.Float(0)
        cos = vertex.cosine(connection.direction)

        # --------------------- Strategy (1, t): connection to an emitter ---------------------

        if isinstance(connection, EmitterConnection):
            if mis.exponent:
                # Strategies that start at the emitter, and the strategy that hits it
                emitted = mis.power(cos / connection.emission_ratio)
                x = emitted * mis.sum(path.history, bsdf_eval.pdf_reverse)
                if mis.hits:
                    ratio = mis.power(bsdf_eval.pdf / connection.pdf)
                    x += dr.select(connection.delta, 0, ratio)
            return mis.weight(x, 1, path.depth + 2)

        # --------------------- Connection to a stored vertex ---------------------

        assert isinstance(connection, VertexConnection)
        stored = connection.stored
        if mis.exponent:
            # Densities by area of sampling each of the two vertices from the other
            d2 = dr.squared_norm(stored.si.p - vertex.si.p)
            from_here = bsdf_eval.pdf * connection.vertex.cosine(connection.direction) / d2
            from_there = connection.pdf * cos / d2

            # Strategies with fewer vertices on the light path and on the camera path
            light_sums = PartialSums(stored.a, stored.b)
            x = mis.power(from_here) * mis.sum(light_sums, connection.pdf_reverse)
            x += mis.power(from_there) * mis.sum(path.history, bsdf_eval.pdf_reverse)
        return mis.weight(x, stored.depth + 2, path.depth + 2)
