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
    """Check three finite coordinates, and return them as float64, shape (3,)."""
    try:
        numbers = checks.real_array(name, value, np.float64)
        # An mi.Point3f has one lane
        numbers = numbers[:, 0] if numbers.shape == (3, 1) else numbers
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.all(np.isfinite(numbers)):
        raise ValueError(f"{name} = {checks.quote(value)}: must be three finite numbers")
    return numbers


def literal(numbers: np.ndarray) -> mi.Vector3f:
    """Convert three numbers to constants of the kernel.

    `mi.Vector3f(numbers)` would copy them to arrays with one lane. If such arrays are created in a
    symbolic loop, the other lanes read beyond their end (Dr.Jit 1.5.0).
    """
    return mi.Vector3f(*numbers.tolist())


def parallelogram_area(e0: np.ndarray, e1: np.ndarray, named: str) -> float:
    """Return the area between two edges, shape (3,) each. Parallel edges raise an error.

    Args:
        e0: First edge.
        e1: Second edge.
        named: Name of the edges, for messages.

    Raises:
        ValueError: Single precision does not distinguish the area from 0.
    """
    area = float(np.linalg.norm(np.cross(e0, e1)))
    longest = max(e0 @ e0, e1 @ e1, (e0 - e1) @ (e0 - e1))
    if not 1e-6 * longest <= area or area == 0:
        raise ValueError(f"{named}: must span an area, at least 1e-06 of the longest edge's square")
    return area


def triangle_corners(*vertices: Any) -> list[np.ndarray]:
    """Check three corners of a triangle, and return them as float64, shape (3,) each."""
    a, b, c = corners = [point(f"v{i}", each) for i, each in enumerate(vertices)]
    named = ", ".join(f"v{i} = {each.tolist()}" for i, each in enumerate(corners))
    parallelogram_area(b - a, c - a, named)
    return corners


def sample_triangle(v0: Any, v1: Any, v2: Any, sample: mi.Point2f) -> mi.Point3f:
    """Sample uniform points on a triangle, with the density 1 / area.

    Each point of the triangle is v0 + b1 (v1 - v0) + b2 (v2 - v0) with b1, b2 >= 0 and
    b1 + b2 <= 1. This map scales all areas by the same factor. Therefore (b1, b2) is sampled
    uniformly on half of a square, with the density 2. There b1 has the marginal density 2 (1 - b1),
    so that P(b1) = 1 - (1 - b1)^2. For a given b1, b2 is uniform on [0, 1 - b1]:

        b1 = 1 - sqrt(1 - u),    b2 = v (1 - b1) = v sqrt(1 - u)

    Each corner is three numbers, or an `mi.Point3f` of any number of lanes. Numbers that are not
    finite, or corners on one line, raise a ValueError. Dr.Jit arrays are checked only in debug
    mode.

    Example:
        >>> sample_triangle([0, 0, 0], [4, 0, 0], [0, 4, 0], mi.Point2f(0.75, 0.5))
        [[2, 1, 0]]
    """
    v0, e1, e2 = _edges(v0, v1, v2)
    u, v = unit_square(sample)
    root = dr.safe_sqrt(1 - u)
    return v0 + (1 - root) * e1 + v * root * e2


def sample_triangle_pdf(p: mi.Point3f, v0: Any, v1: Any, v2: Any) -> mi.Float:
    """Return the density 1 / area of `sample_triangle` at `p`, 0 for points off the triangle.

    A point is on the triangle up to a tolerance for single precision: 1e-5 of the longest edge plus
    1e-6 of the largest coordinate. In arrays, degenerate triangles have the density 0. Corners and
    their errors are as in `sample_triangle`.

    Example:
        >>> sample_triangle_pdf(mi.Point3f([1, 4], 1, 0), [0, 0, 0], [4, 0, 0], [0, 4, 0])
        [0.125, 0]
    """
    v0, e1, e2 = _edges(v0, v1, v2)
    p = mi.Point3f(vector("p", p))
    cross = dr.cross(e1, e2)
    double = dr.norm(cross)
    n = cross / double
    d = p - v0
    e3 = e2 - e1

    # Tolerance [m]
    longest = dr.maximum(dr.maximum(dr.norm(e1), dr.norm(e2)), dr.norm(e3))
    largest = dr.max(dr.maximum(dr.maximum(dr.abs(v0), dr.abs(v0 + e1)), dr.abs(v0 + e2)))
    tolerance = 1e-5 * longest + 1e-6 * largest

    # Is the point in the plane, and on the inner side of each edge?
    on = dr.abs(dr.dot(n, d)) <= tolerance
    for edge, start in ((e1, d), (e3, d - e1), (-e2, d - e2)):
        inwards = dr.dot(n, dr.cross(edge, start)) / dr.norm(edge)
        on &= inwards >= -tolerance
    return dr.select(on & (double > 0), 2 / double, 0)


