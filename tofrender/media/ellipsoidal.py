"""Next-event estimation in media for a time gate, by ellipsoidal connections."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Protocol

import drjit as dr
import mitsuba as mi

from ..paths.endpoints.emitters import EmitterEndpoint
from ..paths.endpoints.gated_emitters import GatedEmitters
from ..paths.protocols import LeaveVertex
from ..paths.records import Connection, Hit, Path, Vertex
from .participating import Media

# Shapes with emitter samples that do not depend on the reference point
FLAT = ("Rectangle", "Disk", "Mesh", "OBJMesh", "PLYMesh", "SerializedMesh")

# Smallest delay of light relative to the straight path
CLOSE = 1e-6

# If the ratio of a gate's largest and smallest remaining length is larger, half of the lengths are
# sampled in proportion to 1 / b
NEAR = 4.0

# Largest A - 1. Directions are nearly uniform there
EVEN = 100.0


class SampledGate(Protocol):
    """Interface of a gate that can be sampled."""

    opens: mi.Float  # Smallest path length with a weight [m]
    closes: mi.Float  # Largest path length with a weight [m]

    def __call__(self, opl: mi.Float) -> mi.Float:
        """Return the weight of a path length [1/m]."""

    def draw(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Sample a path length [m] and a weight with E[weight f(opl)] = integral of gate f."""


@dataclass
class Ellipsoid:
    """Ellipsoid of points y that connect a vertex x to an emitter point l with a fixed length."""

    # Random numbers of the emitter sample, which is repeated at the point y
    sample: mi.Point2f

    # Vector from x to l [m]
    to_light: mi.Vector3f

    # Distance D between x and l [m]
    distance: mi.Float

    # Geometric length b = |x - y| + |y - l| of the connection [m]
    length: mi.Float

    # Weight of the length, from sampling the gate
    weight: mi.Float

    # b - D cos θ for the direction of the ray [m]
    denominator: mi.Float

    # Distance |y - l| [m]
    last_length: mi.Float

    # Lanes with a point y
    active: mi.Bool


