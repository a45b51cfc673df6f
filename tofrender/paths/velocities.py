"""Velocities of vertices, for rates of change of path lengths.

The optical path length L of a path with the vertices x_0, x_1, ... changes by

    dL/dt = Σ n_i (v_{i+1} - v_i) · d_i

Here, v_i is the velocity of vertex i. The segment from vertex i to vertex i+1 has the index of
refraction n_i and the direction d_i. For mirrors and glass, v_i is the velocity of the material,
although the vertex also slides along the surface. By Fermat's principle, this shift does not change
the length of the path to first order.
"""

from __future__ import annotations

from collections.abc import Iterable

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scenes.motion import Motion, motions_of
from .records import Connection, Path, Vertex


class Velocities:
    """Velocities of the shapes, media and emitters of a scene, and of a sensor [m/s].

    Args:
        scene: The scene.
        sensor: The sensor, None for a sensor at rest.

    Raises:
        ValueError: Two shapes with different motions share a medium.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor | None) -> None:
        motions = motions_of(scene)
        rest = Motion()

        # Motion of each shape, and of the medium inside
        shapes = [(each, motions.get(each.id(), rest)) for each in scene.shapes()]
        media: dict[mi.Medium, Motion] = {}
        for shape, motion in shapes:
            medium = shape.interior_medium()
            if medium is not None and media.setdefault(medium, motion) != motion:
                raise ValueError(
                    f"shape {shape.id()!r} shares its medium with a shape that has another motion. "
                    "Give each of both shapes a separate medium"
                )

        # Motion of each emitter, and of the sensor
        emitters = [(each, _motion_of_emitter(each, motions)) for each in scene.emitters()]

        # Tables by the registry index of each object
        self.has_instances = any(shape.class_name() == "Instance" for shape, _ in shapes)
        self._shapes = _table((mi.ShapePtr(each), motion) for each, motion in shapes)
        self._media = _table((mi.MediumPtr(each), motion) for each, motion in media.items())
        self._emitters = _table((mi.EmitterPtr(each), motion) for each, motion in emitters)
        own = rest if sensor is None else motions.get(sensor.id(), rest)
        self._sensor = [dr.opaque(mi.Vector3f, each.tolist()) for each in own.affine()]

    def at_vertex(self, vertex: Vertex) -> mi.Vector3f:
        """Return the velocities of surfaces and media at vertices [m/s], 0 at infinity."""
        si = vertex.si
        shape = si.shape

        # An instance moves as a whole
        if self.has_instances:
            shape = dr.select(si.instance != None, si.instance, shape)  # noqa: E711
        velocity = _look_up(self._shapes, shape, si.p)
        if vertex.in_medium is None:
            return velocity

        # Scattering points move with their medium
        point = vertex.medium_point
        return dr.select(point.here, _look_up(self._media, point.medium, si.p), velocity)

    def at_lamp(self, emitter: mi.EmitterPtr, point: mi.Point3f) -> mi.Vector3f:
        """Return the velocities of points on emitters [m/s], 0 at infinity."""
        return _look_up(self._emitters, emitter, point)

    def at_sensor(self, point: mi.Point3f) -> mi.Vector3f:
        """Return the velocities of points on the sensor [m/s]."""
        a, spin = self._sensor
        return a + dr.cross(spin, mi.Vector3f(point))

    def extend(self, path: Path, vertex: Vertex, counts: mi.Bool | bool = True) -> None:
        """Add the segment to a vertex to the rate of a path.

        Changes `rate` and `velocity` of the path.

        Args:
            path: The path before its update.
            vertex: The next vertex.
            counts: Lanes in which the segment belongs to the path length.
        """
        velocity = dr.select(vertex.valid, self.at_vertex(vertex), 0)

        # Direction from point to point. The ray starts slightly off the last vertex, so that its
        # direction would give a rate other than 0 in rigid motion
        segment = vertex.si.p - path.prev.p
        along = vertex.valid & (dr.squared_norm(segment) > 0)
        d = dr.select(along, dr.normalize(segment), path.ray.d)

        # Rate of change of this segment
        rate = dr.dot(velocity - path.velocity, d)
        path.rate = dr.fma(path.η, dr.select(counts, rate, 0), path.rate)
        path.velocity = velocity

    def of_connection(self, connection: Connection, path: Path) -> mi.Float:
        """Return the rate of change of a connection's length [m/s].

        Args:
            connection: The connection.
            path: The path up to the vertex that is connected.
        """
        if connection.rate is not None:
            return connection.rate

        # Velocity of the end of the connection
        if connection.emitter is None:
            end = self.at_sensor(connection.point)
        else:
            end = self.at_lamp(connection.emitter, connection.point)
        return dr.dot(end - path.velocity, connection.direction)


def _motion_of_emitter(emitter: mi.Emitter, motions: dict[str, Motion]) -> Motion:
    """Return the motion of an emitter. Emitters on surfaces move with their shape."""
    surface = mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)
    return motions.get(emitter.get_shape().id() if surface else emitter.id(), Motion())


def _table(rows: Iterable[tuple[object, Motion]]) -> mi.Float:
    """Return a table of velocities a and angular velocities ω, see `Motion.affine`.

    The row of an object is its registry index. Each row has six numbers. The rows of other objects
    are 0.

    Args:
        rows: Pairs of an object's pointer and its motion.
    """
    found = {int(dr.reinterpret_array(mi.UInt32, each)[0]): motion for each, motion in rows}
    table = np.zeros((max(found, default=0) + 1, 6), np.float32)
    for index, motion in found.items():
        table[index] = np.concatenate(motion.affine())
    return mi.Float(table.ravel())


def _look_up(table: mi.Float, pointer: mi.ShapePtr, point: mi.Point3f) -> mi.Vector3f:
    """Return the velocities of points on objects [m/s].

    Args:
        table: Result of `_table`.
        pointer: Object of each lane.
        point: Point of each lane [m].
    """
    row = 2 * dr.reinterpret_array(mi.UInt32, pointer)
    a, spin = (dr.gather(mi.Vector3f, table, row + k) for k in range(2))
    return a + dr.cross(spin, mi.Vector3f(point))
