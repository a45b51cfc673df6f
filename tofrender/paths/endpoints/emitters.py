"""Base of the techniques that sample a scene's emitters, and evaluate them where rays hit."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Self

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..protocols import Endpoint
from ..records import Connection, Hit, Path, Vertex
from ..surfaces import EmitterSamples, stretched
from ..wavefronts import Wavefronts

# Upper limit of densities in MIS weights, so that float32 can represent the square [1/sr]. Points
# of an emitter that is seen edge-on have higher densities and emit no light towards the vertex.
HIGHEST = 1e18
MANY_EMITTERS = 8  # number of emitters above which a single bounding box bounds their distance


class EmitterEndpoint(Endpoint):
    """Abstract base of the techniques that sample a scene's emitters, see `SceneLights`."""

    finds_all = False
    has_hits = True

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        hide_emitters: bool = False,
        discard_direct_light: bool = False,
    ) -> None:
        self.scene = checks.instance("scene", scene, mi.Scene, "a loaded scene")
        checks.instance("sensor", sensor, mi.Sensor | None, "a sensor or None")
        self.hide_emitters = checks.boolean("hide_emitters", hide_emitters)
        self.discard_direct_light = checks.boolean("discard_direct_light", discard_direct_light)
        self.samples = EmitterSamples(scene)
        self.moving_meshes: list[mi.Shape] = []
        flags = [emitter.flags() for emitter in scene.emitters()]
        has_distant = any(mi.has_flag(each, mi.EmitterFlags.Infinite) for each in flags)
        # where the light of emitters at infinity starts, for path lengths
        self.sphere = Wavefronts.around(scene, sensor) if has_distant else None
        self._boxes = self._bounding_boxes()

    @abstractmethod
    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the MIS weight of a hit."""

    def connection_reference(self, path: Path) -> mi.Interaction3f | None:
        """Return the vertex whose connection competes with the hit, None for `path.prev`."""
        return None

    def attached(self) -> Self:
        """Return the endpoint with derivatives by moving meshes, and one sample per vertex."""
        other = copy(self)
        lights = [shape for shape in self.scene.shapes() if shape.is_emitter() and shape.is_mesh()]
        # Mitsuba's rectangles do have a derivative of their density
        other.moving_meshes = [each for each in lights if each.class_name() != "Rectangle"]
        other.further = None
        return other

    def _bounding_boxes(self) -> list[tuple[mi.Point3f, mi.Point3f]]:
        """Return corners of boxes that hold all emitters; one box for all if there are many."""
        boxes = [mi.ScalarBoundingBox3f(e.bbox()) for e in self.scene.emitters()]
        if self.sphere is not None or not all(box.valid() for box in boxes):  # A projector has none
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
        """Return the distance from points to the closest emitter's bounding box [m]."""
        closest = mi.Float(dr.inf)
        for low, high in self._boxes:
            outside = dr.maximum(dr.maximum(low - p, p - high), 0)
            closest = dr.minimum(closest, dr.norm(outside))
        return closest

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """Return area lights, unless the sensor does not see them."""
        if self.hide_emitters or self.discard_direct_light:
            return ()
        surface = mi.EmitterFlags.Surface
        return [each for each in self.scene.emitters() if mi.has_flag(each.flags(), surface)]

    def sample_direction(
        self, vertex: Vertex, u: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction to an emitter; returns it, and radiance over density."""
        ds, weight = self.samples.sample_direction(vertex.si, u, active)
        if self.moving_meshes:
            lit = active & (ds.pdf != 0)
            stretch = stretched(self.scene, self.moving_meshes, vertex.si, ds.p, lit)
            weight = mi.unpolarized_spectrum(weight) * stretch
        return ds, weight

    def connection(
        self, vertex: Vertex, ds: mi.DirectionSample3f, weight: mi.Spectrum, active: mi.Bool
    ) -> Connection:
        """Return the connection of a vertex to an emitter sample."""
        p = vertex.si.p
        length = dr.norm(ds.p - p)
        if self.sphere is not None:
            distant = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
            length = dr.select(distant, self.sphere.length(p, ds.d), length)
        radiance, active = mi.unpolarized_spectrum(weight), active & (ds.pdf != 0)
        ends = ds.pdf, ds.delta
        return Connection(ds.p, ds.d, radiance, length, active, *ends, emitter=ds.emitter)

    def sample_emitter(self, vertex: Vertex, u: mi.Point2f, active: mi.Bool) -> Connection:
        """Sample a connection to an emitter by two random numbers."""
        return self.connection(vertex, *self.sample_direction(vertex, u, active), active)

    def emitted_radiance(self, vertex: Vertex, path: Path) -> Hit:
        """Return the radiance of the emitter at a vertex, or at infinity, of MIS weight 1."""
        si, prev, active = vertex.si, path.prev, path.active
        ds = mi.DirectionSample3f(self.scene, si=si, ref=prev)
        radiance = mi.unpolarized_spectrum(ds.emitter.eval(si, active))
        reference = self.connection_reference(path)
        if reference is None:
            reference = prev
        else:
            ds = mi.DirectionSample3f(self.scene, si=si, ref=reference)
        if self.samples.exist:
            ds.n = si.n
        pdf = self.samples.pdf_direction(reference, ds, active)
        length = vertex.length
        if self.sphere is not None:
            length = dr.select(vertex.valid, length, self.sphere.length(prev.p, path.ray.d))
        if self.hide_emitters:  # `Plan.start` skips area lights, here the environment
            active = active & (path.valid_ray | vertex.valid)
        if self.discard_direct_light:
            active = active & (path.depth > 0)
        return Hit(radiance, pdf, length, active, mis_weight=mi.Float(1))

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """Return radiance of the emitter that is hit, with its MIS weight."""
        hit = self.emitted_radiance(vertex, path)
        hit.mis_weight = self.hit_weight(path, vertex, hit)
        return hit


def power_heuristic(pdf_a: mi.Float, pdf_b: mi.Float) -> mi.Float:
    """Return the MIS weight a² / (a² + b²) of a sample from density a (Veach 1997, eq. 9.13).

    Densities above `HIGHEST` count as `HIGHEST`.
    """
    a = dr.minimum(pdf_a, HIGHEST)
    b = dr.minimum(pdf_b, HIGHEST)
    a2 = a * a
    return dr.select(a > 0, a2 / dr.fma(b, b, a2), 0)
