"""Triangles by folding a parallelogram, caps by the angle's half."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np


def sample_triangle(v0, v1, v2, sample):
    """A point of the parallelogram; the far half is turned onto the near one."""
    a, b, c = (mi.Point3f(*map(float, np.ravel(each))) for each in (v0, v1, v2))
    far = sample.x + sample.y > 1
    s = dr.select(far, 1 - sample.x, sample.x)
    t = dr.select(far, 1 - sample.y, sample.y)
    return (1 - s - t) * a + s * b + t * c


def sample_triangle_pdf(p, v0, v1, v2):
    """Barycentric coordinates by least squares (Gram's matrix in double precision)."""
    corners = [np.asarray(each, dtype=float).ravel() for each in (v0, v1, v2)]
    edges = np.array([corners[1] - corners[0], corners[2] - corners[0]])
    area = 0.5 * np.sqrt(np.linalg.det(edges @ edges.T))
    dual = np.linalg.inv(edges @ edges.T) @ edges
    offset = mi.Vector3f(p - mi.Point3f(*corners[0].tolist()))
    s, t = (dr.dot(mi.Vector3f(*row.tolist()), offset) for row in dual)
    beside = offset - s * mi.Vector3f(*edges[0].tolist()) - t * mi.Vector3f(*edges[1].tolist())
    slack = 1e-5
    on = dr.norm(beside) <= slack * np.linalg.norm(edges, axis=1).max()
    on &= (s >= -slack) & (t >= -slack) & (s + t <= 1 + slack)
    return dr.select(on, mi.Float(1 / area), 0)


def sample_sphere_cap(sample, cos_theta_max):
    """With q = sin(theta / 2)^2, even from 0 to its largest value; here the first number turns."""
    q = sample.y * (0.5 * (1 - cos_theta_max))
    across = 2 * dr.sqrt(q * (1 - q))
    sine, cosine = dr.sincos(dr.two_pi * sample.x)
    return mi.Vector3f(across * cosine, across * sine, 1 - 2 * q)


def sample_sphere_cap_pdf(v, cos_theta_max):
    """One over the cap's area."""
    solid_angle = mi.Float(dr.two_pi * (1 - cos_theta_max))
    return dr.select(v.z >= cos_theta_max - 1e-6, 1 / solid_angle, 0)
