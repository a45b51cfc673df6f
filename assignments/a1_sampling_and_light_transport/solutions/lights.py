"""Lights by plane geometry with inward edges, half-angle cones, and the second number's picks."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from tofrender.sampling.emitter_records import Shape, emission_values


def vector(numbers):
    """Three constants."""
    return mi.Vector3f(*(float(each) for each in numbers))


class Triangle(Shape):
    """A triangle; it emits on the side of (v1 - v0) x (v2 - v0)."""

    def __init__(self, v0, v1, v2, emission=0):
        corners = [np.asarray(each, dtype=float) for each in (v0, v1, v2)]
        cross = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        self.area = 0.5 * float(np.linalg.norm(cross))
        self.normal = cross / np.linalg.norm(cross)
        self.corners = corners
        self.emission = emission_values(emission)

    def sample(self, o, sample):
        """A point of the parallelogram, folded onto the triangle."""
        s = dr.minimum(sample.x, sample.y)
        t = 1 - dr.maximum(sample.x, sample.y)
        a, b, c = map(vector, self.corners)
        p = mi.Point3f(s * a + t * b + (1 - s - t) * c)
        return self._hit(o, p, dr.normalize(p - o), mi.Bool(True))

    def record(self, o, v):
        """The plane's point, on the inner side of all three edges."""
        n = vector(self.normal)
        a = vector(self.corners[0])
        t = dr.dot(n, a - o) / dr.dot(n, v)
        p = mi.Point3f(o + t * v)
        valid = t > 0
        for i in range(3):
            start = self.corners[i]
            end = self.corners[(i + 1) % 3]
            inwards = np.cross(self.normal, end - start)
            valid &= dr.dot(vector(inwards), p - vector(start)) >= 0
        return self._hit(o, p, v, valid)

    def _hit(self, o, p, d, valid):
        n = vector(self.normal)
        distance = dr.norm(p - o)
        facing = dr.abs(dr.dot(n, d))
        pdf = dr.square(distance) / facing / self.area
        return self.filled(o, p, n, d, distance, pdf, valid & (facing > 1e-7))


class Sphere(Shape):
    """A sphere that emits outwards, sampled by the cone of directions that it fills."""

    def __init__(self, center=(0, 0, 0), radius=1.0, emission=0, *, transform=None):
        m = np.eye(4) if transform is None else np.asarray(transform, dtype=float).reshape(4, 4)
        self.center = m[:3, :3] @ np.asarray(center, dtype=float) + m[:3, 3]
        self.radius = float(radius * abs(np.linalg.det(m[:3, :3])) ** (1 / 3))
        self.area = 4 * math.pi * self.radius**2
        self.emission = emission_values(emission)

    def sample(self, o, sample):
        """With q = sin(theta / 2)^2, even from 0 to its largest value."""
        axis, q_max, _ = self._cone(o)
        q = sample.y * q_max
        across = 2 * dr.sqrt(q * (1 - q))
        sine, cosine = dr.sincos(dr.two_pi * sample.x)
        frame = mi.Frame3f(axis)
        d = frame.to_world(mi.Vector3f(across * sine, across * cosine, 1 - 2 * q))
        return self._meet(o, d, True)

    def record(self, o, v):
        """The first point of the sphere along the ray."""
        return self._meet(o, v, False)

    def _cone(self, o):
        """Axis, sin(theta_max / 2)^2, and whether `o` is outside."""
        to_center = vector(self.center) - o
        far = dr.norm(to_center)
        outside = far > self.radius
        sine = dr.minimum(self.radius / far, 1)
        half = dr.sin(0.5 * dr.asin(sine))
        axis = dr.select(far > 0, to_center / far, mi.Vector3f(0, 0, 1))
        return axis, dr.select(outside, dr.square(half), 1), outside

    def _meet(self, o, d, certain):
        """The point nearest to the center, and half a chord before (from inside, after) it."""
        _, q_max, outside = self._cone(o)
        to_center = vector(self.center) - o
        ahead = dr.dot(to_center, d)
        beside = to_center - ahead * d
        chord2 = self.radius**2 - dr.squared_norm(beside)
        half = dr.sqrt(dr.maximum(chord2, 0))
        distance = dr.select(outside, ahead - half, ahead + half)
        n = dr.normalize(mi.Vector3f(dr.select(outside, -half, half) * d - beside))
        valid = (distance > 0) & (mi.Bool(certain) | (chord2 >= 0))
        pdf = 1 / (4 * dr.pi * q_max)
        p = mi.Point3f(vector(self.center) + self.radius * n)
        return self.filled(o, p, n, d, distance, pdf, valid)


class SurfaceGroup(Shape):
    """Several shapes, sampled as one light."""

    def __init__(self, shapes):
        self.shapes = list(shapes)
        self.area = sum(shape.area for shape in self.shapes)

    @property
    def is_emissive(self):
        """Whether any of the shapes is."""
        return any(shape.is_emissive for shape in self.shapes)

    def sample(self, o, sample):
        """Pick a shape with the second number, and rescale the remainder of the number."""
        count = len(self.shapes)
        pick = dr.minimum(mi.UInt32(sample.y * count), count - 1)
        rest = mi.Point2f(sample.x, sample.y * count - pick)
        direction = mi.Vector3f(0, 0, 1)
        for i, shape in enumerate(self.shapes):
            direction = dr.select(pick == i, shape.sample(o, rest).d, direction)
        return self.record(o, direction)

    def record(self, o, v):
        """The nearest of all hits."""
        records = [shape.record(o, v) for shape in self.shapes]
        nearest = records[0]
        for other in records[1:]:
            ahead = other.valid & (~nearest.valid | (other.distance < nearest.distance))
            nearest = dr.select(ahead, other, nearest)
        nearest.pdf = mi.Float(sum(each.pdf for each in records)) / len(records)
        nearest.weight = dr.select(nearest.pdf > 0, nearest.radiance / nearest.pdf, 0)
        return nearest
