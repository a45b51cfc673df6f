"""The emitters of a scene, by connections and by hits."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class PathState:
    """What a light strategy may know of the path that it extends.

    Attributes:
        opl: Optical length up to the vertex [m].
        η: Index of refraction around the vertex.
        depth: Surface vertices before it.
        memory: What the strategy's `remember` has made of the vertices, this one included.
        previous: The vertex before.
        pdf: Density of the direction that led from there to here [1/sr].
        shared: Whether targets and material competed for that direction (see `targets`).
    """

    opl: mi.Float
    η: mi.Float
    depth: mi.UInt32
    memory: mi.Bool
    previous: mi.Interaction3f
    pdf: mi.Float
    shared: mi.Bool


MANY_EMITTERS = 8
"""Number of emitters from which on a single box bounds their distance."""


@dataclass
class Connection:
    """One sample of next-event estimation, shadow ray included.

    Attributes:
        direction: Unit vector from the surface towards the light, world space.
        weight: Radiance over density; 0 where the light cannot be seen.
        pdf: Density of `direction` [1/sr].
        delta: Whether nothing else finds this light (point lights, lasers), so that it counts in
            full.
        length: Geometric length of the connection [m].
        active: Lanes in which there is a connection.
    """

    direction: mi.Vector3f
    weight: mi.Spectrum
    pdf: mi.Float
    delta: mi.Bool
    length: mi.Float
    active: mi.Bool


@dataclass
class Wavefronts:
    """Where distant light starts: planes that touch the sphere around scene and sensor.

    Attributes:
        centre: The sphere's centre [m].
        radius: Its radius [m].
    """

    centre: mi.Point3f
    radius: mi.Float

    @classmethod
    def around(cls, scene: mi.Scene, sensor: mi.Sensor | None) -> Wavefronts:
        """The sphere around the scene, and the sensor's position if there is one."""
        box = scene.bbox()
        if sensor is not None:
            position = sensor.world_transform() @ mi.Point3f(0)
            box.expand(mi.ScalarPoint3f([float(x[0]) for x in position]))
        sphere = box.bounding_sphere()
        centre, radius = mi.Point3f(sphere.center), mi.Float(sphere.radius)
        dr.make_opaque(centre, radius)
        return cls(centre, radius)

    def length(self, p: mi.Point3f, d: mi.Vector3f) -> mi.Float:
        """Length from `p` along `d` to the plane where the light from there starts [m]."""
        return self.radius - dr.dot(d, p - self.centre)


class SceneLights:
    """All emitters of a scene, by next-event estimation and by hits.

    Args:
        scene: The scene.
        sensor: The sensor, whose position the sphere contains where distant lights start, or None.
    """

    connects = True
    finds_all = False

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor | None = None) -> None:
        self.scene = scene
        infinite = mi.EmitterFlags.Infinite
        self.has_distant = any(mi.has_flag(e.flags(), infinite) for e in scene.emitters())
        self.boxes = self._boxes()
        if self.has_distant:
            self.sphere = Wavefronts.around(scene, sensor)

    def _boxes(self) -> list[tuple[mi.Point3f, mi.Point3f]]:
        """Corners of boxes that hold all emitters; one box around everything if there are many."""
        boxes = [mi.ScalarBoundingBox3f(e.bbox()) for e in self.scene.emitters()]
        if self.has_distant:
            return [(mi.Point3f(-dr.inf), mi.Point3f(dr.inf))]
        if len(boxes) > MANY_EMITTERS:
            whole = boxes[0]
            for box in boxes[1:]:
                whole.expand(box)
            boxes = [whole]
        corners = [(mi.Point3f(box.min), mi.Point3f(box.max)) for box in boxes]
        dr.make_opaque(corners)
        return corners

    def connect(
        self,
        si: mi.SurfaceInteraction3f,
        path: PathState,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Sample an emitter as seen from `si`."""
        return self.choose(si, sampler.next_2d(), True, active)[0]

    def choose(
        self, si: mi.SurfaceInteraction3f, sample: mi.Point2f, shadow: bool, active: mi.Bool
    ) -> tuple[Connection, mi.Point3f]:
        """Sample an emitter, with or without its shadow ray; returns the point sampled too."""
        ds, weight = self.scene.sample_emitter_direction(si, sample, shadow, active)
        length = dr.norm(ds.p - si.p)
        if self.has_distant:
            distant = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
            length = dr.select(distant, self.sphere.length(si.p, ds.d), length)
        weight = mi.unpolarized_spectrum(weight)
        return Connection(ds.d, weight, ds.pdf, ds.delta, length, active & (ds.pdf != 0)), ds.p

    def hit(
        self,
        si: mi.SurfaceInteraction3f,
        previous: mi.Interaction3f,
        ray: mi.Ray3f,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
        """Radiance of the emitter at `si` (or behind the scene) towards the previous vertex."""
        ds = mi.DirectionSample3f(self.scene, si=si, ref=previous)
        radiance = mi.unpolarized_spectrum(ds.emitter.eval(si, active))
        pdf = self.scene.pdf_emitter_direction(previous, ds, active)
        length = dr.norm(si.p - previous.p)
        if self.has_distant:
            length = dr.select(si.is_valid(), length, self.sphere.length(previous.p, ray.d))
        return radiance, pdf, length

    def remember(self, memory: mi.Bool, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Nothing: connections do not depend on earlier vertices."""
        return memory

    def nearest(self, p: mi.Point3f) -> mi.Float:
        """Least length of any connection from `p` [m]: distance to the closest emitter's box."""
        closest = mi.Float(dr.inf)
        for low, high in self.boxes:
            outside = dr.maximum(dr.maximum(low - p, p - high), 0)
            closest = dr.minimum(closest, dr.norm(outside))
        return closest


class EmitterHits(SceneLights):
    """Emitters by hits alone, without next-event estimation.

    The algorithm of a first transient path tracer: noisier than `SceneLights` by far with small
    lights, equal in expectation, and blind to point lights.
    """

    connects = False

    def hit(self, si, previous, ray, active):
        """As in `SceneLights`; nothing competes with the hit, so the density is 0."""
        radiance, _, length = super().hit(si, previous, ray, active)
        return radiance, mi.Float(0), length


class ConnectionsOnly(SceneLights):
    """All emitters of a scene, by next-event estimation alone.

    Weak where a glossy surface reflects a large light: connections rarely fall into its lobe.
    Mirrors and glass, which no connection can serve, still see what they reflect.
    """

    finds_all = True

    def connect(self, si, path, sampler, active):
        """As in `SceneLights`; nothing competes with the connection."""
        em = super().connect(si, path, sampler, active)
        em.delta = mi.Bool(True)
        return em
