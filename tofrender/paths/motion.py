"""Velocities of vertices, by which the path loop finds the rate of change of path lengths.

The optical path length L of a path with the vertices x_0, x_1, ... changes by

    dL/dt = Σ n_i (v_{i+1} - v_i) · d_i

with the velocity v_i of vertex i, and the index n_i and the direction d_i of the segment behind it.
Mirrors and glass need no more than the velocity of their material: where a path is stationary, a
shift along the surface does not change its length to first order (Fermat).
"""

from __future__ import annotations

from collections.abc import Iterable

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scenes.motion import Motion, motions_of
from .records import Connection, Path, Vertex


class Velocities:
    """Velocities of a scene's shapes, media, lamps and of a sensor [m/s].

    Raises:
        ValueError: Shapes that move differently share a medium.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor | None) -> None:
        motions, rest = motions_of(scene), Motion()
        shapes = [(each, motions.get(each.id(), rest)) for each in scene.shapes()]
        media: dict[mi.Medium, Motion] = {}
        for shape, motion in shapes:
            medium = shape.interior_medium()
            if medium is not None and media.setdefault(medium, motion) != motion:
                raise ValueError(
                    f"{shape.id()}: shares its medium with a shape that moves otherwise"
                )
        lamps = [(each, _motion_of_lamp(each, motions)) for each in scene.emitters()]
        self.has_instances = any(shape.class_name() == "Instance" for shape, _ in shapes)
        self._shapes = _table((mi.ShapePtr(each), motion) for each, motion in shapes)
        self._media = _table((mi.MediumPtr(each), motion) for each, motion in media.items())
        self._lamps = _table((mi.EmitterPtr(each), motion) for each, motion in lamps)
        own = rest if sensor is None else motions.get(sensor.id(), rest)
        self._sensor = [dr.opaque(mi.Vector3f, each.tolist()) for each in own.affine()]

    def at_vertex(self, vertex: Vertex) -> mi.Vector3f:
        """Return velocities of the surfaces or media at vertices, 0 at infinity."""
        si = vertex.si
        shape = si.shape
        if self.has_instances:
            shape = dr.select(si.instance != None, si.instance, shape)  # noqa: E711
        velocity = _look_up(self._shapes, shape, si.p)
        if vertex.in_medium is None:
            return velocity
        point = vertex.medium_point
        return dr.select(point.here, _look_up(self._media, point.medium, si.p), velocity)

    def at_lamp(self, emitter: mi.EmitterPtr, point: mi.Point3f) -> mi.Vector3f:
        """Return velocities of points of emitters, 0 at infinity."""
        return _look_up(self._lamps, emitter, point)

    def at_sensor(self, point: mi.Point3f) -> mi.Vector3f:
        """Return velocities of points of the sensor."""
        a, spin = self._sensor
        return a + dr.cross(spin, mi.Vector3f(point))

    def extend(self, path: Path, vertex: Vertex, counts: mi.Bool | bool = True) -> None:
        """Add the segment to a vertex to the rate of a path, unless its length does not count."""
        velocity = dr.select(vertex.valid, self.at_vertex(vertex), 0)
        # From point to point, not along the ray, which starts beside: rigid motion then gives 0
        segment = vertex.si.p - path.prev.p
        along = vertex.valid & (dr.squared_norm(segment) > 0)
        d = dr.select(along, dr.normalize(segment), path.ray.d)
        rate = dr.dot(velocity - path.velocity, d)
        path.rate = dr.fma(path.η, dr.select(counts, rate, 0), path.rate)
        path.velocity = velocity

    def of_connection(self, connection: Connection, path: Path) -> mi.Float:
        """Return the rate of a connection's length, from the path's last vertex [m/s]."""
        if connection.rate is not None:
            return connection.rate
        if connection.emitter is None:
            end = self.at_sensor(connection.point)
        else:
            end = self.at_lamp(connection.emitter, connection.point)
        return dr.dot(end - path.velocity, connection.direction)


def _motion_of_lamp(emitter: mi.Emitter, motions: dict[str, Motion]) -> Motion:
    """Return the motion of an emitter, which on a surface is that of its shape."""
    surface = mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)
    return motions.get(emitter.get_shape().id() if surface else emitter.id(), Motion())


def _table(rows: Iterable[tuple[object, Motion]]) -> mi.Float:
    """Return a table of a and ω by the registry index of objects, see `Motion.affine`."""
    found = {int(dr.reinterpret_array(mi.UInt32, each)[0]): motion for each, motion in rows}
    table = np.zeros((max(found, default=0) + 1, 6), np.float32)
    for index, motion in found.items():
        table[index] = np.concatenate(motion.affine())
    return mi.Float(table.ravel())


def _look_up(table: mi.Float, pointer: mi.ShapePtr, point: mi.Point3f) -> mi.Vector3f:
    """Return the velocities of points of objects."""
    row = 2 * dr.reinterpret_array(mi.UInt32, pointer)
    a, spin = (dr.gather(mi.Vector3f, table, row + k) for k in range(2))
    return a + dr.cross(spin, mi.Vector3f(point))