class EllipsoidalConnections:
    """Connections through points of media with light that arrives while a gate is open.

    Consider a vertex x, an emitter point l and a path that scatters once between them, at a point y
    of a medium. The gate determines the length b = |x - y| + |y - l|, which is sampled from its
    pulse. Therefore y is on an ellipsoid with the foci x and l. Each direction ω from x has exactly
    one such point,

        y = x + s ω,   s = (b² - D²) / (2 (b - D cos θ)),   D = |l - x|,   cos θ = ω·(l - x) / D.

    The integral over y has the differential ds dω / |l - y|². Sampling the length b instead of s
    divides by opl' = d opl / d s, which leaves

        1 / (opl' |l - y|²) dω = 2 / (η |b ω - (l - x)|²) dω.

    Directions are sampled in proportion to this expression, with
    cos θ = A - (A + 1) ((A - 1) / (A + 1))^ξ and A = (b² + D²) / (2 b D). Therefore no weight is
    large near the light. Rays from the camera, and rays after mirrors and glass, have a fixed
    direction.

    Ellipsoidal connections were introduced for surfaces by Pediredla et al. 2019. He et al. 2024
    use them in media, with diffusion instead of the two segments.

    Args:
        emitters: Emitter sampling.
        gate: The time gate.
        media: The media.
    """

    def __init__(self, emitters: EmitterEndpoint, gate: SampledGate, media: Media) -> None:
        self.emitters = emitters
        self.gate = gate
        self.media = media

    def connect(
        self,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
        leave: LeaveVertex | None = None,
    ) -> tuple[Path, Vertex, Connection]:
        """Sample an ellipsoid, and connect the point where a ray meets the ellipsoid.

        The ray is the path's ray, or a sampled ray from the path's last vertex.

        Returns:
            The path up to the point, the point as a vertex, and its connection to the emitter.
        """
        ellipsoid = self._ellipsoid(path, sampler, active)
        if leave is not None:
            ellipsoid, direction, pdf = self._sample_direction(ellipsoid, sampler)
            path = leave(direction, pdf, ellipsoid.active)
        return self._connect_ellipsoid(path, ellipsoid, sampler)

    def _ellipsoid(self, path: Path, sampler: mi.Sampler, active: mi.Bool) -> Ellipsoid:
        """Sample an emitter point, and the length of its connection to the path's last vertex."""
        # Sample a point on an emitter
        u = sampler.next_2d()
        ds, _ = self.emitters.scene.sample_emitter_direction(path.prev, u, False, active)
        to_light = ds.p - path.prev.p
        distance = dr.norm(to_light)

        # Sample the length. The vertex itself need not face the light
        opl, weight = self._length(path, distance, sampler)
        b = (opl - path.opl) / path.η
        active &= (b > (1 + CLOSE) * distance) & (distance > 0)

        # Intersect the path's ray with the ellipsoid
        denominator = b - dr.dot(to_light, path.ray.d)
        last_length = dr.squared_norm(b * path.ray.d - to_light) / (2 * denominator)
        return Ellipsoid(
            sample=u,
            to_light=to_light,
            distance=distance,
            length=b,
            weight=weight,
            denominator=denominator,
            last_length=last_length,
            active=active,
        )

    def _length(
        self, path: Path, distance: mi.Float, sampler: mi.Sampler
    ) -> tuple[mi.Float, mi.Float]:
        """Sample a path length that passes the gate, and return the length and its weight.

        If the remaining length is short near a light, half of the samples are drawn in proportion
        to 1 / b, like the light. Otherwise the variance would be infinite.
        """
        xi = sampler.next_1d()
        other = sampler.next_1d()

        # Sample the gate, or 1 / b between the smallest and the largest remaining length
        opens, closes = ((end - path.opl) / path.η for end in (self.gate.opens, self.gate.closes))
        least = dr.maximum(opens, distance)
        near = (least > 0) & (closes > NEAR * least)
        logarithm = dr.log(dr.select(near, closes / least, 2))
        opl, weight = self.gate.draw(xi)
        b = dr.select(
            near & (other < 0.5), least * dr.exp(xi * logarithm), (opl - path.opl) / path.η
        )

        # Combine both techniques by the balance heuristic
        found = dr.fma(path.η, b, path.opl)
        p = self.gate(found) * path.η
        q = dr.rcp(b * logarithm)
        q = dr.select((b >= least) & (b <= closes), q, 0)
        mixed = 2 * dr.select(other < 0.5, p, weight * p) / (p + q)
        return dr.select(near, found, opl), dr.select(near, mixed, weight)

    def _sample_direction(
        self, ellipsoid: Ellipsoid, sampler: mi.Sampler
    ) -> tuple[Ellipsoid, mi.Vector3f, mi.Float]:
        """Sample a direction in proportion to the geometric factor in the class's docstring.

        Returns:
            The ellipsoid with the new direction, the direction, and its density [1/sr].
        """
        xi = sampler.next_1d()
        φ = 2 * dr.pi * sampler.next_1d()
        b = ellipsoid.length
        d = ellipsoid.distance

        # Sample cos θ = A - difference, and φ
        a_minus_1 = dr.minimum(dr.square(b - d) / (2 * b * d), EVEN)
        logarithm = dr.log((2 + a_minus_1) / a_minus_1)
        difference = (2 + a_minus_1) * dr.exp(-xi * logarithm)
        pdf = dr.rcp(2 * dr.pi * difference * logarithm)
        cos = dr.clip(1 + a_minus_1 - difference, -1, 1)
        sin_φ, cos_φ = dr.sincos(φ)
        sin = dr.safe_sqrt(1 - cos * cos)
        local = mi.Vector3f(sin * cos_φ, sin * sin_φ, cos)
        axis = dr.select(ellipsoid.active, ellipsoid.to_light / d, mi.Vector3f(0, 0, 1))

        # Compute lengths from A - cos θ, because b - D cos θ would lose all digits by cancellation
        # if the light is straight ahead
        difference = dr.select(a_minus_1 < EVEN, difference, (b * b + d * d) / (2 * b * d) - cos)
        denominator = d * difference + (b - d) * (b + d) / (2 * b)
        last_length = b * d * difference / denominator
        ellipsoid = replace(ellipsoid, denominator=denominator, last_length=last_length)
        return ellipsoid, mi.Frame3f(axis).to_world(local), pdf

    def _connect_ellipsoid(
        self, path: Path, ellipsoid: Ellipsoid, sampler: mi.Sampler
    ) -> tuple[Path, Vertex, Connection]:
        """Connect the point y where the path's ray meets the ellipsoid to the emitter.

        Returns:
            The path up to y, the vertex y, and the connection from y to the emitter.
        """
        # Find the point y in a medium
        b = ellipsoid.length
        d = ellipsoid.distance
        s = (b - d) * (b + d) / (2 * ellipsoid.denominator)
        active = ellipsoid.active & (s > 0) & (s < b)
        ahead, vertex = self.media.scattering_point(path, dr.select(active, s, 0), sampler, active)

        # Connect y to the same emitter point
        connection = self.emitters.sample_emitter(vertex, ellipsoid.sample, vertex.valid)
        gate = self.gate(dr.fma(path.η, connection.length, ahead.opl))
        connection.active &= gate > 0

        # Divide by opl' |l - y|². The emitter sample contains 1 / |l - y|² with its own rounding
        # error, which cancels here
        rounded = dr.square(connection.length) / (ellipsoid.last_length * ellipsoid.denominator)
        connection.weight *= dr.select(
            connection.active, ellipsoid.weight * rounded / (path.η * gate), 0
        )
        return ahead, vertex, connection


class GatedFog(GatedEmitters):
    """Gated next-event estimation in scenes with media.

    Surfaces connect as in `GatedEmitters`. In media, points along rays connect to the emitters (see
    `EllipsoidalConnections`), instead of the points where the path scatters.

    Args:
        media: The media.
        scene: The scene.
        sensor: The sensor, or None.
        gate: The time gate.
        *options: The remaining arguments of `GatedEmitters`.
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
        # Use a copy, because a reference cycle would keep the scene until garbage collection
        self.in_media = EllipsoidalConnections(copy(self), gate, media)

    @staticmethod
    def serves(scene: mi.Scene) -> bool:
        """Return whether all emitters are points, or shapes that are sampled by area."""
        return all(map(_is_fixed, scene.emitters()))

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample a connection from a surface; points of media do not connect by themselves."""
        return self.resample(vertex, path, sampler, active & ~vertex.medium_point.here)

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the MIS weight; 0 after a point of a medium, where connections find the light."""
        scattered = (path.depth > 0) & dr.all(path.prev.n == 0)
        return dr.select(scattered, 0, super().hit_weight(path, vertex, hit))


def _is_fixed(emitter: mi.Emitter) -> bool:
    """Return whether the samples of an emitter do not depend on the reference point."""
    flags = emitter.flags()
    if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
        return True
    shape = emitter.get_shape()
    return shape is not None and (shape.is_mesh() or shape.class_name() in FLAT)
