"""Warps: maps of the unit square that transform uniform points to points of another density.

All warps invert cumulative distributions. The density is split into its coordinates, one after the
other. Each factor is integrated to its cumulative distribution P(t). For a uniform number u, the
solution t of P(t) = u has the density P'(t). The documentation of each function contains its P and
the inverse of P.

A `sample` is a point (u, v) of [0, 1]^2, including both ends, with any number of lanes. Directions
are unit vectors in a frame with its north pole at +z. theta is the angle to the pole, phi is the
azimuth. u increases from the center or the pole outwards, and phi = 2 pi v. In Dr.Jit's debug mode
(`dr.set_flag(dr.JitFlag.Debug, True)`), a sample outside the square raises an error of one line.
Otherwise samples are not checked, which costs nothing.

`sampling.table` lists all of them for the chi-square test, the command line and the figures.

Source: M. Pharr, W. Jakob and G. Humphreys, "Physically Based Rendering", 4th edition, sections
2.3 (inversion), 2.4 (changes of variables) and A.5 (the warps). Beckmann: B. Walter et al.,
"Microfacet Models for Refraction through Rough Surfaces", EGSR 2007, equations 25, 28 and 29.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..runtime import checks

# Range of roughnesses with densities that single precision can represent
MIN_ALPHA = 1e-6
MAX_ALPHA = 1e6


def vector(name: str, value: Any, size: int = 3) -> Any:
    """Check that `value` is a Dr.Jit vector or point of `size` coordinates, and return it."""
    valid = isinstance(value, dr.ArrayBase) and dr.size_v(value) == size
    kind = "Point2f" if size == 2 else "Vector3f"
    allowed = f"an mi.{kind}, or another Dr.Jit array of {size} coordinates"
    return checks.require(name, value, valid, allowed)


def unit_square(sample: mi.Point2f) -> mi.Point2f:
    """Check in debug mode that `sample` is in [0, 1]^2 (AssertionError), and return it."""
    vector("sample", sample, 2)
    if dr.flag(dr.JitFlag.Debug):
        # NaN fails as well
        inside = dr.all((sample >= 0) & (sample <= 1))
        dr.assert_true(inside, "sample: must lie in [0, 1]^2")
    return sample


def in_range(name: str, value: Any, low: float, high: float) -> Any:
    """Check that a number is in [low, high], and return it. Arrays are checked in debug mode."""
    if not dr.is_array_v(value):
        return checks.number(name, value, low=low, high=high)
    if dr.flag(dr.JitFlag.Debug):
        allowed = f"{name}: must be a number from {low:g} to {high:g}"
        dr.assert_true((value >= low) & (value <= high), allowed)
    return value


def cylindrical(r: mi.Float, v: mi.Float, z: mi.Float) -> mi.Vector3f:
    """Return the vector (r cos(phi), r sin(phi), z) with phi = 2 pi v."""
    sin_phi, cos_phi = dr.sincos(dr.two_pi * v)
    return mi.Vector3f(r * cos_phi, r * sin_phi, z)


def square_to_tent(sample: mi.Point2f) -> mi.Point2f:
    """Warp to the tent p(x, y) = p1(x) p1(y) with p1(t) = 1 - |t|, on [-1, 1]^2.

    Both coordinates have the same density and are independent. For t < 0, P1(t) is the integral of
    1 + s from s = -1 to t, which is (1 + t)^2 / 2. For t >= 0, P1(t) is 1 - (1 - t)^2 / 2. Both
    are equal at P1(0) = 1/2. Therefore P1(t) = u has the solution

        t = sqrt(2 u) - 1          for u < 1/2
        t = 1 - sqrt(2 (1 - u))    for u >= 1/2

    Example:
        >>> p = square_to_tent(mi.Point2f(0.125, 1))
        >>> p.x[0], p.y[0]
        (-0.5, 1.0)
    """
    u = unit_square(sample)
    return mi.Point2f(dr.select(u < 0.5, dr.sqrt(2 * u) - 1, 1 - dr.sqrt(2 - 2 * u)))


def square_to_tent_pdf(p: mi.Point2f) -> mi.Float:
    """Return the density (1 - |x|) (1 - |y|) per unit area at `p`, 0 outside [-1, 1]^2.

    Example:
        >>> float(square_to_tent_pdf(mi.Point2f(-0.5, 0.0))[0])
        0.5
    """
    height = dr.maximum(1 - dr.abs(vector("p", p, 2)), 0)
    return height.x * height.y


def square_to_uniform_disk(sample: mi.Point2f) -> mi.Point2f:
    """Warp to the uniform density 1/pi on the unit disk.

    In polar coordinates, an area element is r dr dphi. Therefore the density of (r, phi) is r / pi:
    the density of phi is 1 / (2 pi), and the density of r is 2 r, with P(r) = r^2. The inverse is

        r = sqrt(u),    phi = 2 pi v

    With r = u instead, points would be too dense at the center.

    Example:
        >>> square_to_uniform_disk(mi.Point2f(0.25, 0.0))
        [[0.5, 0]]
    """
    u, v = unit_square(sample)
    p = cylindrical(dr.sqrt(u), v, mi.Float(0))
    return mi.Point2f(p.x, p.y)


def square_to_uniform_disk_pdf(p: mi.Point2f) -> mi.Float:
    """Return the density 1/pi per unit area on the unit disk, 0 outside the disk.

    The edge has a tolerance of a few roundings, because points on the circle are rounded.

    Example:
        >>> round(float(square_to_uniform_disk_pdf(mi.Point2f(0.6, 0.8))[0]), 4)
        0.3183
    """
    p = vector("p", p, 2)
    return dr.select(dr.squared_norm(p) <= 1 + 8 * dr.epsilon(p), dr.inv_pi, mi.Float(0))


def square_to_uniform_sphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to the uniform density 1 / (4 pi) on the unit sphere.

    A solid angle is sin(theta) dtheta dphi = dz dphi up to its sign, with z = cos(theta)
    (Archimedes' hat-box theorem). Therefore the density of z is constant, 1/2 on [-1, 1], and the
    probability to be above z is (1 - z) / 2. Setting it to u gives

        z = 1 - 2 u,    r = sqrt(1 - z^2) = 2 sqrt(u (1 - u)),    phi = 2 pi v

    The last form of r has no cancellation at the poles, where z^2 is nearly 1.

    Example:
        >>> square_to_uniform_sphere(mi.Point2f(0.5, 0.0))
        [[1, 0, 0]]
    """
    u, v = unit_square(sample)
    return cylindrical(2 * dr.sqrt(u * (1 - u)), v, 1 - 2 * u)


