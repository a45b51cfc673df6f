# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportReturnType=false
"""The light strategy of a gate in fog: points along rays whose light comes while it is open."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ..records import Connection, Hit, Path, Vertex
from .gated import GatedLights

FLAT = ("Rectangle", "Disk", "Mesh", "OBJMesh", "PLYMesh", "SerializedMesh")
"""Shapes whose light points do not depend on who asks for them."""

CLOSE = 1e-6
"""Part of the way to the light that light must be later than on the straight way."""

NEAR = 4.0
"""Ratio of what a gate leaves at most and at least from which on the latter counts as little."""

EVEN = 100.0
"""Largest A - 1; directions are nearly even there."""


class DrawnGate(Protocol):
    """A gate that can be sampled.

    Attributes:
        opens, closes: Shortest and greatest length that it sees [m].
    """

    def __call__(self, opl: mi.Float) -> mi.Float:
        """Its weight [1/m]."""
        ...

    opens: mi.Float
    closes: mi.Float

    def draw(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """A path length [m], and what it stands for: E[weight f(opl)] = integral of gate f."""
        ...


@dataclass
class Wait:
    """How long light may still take from a vertex on, and to where.

    Attributes:
        sample: The random numbers that stand for the light point.
        to_light: From the vertex to it [m].
        distance: Length of that [m].
        left: Geometric length that is left for the way by a point of a medium [m].
        weight: Weight of that length, as the gate has drawn it.
        saved: `left` less the way that the ray makes towards the light, b - D cos θ [m].
        last: Length from the point y to the light [m].
        active: Lanes in which light can take that long.
    """

    sample: mi.Point2f
    to_light: mi.Vector3f
    distance: mi.Float
    left: mi.Float
    weight: mi.Float
    saved: mi.Float
    last: mi.Float
    active: mi.Bool


class GatedFog(GatedLights):
    """Connections by way of points of media that light reaches when the gate is open.

    From a vertex x, light that is scattered once more before it comes from l has its last vertex y
    on an ellipsoid with the foci x and l: |x - y| + |y - l| = b, where b is the length that the
    gate leaves, drawn from its pulse. In a direction ω there is one such y,

        y = x + s ω,   s = (b² - D²) / (2 (b - D cos θ)),   D = |l - x|,   cos θ = ω·(l - x) / D,

    and of the integral over its place, ds dω / |l - y|², with opl' = d opl / d s for the length
    drawn, 1 / (opl' |l - y|²) dω = 2 / (η |b ω - (l - x)|²) dω is left. Directions are drawn in
    proportion to that, cos θ = A - (A + 1) ((A - 1) / (A + 1))^ξ with A = (b² + D²) / (2 b D); so
    nothing is large near the light. Camera rays, and those behind mirrors and glass, have their
    direction. (Ellipsoidal connections: Pediredla et al. 2019, of surfaces; He et al. 2024, of
    media, with diffusion in the place of the two legs.) Surfaces connect as with `GatedLights`, and
    points of media not at all where paths scatter.

    Args:
        scene: The scene; `serves` says whether its emitters fit.
        sensor, gate, hide_emitters, discard_direct_light: As in `GatedLights`.
    """

    looks_ahead = True
    gate: DrawnGate

    @staticmethod
    def serves(scene: mi.Scene) -> bool:
        """Whether all emitters are points, or surfaces whose points do not depend on the vertex."""
        return all(map(_is_fixed, scene.emitters()))

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """A connection from a surface."""
        return super().connect(vertex, path, sampler, active & ~vertex.inside.here)

    def wait(self, path: Path, sampler: mi.Sampler, active: mi.Bool) -> Wait:
        """A point on a light, and how long its light may take to the path's last vertex."""
        u = sampler.next_2d()
        ds, _ = self.scene.sample_emitter_direction(path.prev, u, False, active)
        to_light = ds.p - path.prev.p
        distance = dr.norm(to_light)
        opl, weight = self._length(path, distance, sampler)
        left = (opl - path.opl) / path.η
        active &= (left > (1 + CLOSE) * distance) & (distance > 0)  # Even if it turns its back
        saved = left - dr.dot(to_light, path.ray.d)
        last = dr.squared_norm(left * path.ray.d - to_light) / (2 * saved)
        return Wait(u, to_light, distance, left, weight, saved, last, active)

    def _length(
        self, path: Path, distance: mi.Float, sampler: mi.Sampler
    ) -> tuple[mi.Float, mi.Float]:
        """A length that the gate sees, and its weight.

        Near a light, where the gate leaves little, half of them are drawn in proportion to 1 / b:
        what light brings is, too, and the variance would not be finite.
        """
        xi, other = sampler.next_1d(), sampler.next_1d()
        opens, closes = ((end - path.opl) / path.η for end in (self.gate.opens, self.gate.closes))
        least = dr.maximum(opens, distance)
        near = (least > 0) & (closes > NEAR * least)
        logarithm = dr.log(dr.select(near, closes / least, 2))
        opl, weight = self.gate.draw(xi)
        b = dr.select(
            near & (other < 0.5), least * dr.exp(xi * logarithm), (opl - path.opl) / path.η
        )
        found = dr.fma(path.η, b, path.opl)
        p, q = self.gate(found) * path.η, dr.rcp(b * logarithm)
        q = dr.select((b >= least) & (b <= closes), q, 0)
        shared = 2 * dr.select(other < 0.5, p, weight * p) / (p + q)
        return dr.select(near, found, opl), dr.select(near, shared, weight)

    def towards(self, wait: Wait, sampler: mi.Sampler) -> tuple[Wait, mi.Vector3f, mi.Float]:
        """The wait in a direction in which points are near enough to the light, and its density."""
        xi, turn = sampler.next_1d(), 2 * dr.pi * sampler.next_1d()
        b, d = wait.left, wait.distance
        more = dr.minimum(dr.square(b - d) / (2 * b * d), EVEN)  # A - 1
        logarithm = dr.log((2 + more) / more)
        off = (2 + more) * dr.exp(-xi * logarithm)  # A - cos θ
        pdf = dr.rcp(2 * dr.pi * off * logarithm)
        cos = dr.clip(1 + more - off, -1, 1)
        sin_turn, cos_turn = dr.sincos(turn)
        sin = dr.safe_sqrt(1 - cos * cos)
        local = mi.Vector3f(sin * cos_turn, sin * sin_turn, cos)
        axis = dr.select(wait.active, wait.to_light / d, mi.Vector3f(0, 0, 1))
        wait = copy(wait)
        # Differences of lengths would have no digits left where the light is straight ahead
        off = dr.select(more < EVEN, off, (b * b + d * d) / (2 * b * d) - cos)
        wait.saved = d * off + (b - d) * (b + d) / (2 * b)
        wait.last = b * d * off / wait.saved
        return wait, mi.Frame3f(axis).to_world(local), pdf

    def ahead(
        self, path: Path, wait: Wait, space: Any, sampler: mi.Sampler
    ) -> tuple[Path, Vertex, Connection]:
        """The point of the path's ray whose light comes when the gate is open."""
        b, d = wait.left, wait.distance
        s = (b - d) * (b + d) / (2 * wait.saved)
        active = wait.active & (s > 0) & (s < b)
        ahead, vertex = space.ahead(path, dr.select(active, s, 0), sampler, active)
        link = self.choose(vertex, wait.sample, vertex.valid)
        gate = self.gate(dr.fma(path.η, link.length, ahead.opl))
        link.active &= gate > 0
        # The emitter's weight has the rounded 1 / |l - y|² in it
        rounded = dr.square(link.length) / (wait.last * wait.saved)
        link.weight *= dr.select(link.active, wait.weight * rounded / (path.η * gate), 0)
        return ahead, vertex, link

    def share_of_hit(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """What connections leave; nothing after a point of a medium, where those have all."""
        scattered = (path.depth > 0) & dr.all(path.prev.n == 0)
        return dr.select(scattered, 0, super().share_of_hit(path, vertex, hit))


def _is_fixed(emitter: Any) -> bool:
    flags = emitter.flags()
    if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
        return True
    shape = emitter.get_shape()
    return shape is not None and (shape.is_mesh() or shape.class_name() in FLAT)
