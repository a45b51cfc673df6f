"""Uniform points on triangles and uniform directions in spherical caps.

As in `warps`, a `sample` is a point (u, v) of [0, 1]^2, both ends included.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from .warps import cylindrical, in_range, unit_square, vector


def point(name: str, value: Any) -> np.ndarray:
    """Return three finite coordinates as float64, shape (3,)."""
    try:
        numbers = checks.real_array(name, value, np.float64)
        numbers = numbers[:, 0] if numbers.shape == (3, 1) else numbers  # mi.Point3f of one lane
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.all(np.isfinite(numbers)):
        raise ValueError(f"{name} = {checks.quote(value)}: must be three finite numbers")
    return numbers


def literal(numbers: np.ndarray) -> mi.Vector3f:
    """Return three numbers as constants of the kernel.

    `mi.Vector3f(numbers)` would copy them to arrays of one lane. Made within a symbolic loop, such
    arrays are read beyond their end by the other lanes (Dr.Jit 1.5.0).
    """
    return mi.Vector3f(*numbers.tolist())


def parallelogram_area(e0: np.ndarray, e1: np.ndarray, named: str) -> float:
    """Area between two edges, shape (3,) each, that single precision can tell from a line."""
    area = float(np.linalg.norm(np.cross(e0, e1)))
    longest = max(e0 @ e0, e1 @ e1, (e0 - e1) @ (e0 - e1))
    if not 1e-6 * longest <= area or area == 0:
        raise ValueError(f"{named}: must span an area, at least 1e-06 of the longest edge's square")
    return area


def triangle_corners(*vertices: Any) -> list[np.ndarray]:
    """Return three corners, which must span an area, as float64 of shape (3,) each."""
    a, b, c = corners = [point(f"v{i}", each) for i, each in enumerate(vertices)]
    named = ", ".join(f"v{i} = {each.tolist()}" for i, each in enumerate(corners))
    parallelogram_area(b - a, c - a, named)
    return corners


def sample_triangle(v0: Any, v1: Any, v2: Any, sample: mi.Point2f) -> mi.Point3f:
    """Uniform points on a triangle, with the density 1 / area.

    Every point of it is v0 + b1 (v1 - v0) + b2 (v2 - v0) with b1, b2 >= 0 and b1 + b2 <= 1, and
    this map stretches all areas alike, so it is enough to draw (b1, b2) uniformly from that half of
    a square, with density 2. There b1 has the marginal density 2 (1 - b1), hence
    P(b1) = 1 - (1 - b1)^2; given b1, b2 is uniform on [0, 1 - b1]:

        b1 = 1 - sqrt(1 - u),    b2 = v (1 - b1) = v sqrt(1 - u)

    Each corner is three numbers, or an `mi.Point3f` of any number of lanes. Numbers that are not
    finite, or in one line, raise a ValueError; Dr.Jit arrays are checked in debug mode only.

    Example:
        >>> sample_triangle([0, 0, 0], [4, 0, 0], [0, 4, 0], mi.Point2f(0.75, 0.5))
        [[2, 1, 0]]
    """
    v0, e1, e2 = _edges(v0, v1, v2)
    u, v = unit_square(sample)
    root = dr.safe_sqrt(1 - u)
    return v0 + (1 - root) * e1 + v * root * e2


def sample_triangle_pdf(p: mi.Point3f, v0: Any, v1: Any, v2: Any) -> mi.Float:
    """Density 1 / area of `sample_triangle` at `p`; 0 off the triangle.

    A point counts as on it if it is within 1e-5 of the longest edge plus 1e-6 of the largest
    coordinate, as much as single precision asks for; an array's degenerate triangles have 0.
    Corners are those of `sample_triangle`, and bad ones raise the same error.

    Example:
        >>> sample_triangle_pdf(mi.Point3f([1, 4], 1, 0), [0, 0, 0], [4, 0, 0], [0, 4, 0])
        [0.125, 0]
    """
    v0, e1, e2 = _edges(v0, v1, v2)
    p = mi.Point3f(vector("p", p))
    cross = dr.cross(e1, e2)
    double = dr.norm(cross)
    n = cross / double
    d, e3 = p - v0, e2 - e1
    longest = dr.maximum(dr.maximum(dr.norm(e1), dr.norm(e2)), dr.norm(e3))
    largest = dr.max(dr.maximum(dr.maximum(dr.abs(v0), dr.abs(v0 + e1)), dr.abs(v0 + e2)))
    tolerance = 1e-5 * longest + 1e-6 * largest
    on = dr.abs(dr.dot(n, d)) <= tolerance
    for edge, start in ((e1, d), (e3, d - e1), (-e2, d - e2)):  # Around the triangle
        inwards = dr.dot(n, dr.cross(edge, start)) / dr.norm(edge)
        on &= inwards >= -tolerance
    return dr.select(on & (double > 0), 2 / double, 0)


def sample_sphere_cap(sample: mi.Point2f, cos_theta_max: float | mi.Float) -> mi.Vector3f:
    """Uniform directions in the spherical cap theta <= theta_max around +z.

    A solid angle is dz dphi (see `square_to_uniform_sphere`), so z is uniform between
    cos_theta_max and 1. With the cap's height h = 1 - cos_theta_max:

        1 - z = u h,    r = sqrt(1 - z^2) = sqrt(u h (2 - u h)),    phi = 2 pi v

    h = 2 is the sphere, h = 1 the hemisphere. For small caps h keeps its digits where cos_theta_max
    has none; a Python number is subtracted from 1 in double precision.

    `cos_theta_max` is a number or a Dr.Jit float. Outside of [-1, 1], a number raises a ValueError;
    Dr.Jit arrays are checked in debug mode only.

    Example:
        >>> sample_sphere_cap(mi.Point2f(0.5, 0.0), 0.6)
        [[0.6, 0, 0.8]]
    """
    cos_theta_max = in_range("cos_theta_max", cos_theta_max, -1, 1)
    return sample_cap_of_height(sample, mi.Float(1 - cos_theta_max))


def sample_sphere_cap_pdf(v: mi.Vector3f, cos_theta_max: float | mi.Float) -> mi.Float:
    """Density 1 / (2 pi (1 - cos_theta_max)) [1/sr] of `sample_sphere_cap` at the unit vector `v`.

    Outside of the cap, whose edge is widened by a few roundings, it is 0, and so it is for the cap
    of one direction (cos_theta_max = 1), which has no density.

    Example:
        >>> pdf = sample_sphere_cap_pdf(mi.Vector3f([0.6, 0.8], 0, [0.8, 0.6]), 0.7)
        >>> [round(each, 4) for each in pdf]
        [0.5305, 0.0]
    """
    height = mi.Float(1 - in_range("cos_theta_max", cos_theta_max, -1, 1))
    v = vector("v", v)
    r2 = dr.square(v.x) + dr.square(v.y)
    below_pole = dr.select(v.z > 0, r2 / (1 + v.z), 1 - v.z)  # 1 - z, without losing digits
    inside = (below_pole <= height * (1 + 8 * dr.epsilon(mi.Float))) & (height > 0)
    return dr.select(inside, dr.rcp(dr.two_pi * height), 0)


def sample_cap_of_height(sample: mi.Point2f, height: mi.Float) -> mi.Vector3f:
    """Uniform directions with z >= 1 - height, of the density 1 / (2 pi height) [1/sr]."""
    u, v = unit_square(sample)
    h = u * height
    return cylindrical(dr.safe_sqrt(h * (2 - h)), v, 1 - h)


def _edges(*vertices: Any) -> tuple[mi.Point3f, mi.Vector3f, mi.Vector3f]:
    """First corner of a triangle and the two edges from it."""
    if not any(each is not None and dr.is_jit_v(each) for each in vertices):
        a, b, c = triangle_corners(*vertices)
        return mi.Point3f(literal(a)), literal(b - a), literal(c - a)
    a, b, c = (mi.Point3f(each) for each in vertices)
    e1, e2 = mi.Vector3f(b - a), mi.Vector3f(c - a)
    if dr.flag(dr.JitFlag.Debug):
        dr.assert_true(dr.squared_norm(dr.cross(e1, e2)) > 0, "v0, v1, v2: must span an area")
    return a, e1, e2