def square_to_uniform_sphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Return the density 1 / (4 pi) [1/sr] in the direction of the unit vector `v`.

    Example:
        >>> round(float(square_to_uniform_sphere_pdf(mi.Vector3f(0, 0, -1))[0]), 4)
        0.0796
    """
    return dr.full(mi.Float, dr.inv_four_pi, dr.width(vector("v", v)))


def square_to_uniform_hemisphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to the uniform density 1 / (2 pi) on the hemisphere around +z.

    As on the sphere, the density of z = cos(theta) is constant, here 1 on [0, 1], and the
    probability to be above z is 1 - z. Setting it to u gives

        z = 1 - u,    r = sqrt(1 - z^2) = sqrt(u (2 - u)),    phi = 2 pi v

    Example:
        >>> square_to_uniform_hemisphere(mi.Point2f(0.0, 0.0))
        [[0, 0, 1]]
    """
    u, v = unit_square(sample)
    return cylindrical(dr.sqrt(u * (2 - u)), v, 1 - u)


def square_to_uniform_hemisphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Return the density 1 / (2 pi) [1/sr] at the unit vector `v`, 0 below the horizon.

    Example:
        >>> round(float(square_to_uniform_hemisphere_pdf(mi.Vector3f(0, 0, 1))[0]), 4)
        0.1592
    """
    return dr.select(vector("v", v).z >= 0, dr.inv_two_pi, mi.Float(0))


def square_to_cosine_hemisphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to the density cos(theta) / pi on the hemisphere around +z.

    With dω = sin(theta) dtheta dphi, the density of theta is 2 sin(theta) cos(theta). This is the
    derivative of P(theta) = sin(theta)^2. Setting it to u gives

        r = sin(theta) = sqrt(u),    z = cos(theta) = sqrt(1 - u),    phi = 2 pi v

    Projected onto the ground, these directions are uniform points of the disk, because projection
    scales an area of the hemisphere by the cosine (Malley's method).

    Example:
        >>> square_to_cosine_hemisphere(mi.Point2f(0.0, 0.0))
        [[0, 0, 1]]
    """
    u, v = unit_square(sample)
    return cylindrical(dr.sqrt(u), v, dr.sqrt(1 - u))


