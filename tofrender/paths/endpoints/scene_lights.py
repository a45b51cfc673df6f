# pyright: reportArgumentType=false
"""The emitters of a scene, by connections and by hits."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..records import Bounce, Connection, Hit, Path, Turn, Vertex
from ..surfaces import LampNormals, stretched
from .light_points import LightPoints, checked_count, points_that_pay
from .unseen import Unseen
from .wavefronts import Wavefronts

MANY_EMITTERS = 8
"""Number of emitters from which on a single box bounds their distance."""


class SceneLights(Unseen):
    """All emitters of a scene, by next-event estimation and by hits.

    Args:
        scene: The scene.
        sensor: The sensor, whose position the sphere contains where distant lights start, or None.
        hide_emitters: Whether the sensor looks through area lights, and does not see what is
            infinitely far away, as in Mitsuba.
        discard_direct_light: Whether light does not count that comes straight from an emitter.
        light_samples: Points on emitters that the first vertex of a path connects to; all further
            ones connect to half as many, rounded up. "auto" is 1 until `resolving` knows better.
    """

    finds_all = False

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        hide_emitters: bool = False,
        discard_direct_light: bool = False,
        light_samples: str | int = 1,
    ) -> None:
        super().__init__(scene, hide_emitters)
        checks.instance("sensor", sensor, mi.Sensor | None, "a sensor or None")
        self.discard_direct_light = checks.boolean("discard_direct_light", discard_direct_light)
        self.light_samples = checked_count(light_samples)
        self.normals = LampNormals(scene)
        self.points = LightPoints(1 if isinstance(light_samples, str) else light_samples)
        infinite = mi.EmitterFlags.Infinite
        self.has_distant = any(mi.has_flag(e.flags(), infinite) for e in scene.emitters())
        self.meshes: list[mi.Shape] = []
        self.boxes = self._boxes()
        self.sphere: Any = Wavefronts.around(scene, sensor) if self.has_distant else None

    def resolving(self, width_opl: float) -> SceneLights:
        """The same with as many points as pay at this width, if that is left to them."""
        if self.light_samples != "auto":
            return self
        other = copy(self)
        other.points = LightPoints(points_that_pay(self.scene, width_opl, self.sphere))
        return other

    def attached(self) -> SceneLights:
        """The same with one point for each vertex, whose place on the emitter stays as it is."""
        other = copy(self)
        other.points = LightPoints(1)
        other.meshes = [s for s in self.scene.shapes() if s.is_emitter() and _is_mesh(s)]
        return other

    def _boxes(self) -> list[tuple[mi.Point3f, mi.Point3f]]:
        """Corners of boxes that hold all emitters; one box around everything if there are many."""
        boxes = [mi.ScalarBoundingBox3f(e.bbox()) for e in self.scene.emitters()]
        if self.has_distant or not all(box.valid() for box in boxes):  # A projector has none
            return [(mi.Point3f(-dr.inf), mi.Point3f(dr.inf))]
        if len(boxes) > MANY_EMITTERS:
            whole = boxes[0]
            for box in boxes[1:]:
                whole.expand(box)
            boxes = [whole]
        corners = [(mi.Point3f(box.min), mi.Point3f(box.max)) for box in boxes]
        dr.make_opaque(corners)
        return corners

    def in_view(self) -> Sequence[mi.Emitter]:
        """Area lights, unless the sensor shall not see them."""
        if self.hide_emitters or self.discard_direct_light:
            return ()
        surface = mi.EmitterFlags.Surface
        return [each for each in self.scene.emitters() if mi.has_flag(each.flags(), surface)]

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """A point on an emitter; if more are to come, the first of a lattice."""
        shift = sampler.next_2d()
        link = self.choose(vertex, shift, active)
        if self.points.several:
            link.rival = shift
        return link

    def more_links(self, path: Path, first: Connection) -> Any:
        """The rest of the lattice, if it has several points."""
        return self.points.count(path.depth) - 1 if self.points.several else None

    def link(
        self,
        k: mi.UInt32,
        first: Connection,
        vertex: Vertex,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Point number k + 1 of the lattice that the first connection started."""
        return self.choose(vertex, self.points.point(k + 1, path.depth, first.rival), active)

    def choose(self, vertex: Vertex, sample: mi.Point2f, active: mi.Bool) -> Connection:
        """The point on an emitter that two random numbers stand for."""
        ds, weight = self.normals.sample_direction(vertex.si, sample, active)
        if self.meshes:
            shining = active & (ds.pdf != 0)
            stretch: Any = stretched(self.scene, self.meshes, vertex.si, ds.p, shining)
            weight = mi.unpolarized_spectrum(weight) * stretch
        return self.linked(vertex, ds, weight, active)

    def linked(self, vertex: Vertex, ds: Any, weight: Any, active: mi.Bool) -> Connection:
        """The connection of a vertex to a sample of an emitter."""
        p = vertex.si.p
        length = dr.norm(ds.p - p)
        if self.has_distant:
            distant = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
            length = dr.select(distant, self.sphere.length(p, ds.d), length)
        return Connection(
            point=ds.p,
            direction=ds.d,
            weight=mi.unpolarized_spectrum(weight),
            pdf=ds.pdf,
            delta=ds.delta,
            length=length,
            active=active & (ds.pdf != 0),
            clear=mi.Bool(False),
        )

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """Radiance of the emitter at the vertex, or behind the scene, towards the last one."""
        si, prev, active = vertex.si, path.prev, path.active
        ds = mi.DirectionSample3f(self.scene, si=si, ref=prev)
        radiance = mi.unpolarized_spectrum(ds.emitter.eval(si, active))
        if self.normals.exist:
            ds.n = si.n
        pdf = self.scene.pdf_emitter_direction(prev, ds, active)
        length = vertex.length
        if self.has_distant:
            length = dr.select(vertex.valid, length, self.sphere.length(prev.p, path.ray.d))
        if self.hide_emitters:
            active &= (path.depth > 0) | vertex.valid
        if self.discard_direct_light:
            active &= path.depth > 0
        return Hit(radiance, pdf, length, active)

    def share_of_hit(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """What connections leave, by the power heuristic; all after a mirror."""
        pdf = hit.pdf
        if self.points.several:
            pdf = pdf * mi.Float(self.points.count(path.depth - 1))
        share = mi.Float(0) if self.finds_all else power_heuristic(path.pdf, pdf)
        return dr.select(path.specular, mi.Float(1), share)

    def share_of_link(self, path: Path, vertex: Vertex, link: Connection, turn: Turn) -> mi.Float:
        """What hits leave, by the power heuristic; all of what cannot be hit.

        Of n points, each has an n-th of that, for n times its density (Veach 1997, 9.2.2). The
        density is the point's own, whatever is in the way: hits know of no shadow either.
        """
        n = mi.Float(self.points.count(path.depth)) if self.points.several else mi.Float(1)
        if self.finds_all:
            return dr.rcp(n)
        return dr.select(link.delta, 1, power_heuristic(n * link.pdf, turn.pdf)) / n

    def nearest(self, p: mi.Point3f) -> mi.Float:
        """Least length of any connection from `p` [m]: distance to the closest emitter's box."""
        closest = mi.Float(dr.inf)
        for low, high in self.boxes:
            outside = dr.maximum(dr.maximum(low - p, p - high), 0)
            closest = dr.minimum(closest, dr.norm(outside))
        return closest


def _is_mesh(shape: mi.Shape) -> bool:
    """Whether a shape is a mesh whose density of points has no derivative in Mitsuba."""
    return shape.is_mesh() and shape.class_name() != "Rectangle"


def power_heuristic(pdf_a: mi.Float, pdf_b: mi.Float) -> mi.Float:
    """Share a^2 / (a^2 + b^2) of a sample from the first density (Veach 1997, 9.13)."""
    a2 = pdf_a * pdf_a
    return dr.select(pdf_a > 0, a2 / dr.fma(pdf_b, pdf_b, a2), 0)


class LightsStraightAhead(SceneLights):
    """All emitters of a scene, also behind surfaces that let light straight through.

    For paths whose `Limits` are `straight`. Their memory is the vertex that they were turned at:
    from there, connections go through such surfaces, too.
    """

    def memory(self) -> Any:
        """Return None: there is no vertex before the first."""
        return dr.zeros(mi.Interaction3f)

    def leave(self, path: Path, vertex: Vertex, bounce: Bounce) -> Any:
        """The vertex, unless the path goes straight on."""
        return dr.select(bounce.straight, path.memory, mi.Interaction3f(vertex.si))

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """As in `SceneLights`, but with the density of a connection from the last turn."""
        hit = super().hit(vertex, path)
        ds = mi.DirectionSample3f(self.scene, si=vertex.si, ref=path.memory)
        pdf = self.scene.pdf_emitter_direction(path.memory, ds, path.active)
        return replace(hit, pdf=pdf)


class EmitterHits(SceneLights):
    """Emitters by hits alone, without next-event estimation.

    The algorithm of a first transient path tracer: noisier than `SceneLights` by far with small
    lights, equal in expectation, and blind to point lights.
    """

    connects = False

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """As in `SceneLights`; nothing competes with the hit, so the density is 0."""
        hit = super().hit(vertex, path)
        hit.pdf = mi.Float(0)
        return hit


class ConnectionsOnly(SceneLights):
    """All emitters of a scene, by next-event estimation alone.

    Weak where a glossy surface reflects a large light: connections rarely fall into its lobe.
    Mirrors and glass, which no connection can serve, still see what they reflect.
    """

    finds_all = True
