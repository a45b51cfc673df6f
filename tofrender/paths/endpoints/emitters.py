"""Abstract base of the endpoints that sample the emitters of a scene."""

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
from ..surfaces import EmitterSamples, area_change
from ..wavefronts import Wavefronts

# Upper limit of densities in MIS weights [1/sr], so that float32 can represent their squares. Only
# emitters that are seen edge-on have higher densities, and they emit no light towards the vertex
HIGHEST = 1e18

# Largest number of emitters with separate bounding boxes. More emitters share one box
MANY_EMITTERS = 8


class EmitterEndpoint(Endpoint):
    """Abstract base of the endpoints that sample the emitters of a scene.

    `SceneLights` describes the arguments.
    """

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

        # Area lights with derivatives of their area, see `attached`
        self.moving_meshes: list[mi.Shape] = []

        # Planes where the light of emitters at infinity starts
        flags = [emitter.flags() for emitter in scene.emitters()]
        has_distant = any(mi.has_flag(each, mi.EmitterFlags.Infinite) for each in flags)
        self.sphere = Wavefronts.around(scene, sensor) if has_distant else None
        self._boxes = self._bounding_boxes()

    @abstractmethod
    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the MIS weight of a hit."""

    def connection_reference(self, path: Path) -> mi.Interaction3f | None:
        """Return the vertex that could have been connected to the hit, None for `path.prev`.

        `Hit.pdf` is the density of next-event estimation at this vertex.
        """
        return None

    def attached(self) -> Self:
        """Return a copy with derivatives by moving meshes and one emitter sample per vertex."""
        other = copy(self)
        lights = [shape for shape in self.scene.shapes() if shape.is_emitter() and shape.is_mesh()]
        # Exclude rectangles: Mitsuba's density already contains their derivative
        other.moving_meshes = [each for each in lights if each.class_name() != "Rectangle"]
        other.further = None
        return other

    def _bounding_boxes(self) -> list[tuple[mi.Point3f, mi.Point3f]]:
        """Return bounding boxes of all emitters, as pairs of corners [m].

        Many emitters share one box.
        """
        # Without bounds, distances are 0: emitters at infinity, and projectors without a box
        boxes = [mi.ScalarBoundingBox3f(e.bbox()) for e in self.scene.emitters()]
        if self.sphere is not None or not all(box.valid() for box in boxes):
            return [(mi.Point3f(-dr.inf), mi.Point3f(dr.inf))]

        # Merge the boxes of many emitters
        if len(boxes) > MANY_EMITTERS:
            whole = boxes[0]
            for box in boxes[1:]:
                whole.expand(box)
            boxes = [whole]

        # Store the corners as opaque arrays, so that kernels do not depend on their values
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
        """Return the area lights, or no emitters if the sensor does not see them directly."""
        if self.hide_emitters or self.discard_direct_light:
            return ()
        surface = mi.EmitterFlags.Surface
        return [each for each in self.scene.emitters() if mi.has_flag(each.flags(), surface)]

    def sample_direction(
        self, vertex: Vertex, u: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """Sample a direction to an emitter.

        Returns the direction sample, and radiance over density.
        """
        ds, weight = self.samples.sample_direction(vertex.si, u, active)

        # Attach the derivative of the area around the sampled point
        if self.moving_meshes:
            lit = active & (ds.pdf != 0)
            change = area_change(self.scene, self.moving_meshes, vertex.si, ds.p, lit)
            weight = mi.unpolarized_spectrum(weight) * change
        return ds, weight

    def connection(
        self, vertex: Vertex, ds: mi.DirectionSample3f, weight: mi.Spectrum, active: mi.Bool
    ) -> Connection:
        """Return the connection of a vertex to an emitter sample.

        Args:
            vertex: The vertex.
            ds: Direction sample of the emitter.
            weight: Radiance over density.
            active: Active lanes.
        """
        # Light of emitters at infinity starts on a plane
        p = vertex.si.p
        length = dr.norm(ds.p - p)
        if self.sphere is not None:
            distant = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
            length = dr.select(distant, self.sphere.length(p, ds.d), length)
        return Connection(
            point=ds.p,
            direction=ds.d,
            weight=mi.unpolarized_spectrum(weight),
            length=length,
            active=active & (ds.pdf != 0),
            pdf=ds.pdf,
            delta=ds.delta,
            emitter=ds.emitter,
        )

    def sample_emitter(self, vertex: Vertex, u: mi.Point2f, active: mi.Bool) -> Connection:
        """Sample a connection to an emitter, given two uniform random numbers."""
        ds, weight = self.sample_direction(vertex, u, active)
        return self.connection(vertex, ds, weight, active)

    def emitted_radiance(self, vertex: Vertex, path: Path) -> Hit:
        """Return the radiance of the emitter at a vertex or at infinity, with the MIS weight 1."""
        si = vertex.si
        prev = path.prev
        active = path.active

        # Evaluate the emitter
        ds = mi.DirectionSample3f(self.scene, si=si, ref=prev)
        radiance = mi.unpolarized_spectrum(ds.emitter.eval(si, active))

        # Find the density of next-event estimation for the same point
        reference = self.connection_reference(path)
        if reference is None:
            reference = prev
        else:
            ds = mi.DirectionSample3f(self.scene, si=si, ref=reference)
        if self.samples.exist:
            ds.n = si.n
        pdf = self.samples.pdf_direction(reference, ds, active)

        # Light from infinity starts on a plane
        length = vertex.length
        if self.sphere is not None:
            length = dr.select(vertex.valid, length, self.sphere.length(prev.p, path.ray.d))

        # Leave out the environment if emitters are hidden. `Plan.start` skips area lights
        if self.hide_emitters:
            active = active & (path.valid_ray | vertex.valid)
        if self.discard_direct_light:
            active = active & (path.depth > 0)
        return Hit(radiance=radiance, pdf=pdf, length=length, active=active, mis_weight=mi.Float(1))

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """Return the radiance of the emitter that the ray hits, with its MIS weight."""
        hit = self.emitted_radiance(vertex, path)
        hit.mis_weight = self.hit_weight(path, vertex, hit)
        return hit


def power_heuristic(pdf_a: mi.Float, pdf_b: mi.Float) -> mi.Float:
    """Return the MIS weight a² / (a² + b²) of a sample from density a (Veach 1997, eq. 9.13).

    Densities are clamped to `HIGHEST`. The weight is 0 if a is 0.
    """
    a = dr.minimum(pdf_a, HIGHEST)
    b = dr.minimum(pdf_b, HIGHEST)
    a2 = a * a
    return dr.select(a > 0, a2 / dr.fma(b, b, a2), 0)
