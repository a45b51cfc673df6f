"""The emitters of a scene: samples of them, and their radiance where rays hit them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Any, Self

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..protocols import Endpoint
from ..records import Connection, Hit, Path, Vertex
from ..surfaces import LampNormals, stretched
from .wavefronts import Wavefronts

MANY_EMITTERS = 8
"""Number of emitters above which a single bounding box bounds their distance."""


class SceneEmitters:
    """The emitters of a scene, as the sensor sees them.

    Args:
        scene: The scene.
        sensor: The sensor, which the bounding sphere of distant emitters contains, or None.
        hide_emitters: Whether the sensor looks through area lights and sees no environment.
        discard_direct_light: Whether light that comes straight from an emitter does not count.

    Attributes:
        sphere: Where distant light starts, None if there are no distant emitters.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        hide_emitters: bool = False,
        discard_direct_light: bool = False,
    ) -> None:
        checks.instance("scene", scene, mi.Scene, "a loaded scene")
        checks.instance("sensor", sensor, mi.Sensor | None, "a sensor or None")
        self.scene = scene
        self.hide_emitters = checks.boolean("hide_emitters", hide_emitters)
        self.discard_direct_light = checks.boolean("discard_direct_light", discard_direct_light)
        self.normals = LampNormals(scene)
        self.moving_meshes: list[mi.Shape] = []
        self.has_distant = any(
            mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite) for emitter in scene.emitters()
        )
        self.sphere: Any = Wavefronts.around(scene, sensor) if self.has_distant else None
        self._boxes = self._bounding_boxes()

    def attached(self) -> SceneEmitters:
        """Return the emitters with derivatives: sampled points move with their meshes."""
        other = copy(self)
        other.moving_meshes = [
            shape
            for shape in self.scene.shapes()
            # Mitsuba's rectangles do have a derivative of their density
            if shape.is_emitter() and shape.is_mesh() and shape.class_name() != "Rectangle"
        ]
        return other

    def _bounding_boxes(self) -> list[tuple[mi.Point3f, mi.Point3f]]:
        """Corners of boxes that hold all emitters; one box for all if there are many."""
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

    def min_distance(self, p: mi.Point3f) -> mi.Float:
        """Distance from points to the closest emitter's bounding box [m]."""
        closest = mi.Float(dr.inf)
        for low, high in self._boxes:
            outside = dr.maximum(dr.maximum(low - p, p - high), 0)
            closest = dr.minimum(closest, dr.norm(outside))
        return closest

    def visible(self) -> Sequence[mi.Emitter]:
        """Area lights, unless the sensor does not see them."""
        if self.hide_emitters or self.discard_direct_light:
            return ()
        surface = mi.EmitterFlags.Surface
        return [each for each in self.scene.emitters() if mi.has_flag(each.flags(), surface)]

    def sample_direction(
        self, vertex: Vertex, u: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction to an emitter; returns it, and radiance over density."""
        ds, weight = self.normals.sample_direction(vertex.si, u, active)
        if self.moving_meshes:
            lit = active & (ds.pdf != 0)
            stretch: Any = stretched(self.scene, self.moving_meshes, vertex.si, ds.p, lit)
            weight = mi.unpolarized_spectrum(weight) * stretch
        return ds, weight

    def connection(
        self, vertex: Vertex, ds: mi.DirectionSample3f, weight: mi.Spectrum, active: mi.Bool
    ) -> Connection:
        """Return the connection of a vertex to an emitter sample."""
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
            unoccluded=mi.Bool(False),
        )

    def sample(self, vertex: Vertex, u: mi.Point2f, active: mi.Bool) -> Connection:
        """Sample a connection to an emitter by two random numbers."""
        return self.connection(vertex, *self.sample_direction(vertex, u, active), active)

    def hit(self, vertex: Vertex, path: Path, reference: mi.Interaction3f | None = None) -> Hit:
        """Return the radiance of the emitter at a vertex, or at infinity, of MIS weight 1.

        Args:
            vertex: The vertex.
            path: The path that leads there.
            reference: Where a connection to it would start, by default at `path.prev`.
        """
        si, prev, active = vertex.si, path.prev, path.active
        ds = mi.DirectionSample3f(self.scene, si=si, ref=prev)
        radiance = mi.unpolarized_spectrum(ds.emitter.eval(si, active))
        if reference is None:
            reference = prev
        else:
            ds = mi.DirectionSample3f(self.scene, si=si, ref=reference)
        if self.normals.exist:
            ds.n = si.n
        pdf = self.scene.pdf_emitter_direction(reference, ds, active)
        length = vertex.length
        if self.has_distant:
            length = dr.select(vertex.valid, length, self.sphere.length(prev.p, path.ray.d))
        if self.hide_emitters:
            active &= (path.depth > 0) | vertex.valid
        if self.discard_direct_light:
            active &= path.depth > 0
        return Hit(radiance, pdf, length, active, mis_weight=mi.Float(1))


class EmitterEndpoint(Endpoint):
    """Abstract base of the techniques that sample a scene's emitters.

    Args:
        scene, sensor, hide_emitters, discard_direct_light: As for `SceneEmitters`.
    """

    finds_all = False

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        hide_emitters: bool = False,
        discard_direct_light: bool = False,
    ) -> None:
        self.emitters = SceneEmitters(scene, sensor, hide_emitters, discard_direct_light)
        self.hide_emitters = hide_emitters

    @abstractmethod
    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the MIS weight of a hit."""

    def connection_reference(self, path: Path) -> mi.Interaction3f | None:
        """Return where a connection to what the ray hits would start, None for `path.prev`."""
        return None

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """Return radiance of the emitter that is hit, with its MIS weight."""
        hit = self.emitters.hit(vertex, path, self.connection_reference(path))
        hit.mis_weight = self.hit_weight(path, vertex, hit)
        return hit

    def min_distance(self, p: mi.Point3f) -> mi.Float:
        """Return the distance to the closest emitter's bounding box [m]."""
        return self.emitters.min_distance(p)

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """Return area lights, unless the sensor does not see them."""
        return self.emitters.visible()

    def attached(self) -> Self:
        """Return the endpoint with derivatives, and one emitter sample per vertex."""
        other = copy(self)
        other.emitters, other.further = self.emitters.attached(), None
        return other


def power_heuristic(pdf_a: mi.Float, pdf_b: mi.Float) -> mi.Float:
    """MIS weight a² / (a² + b²) of a sample from the first density (Veach 1997, eq. 9.13)."""
    a2 = pdf_a * pdf_a
    return dr.select(pdf_a > 0, a2 / dr.fma(pdf_b, pdf_b, a2), 0)
