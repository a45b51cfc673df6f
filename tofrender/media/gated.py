"""Next-event estimation for a time gate, of points of media along rays."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Protocol

import drjit as dr
import mitsuba as mi

from ..paths.endpoints.emitters import EmitterEndpoint
from ..paths.endpoints.gated import GatedEmitters
from ..paths.records import Connection, Hit, Path, Vertex
from .space import Media

# Shapes whose emitter samples do not depend on the reference point
FLAT = ("Rectangle", "Disk", "Mesh", "OBJMesh", "PLYMesh", "SerializedMesh")
CLOSE = 1e-6  # least relative delay of light against the straight path
NEAR = 4.0  # ratio of a gate's greatest and least remaining length from which on half follow 1 / b
EVEN = 100.0  # largest A - 1; directions are nearly uniform there


class SampledGate(Protocol):
    """A gate that can be sampled."""

    opens: mi.Float  # shortest length that it sees [m]
    closes: mi.Float  # greatest one [m]

    def __call__(self, opl: mi.Float) -> mi.Float:
        """Return the weight of a path length [1/m]."""

    def draw(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Sample a path length [m] and its weight: E[weight f(opl)] = integral of gate f."""


@dataclass
class Ellipsoid:
    """Ellipsoid of points that connect a vertex x to an emitter point l with a given length."""

    sample: mi.Point2f  # the random numbers of the emitter sample
    to_light: mi.Vector3f  # vector D from x to l [m]
    distance: mi.Float  # its length D [m]
    length: mi.Float  # geometric length b of the connection by way of a point of the medium [m]
    weight: mi.Float  # weight of that length, as the gate has sampled it
    denominator: mi.Float  # b - D cos θ of the ray's direction [m]
    last_length: mi.Float  # distance |y - l| from the point of the medium to the light [m]
    active: mi.Bool  # lanes in which there is such a point