def sample_sphere_cap(sample: mi.Point2f, cos_theta_max: float | mi.Float) -> mi.Vector3f:
    """Sample uniform directions in the spherical cap theta <= theta_max around +z.

    A solid angle is dz dphi (see `square_to_uniform_sphere`). Therefore z is uniform between
    cos_theta_max and 1. With the height h = 1 - cos_theta_max of the cap:

        1 - z = u h,    r = sqrt(1 - z^2) = sqrt(u h (2 - u h)),    phi = 2 pi v

    h = 2 is the sphere, and h = 1 is the hemisphere. For small caps, h is precise although
    cos_theta_max is nearly 1. A Python number is subtracted from 1 in double precision.

    `cos_theta_max` is a number or a Dr.Jit float. A number outside [-1, 1] raises a ValueError.
    Dr.Jit arrays are checked only in debug mode.

    Example:
        >>> sample_sphere_cap(mi.Point2f(0.5, 0.0), 0.6)
        [[0.6, 0, 0.8]]
    """
    cos_theta_max = in_range("cos_theta_max", cos_theta_max, -1, 1)
    return sample_cap_of_height(sample, mi.Float(1 - cos_theta_max))


def sample_sphere_cap_pdf(v: mi.Vector3f, cos_theta_max: float | mi.Float) -> mi.Float:
    """Return the density of `sample_sphere_cap`, 1 / (2 pi (1 - cos_theta_max)), at `v` [1/sr].

    `v` is a unit vector. The density is 0 outside the cap, whose edge has a tolerance of a few
    roundings. It is also 0 for cos_theta_max = 1, because a single direction has no density.

    Example:
        >>> pdf = sample_sphere_cap_pdf(mi.Vector3f([0.6, 0.8], 0, [0.8, 0.6]), 0.7)
        >>> [round(each, 4) for each in pdf]
        [0.5305, 0.0]
    """
    height = mi.Float(1 - in_range("cos_theta_max", cos_theta_max, -1, 1))
    v = vector("v", v)
    r2 = dr.square(v.x) + dr.square(v.y)

    # 1 - z without cancellation
    below_pole = dr.select(v.z > 0, r2 / (1 + v.z), 1 - v.z)
    inside = (below_pole <= height * (1 + 8 * dr.epsilon(mi.Float))) & (height > 0)
    return dr.select(inside, dr.rcp(dr.two_pi * height), 0)


def sample_cap_of_height(sample: mi.Point2f, height: mi.Float) -> mi.Vector3f:
    """Sample uniform directions with z >= 1 - height, with the density 1 / (2 pi height) [1/sr]."""
    u, v = unit_square(sample)
    h = u * height
    return cylindrical(dr.safe_sqrt(h * (2 - h)), v, 1 - h)


def _edges(*vertices: Any) -> tuple[mi.Point3f, mi.Vector3f, mi.Vector3f]:
    """Return the first corner of a triangle, and the two edges from this corner."""
    # Corners of three numbers are constants
    if not any(each is not None and dr.is_jit_v(each) for each in vertices):
        a, b, c = triangle_corners(*vertices)
        return mi.Point3f(literal(a)), literal(b - a), literal(c - a)

    # Corners that are Dr.Jit arrays are checked only in debug mode
    a, b, c = (mi.Point3f(each) for each in vertices)
    e1 = mi.Vector3f(b - a)
    e2 = mi.Vector3f(c - a)
    if dr.flag(dr.JitFlag.Debug):
        dr.assert_true(dr.squared_norm(dr.cross(e1, e2)) > 0, "v0, v1, v2: must span an area")
    return a, e1, e2