def square_to_cosine_hemisphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Return the density z / pi [1/sr] at the unit vector `v`, 0 below the horizon.

    Example:
        >>> pdf = square_to_cosine_hemisphere_pdf(mi.Vector3f(0.6, 0, mi.Float(0.8, -0.8)))
        >>> [round(float(each), 4) for each in pdf]
        [0.2546, 0.0]
    """
    return dr.maximum(vector("v", v).z, 0) * dr.inv_pi


def square_to_beckmann(sample: mi.Point2f, alpha: float | mi.Float) -> mi.Vector3f:
    """Warp to the Beckmann density of microfacet normals, weighted with their projected area.

        p(m) = D(m) cos(theta) = exp(-tan(theta)^2 / alpha^2) / (pi alpha^2 cos(theta)^3)

    With dω = sin(theta) dtheta dphi, the density of phi is 1 / (2 pi). For theta, substitute
    t = tan(theta)^2 with dt = 2 sin(theta) / cos(theta)^3 dtheta. All cosines cancel, so that the
    density of t is exp(-t / alpha^2) / alpha^2, with P(t) = 1 - exp(-t / alpha^2). P(t) = u gives

        t = tan(theta)^2 = -alpha^2 ln(1 - u),    phi = 2 pi v
        cos(theta) = 1 / sqrt(1 + t),    sin(theta) = sqrt(t) cos(theta)

    This form of sin(theta) is precise for small alpha, unlike 1 - cos(theta)^2. At u = 1 the
    argument of the logarithm is limited to the smallest step below 1.

    Args:
        sample: Point (u, v) of the unit square.
        alpha: Roughness: the standard deviation of the slopes of the surface, times sqrt(2). A
            number or a Dr.Jit float from 1e-6 to 1e6; other numbers raise a ValueError.

    Example:
        >>> import math
        >>> m = square_to_beckmann(mi.Point2f(1 - math.exp(-1), 0.0), 0.75)  # tan = alpha
        >>> round(m.x[0], 4), round(m.z[0], 4)
        (0.6, 0.8)
    """
    alpha = in_range("alpha", alpha, MIN_ALPHA, MAX_ALPHA)
    u, v = unit_square(sample)
    tan_theta = alpha * dr.sqrt(-dr.log(dr.maximum(1 - u, dr.epsilon(u))))
    z = dr.rcp(dr.sqrt(1 + dr.square(tan_theta)))
    return cylindrical(tan_theta * z, v, z)


def square_to_beckmann_pdf(m: mi.Vector3f, alpha: float | mi.Float) -> mi.Float:
    """Return the Beckmann density of microfacet normals at the normal `m` [1/sr].

    The density is exp(-tan(theta)^2 / alpha^2) / (pi alpha^2 cos(theta)^3), and 0 at the horizon
    and below. The tangent is computed from x and y, because 1 - z^2 would have no precision near
    the pole, where all normals of a smooth surface are. `alpha` is the roughness, as in
    `square_to_beckmann`.

    Example:
        >>> round(float(square_to_beckmann_pdf(mi.Vector3f(0, 0, 1), 0.5)[0]), 4)  # 4 / pi
        1.2732
    """
    alpha = in_range("alpha", alpha, MIN_ALPHA, MAX_ALPHA)
    normalization = dr.inv_pi / dr.square(alpha)
    m = vector("m", m)
    inv_z = dr.rcp(m.z)
    tan2_theta = (dr.square(m.x) + dr.square(m.y)) * dr.square(inv_z)
    falloff = dr.exp(-tan2_theta / dr.square(alpha))

    # At the horizon, falloff / z^3 would be 0 / 0
    above = (m.z > 0) & (falloff > 0)
    return dr.select(above, normalization * falloff * dr.square(inv_z) * inv_z, 0)