class EllipsoidalConnections:
    """Connections by way of points of media whose light arrives while a gate is open.

    From a vertex x, light that is scattered once more before it comes from l has its last vertex y
    on an ellipsoid with the foci x and l: |x - y| + |y - l| = b, where b is the length that the
    gate allows, sampled from its pulse. In a direction ω there is one such y,

        y = x + s ω,   s = (b² - D²) / (2 (b - D cos θ)),   D = |l - x|,   cos θ = ω·(l - x) / D,

    and of the integral over y, ds dω / |l - y|², with opl' = d opl / d s for the length
    sampled, 1 / (opl' |l - y|²) dω = 2 / (η |b ω - (l - x)|²) dω remains. Directions are sampled in
    proportion to that, cos θ = A - (A + 1) ((A - 1) / (A + 1))^ξ with A = (b² + D²) / (2 b D); so
    nothing is large near the light. Camera rays, and those behind mirrors and glass, have their
    direction. (Ellipsoidal connections: Pediredla et al. 2019, of surfaces; He et al. 2024, of
    media, with diffusion instead of the two legs.)
    """

    def __init__(self, emitters: EmitterEndpoint, gate: SampledGate, media: Media) -> None:
        self.emitters, self.gate, self.media = emitters, gate, media

    def prepare(self, path: Path, sampler: mi.Sampler, active: mi.Bool) -> Ellipsoid:
        """Sample an emitter point, and the length of its connection to the path's last vertex."""
        u = sampler.next_2d()
        ds, _ = self.emitters.scene.sample_emitter_direction(path.prev, u, False, active)
        to_light = ds.p - path.prev.p
        distance = dr.norm(to_light)
        opl, weight = self._length(path, distance, sampler)
        b = (opl - path.opl) / path.η
        active &= (b > (1 + CLOSE) * distance) & (distance > 0)  # Even if the light faces away
        denominator = b - dr.dot(to_light, path.ray.d)
        last = dr.squared_norm(b * path.ray.d - to_light) / (2 * denominator)
        return Ellipsoid(u, to_light, distance, b, weight, denominator, last, active)

    def _length(
        self, path: Path, distance: mi.Float, sampler: mi.Sampler
    ) -> tuple[mi.Float, mi.Float]:
        """Sample a path length that the gate sees; returns it and its weight.

        Near a light, where the gate leaves little, half of them are sampled in proportion to 1 / b,
        as the light is; the variance would not be finite otherwise.
        """
        xi, other = sampler.next_1d(), sampler.next_1d()

        # Candidate by the gate, and by 1 / b between the least and the greatest length left
        opens, closes = ((end - path.opl) / path.η for end in (self.gate.opens, self.gate.closes))
        least = dr.maximum(opens, distance)
        near = (least > 0) & (closes > NEAR * least)
        logarithm = dr.log(dr.select(near, closes / least, 2))
        opl, weight = self.gate.draw(xi)
        b = dr.select(
            near & (other < 0.5), least * dr.exp(xi * logarithm), (opl - path.opl) / path.η
        )

        # Balance heuristic of both
        found = dr.fma(path.η, b, path.opl)
        p, q = self.gate(found) * path.η, dr.rcp(b * logarithm)
        q = dr.select((b >= least) & (b <= closes), q, 0)
        mixed = 2 * dr.select(other < 0.5, p, weight * p) / (p + q)
        return dr.select(near, found, opl), dr.select(near, mixed, weight)

    def sample_direction(
        self, target: Ellipsoid, sampler: mi.Sampler
    ) -> tuple[Ellipsoid, mi.Vector3f, mi.Float]:
        """Sample a direction in proportion to the connection's geometry; see the class."""
        xi, φ = sampler.next_1d(), 2 * dr.pi * sampler.next_1d()
        b, d = target.length, target.distance

        # Sample cos θ = A - off, and φ
        more = dr.minimum(dr.square(b - d) / (2 * b * d), EVEN)  # A - 1
        logarithm = dr.log((2 + more) / more)
        off = (2 + more) * dr.exp(-xi * logarithm)  # A - cos θ
        pdf = dr.rcp(2 * dr.pi * off * logarithm)
        cos = dr.clip(1 + more - off, -1, 1)
        sin_φ, cos_φ = dr.sincos(φ)
        sin = dr.safe_sqrt(1 - cos * cos)
        local = mi.Vector3f(sin * cos_φ, sin * sin_φ, cos)
        axis = dr.select(target.active, target.to_light / d, mi.Vector3f(0, 0, 1))

        # Differences of lengths would have no digits left where the light is straight ahead
        off = dr.select(more < EVEN, off, (b * b + d * d) / (2 * b * d) - cos)
        denominator = d * off + (b - d) * (b + d) / (2 * b)
        target = replace(target, denominator=denominator, last_length=b * d * off / denominator)
        return target, mi.Frame3f(axis).to_world(local), pdf

    def connect(
        self, path: Path, target: Ellipsoid, sampler: mi.Sampler
    ) -> tuple[Path, Vertex, Connection]:
        """Connect the point of the path's ray that is on the ellipsoid."""
        b, d = target.length, target.distance
        s = (b - d) * (b + d) / (2 * target.denominator)
        active = target.active & (s > 0) & (s < b)
        ahead, vertex = self.media.scattering_point(path, dr.select(active, s, 0), sampler, active)
        connection = self.emitters.sample_emitter(vertex, target.sample, vertex.valid)
        gate = self.gate(dr.fma(path.η, connection.length, ahead.opl))
        connection.active &= gate > 0
        # The emitter sample's weight contains 1 / |l - y|² as rounded there
        rounded = dr.square(connection.length) / (target.last_length * target.denominator)
        connection.weight *= dr.select(
            connection.active, target.weight * rounded / (path.η * gate), 0
        )
        return ahead, vertex, connection


class GatedFog(GatedEmitters):
    """Gated next-event estimation in media: see `GatedEmitters` and `EllipsoidalConnections`.

    Surfaces connect as with `GatedLights`, and points of media along rays, instead of where paths
    scatter. Arguments as for `GatedEmitters`.
    """

    def __init__(
        self,
        media: Media,
        scene: mi.Scene,
        sensor: mi.Sensor | None,
        gate: SampledGate,
        *options: bool,
    ) -> None:
        super().__init__(scene, sensor, gate, *options)
        # a copy, since a cycle would keep the scene until garbage collection
        self.in_media = EllipsoidalConnections(copy(self), gate, media)

    @staticmethod
    def serves(scene: mi.Scene) -> bool:
        """Whether all emitters are points, or surfaces whose points do not depend on the vertex."""
        return all(map(_is_fixed, scene.emitters()))

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample a connection from a surface."""
        return self.resample(vertex, path, sampler, active & ~vertex.medium_point.here)

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the MIS weight; 0 after a point of a medium, whose light connections have."""
        scattered = (path.depth > 0) & dr.all(path.prev.n == 0)
        return dr.select(scattered, 0, super().hit_weight(path, vertex, hit))


def _is_fixed(emitter: mi.Emitter) -> bool:
    flags = emitter.flags()
    if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
        return True
    shape = emitter.get_shape()
    return shape is not None and (shape.is_mesh() or shape.class_name() in FLAT)
