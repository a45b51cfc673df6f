"""Warps: maps of the unit square that turn uniform points into points of another density.

All are built by inversion. Split the density into one coordinate after the other, integrate each
to its cumulative distribution P(t), set P(t) = u for a uniform number u, and solve for t: t then
has the density P'(t). Each function below shows its own P and the inverse of it.

A `sample` is a point (u, v) of [0, 1]^2, both ends included, of any number of lanes. Directions are
unit vectors in a frame whose north pole is +z; theta is the angle to the pole, phi the azimuth.
The first number goes out from the centre or the pole (u = 0), the second around: phi = 2 pi v. In
Dr.Jit's debug mode (`dr.set_flag(dr.JitFlag.Debug, True)`) a sample outside of the square fails
with one line; without it, that is not checked and costs nothing.

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

MIN_ALPHA, MAX_ALPHA = 1e-6, 1e6  # roughnesses whose densities single precision can hold


def vector(name: str, value: Any, size: int = 3) -> Any:
    """Return `value`, which must be a Dr.Jit vector or point of `size` coordinates."""
    valid = isinstance(value, dr.ArrayBase) and dr.size_v(value) == size
    kind = "Point2f" if size == 2 else "Vector3f"
    allowed = f"an mi.{kind}, or another Dr.Jit array of {size} coordinates"
    return checks.require(name, value, valid, allowed)


def unit_square(sample: mi.Point2f) -> mi.Point2f:
    """Return `sample`, which in debug mode must lie in [0, 1]^2 (AssertionError)."""
    vector("sample", sample, 2)
    if dr.flag(dr.JitFlag.Debug):
        inside = dr.all((sample >= 0) & (sample <= 1))  # false for NaN too
        dr.assert_true(inside, "sample: must lie in [0, 1]^2")
    return sample


def in_range(name: str, value: Any, low: float, high: float) -> Any:
    """Return a number in [low, high]; Dr.Jit arrays are checked in debug mode only."""
    if not dr.is_array_v(value):
        return checks.number(name, value, low=low, high=high)
    if dr.flag(dr.JitFlag.Debug):
        allowed = f"{name}: must be a number from {low:g} to {high:g}"
        dr.assert_true((value >= low) & (value <= high), allowed)
    return value


def cylindrical(r: mi.Float, v: mi.Float, z: mi.Float) -> mi.Vector3f:
    """Vector (r cos(phi), r sin(phi), z) with phi = 2 pi v."""
    sin_phi, cos_phi = dr.sincos(dr.two_pi * v)
    return mi.Vector3f(r * cos_phi, r * sin_phi, z)


def square_to_tent(sample: mi.Point2f) -> mi.Point2f:
    """Warp to the tent p(x, y) = p1(x) p1(y) with p1(t) = 1 - |t|, on [-1, 1]^2.

    Both coordinates are alike and independent. On the left, P1(t) is the integral of 1 + s over
    s from -1 to t, which is (1 + t)^2 / 2; on the right it is 1 - (1 - t)^2 / 2. They meet at
    P1(0) = 1/2, so P1(t) = u gives

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
    """Density (1 - |x|) (1 - |y|) per unit area at `p`; 0 outside of [-1, 1]^2.

    Example:
        >>> float(square_to_tent_pdf(mi.Point2f(-0.5, 0.0))[0])
        0.5
    """
    height = dr.maximum(1 - dr.abs(vector("p", p, 2)), 0)
    return height.x * height.y


def square_to_uniform_disk(sample: mi.Point2f) -> mi.Point2f:
    """Warp to the uniform density 1/pi on the unit disk.

    In polar coordinates an area element is r dr dphi, so the density of (r, phi) is r / pi: of phi
    1 / (2 pi), and of r 2 r with P(r) = r^2. Hence

        r = sqrt(u),    phi = 2 pi v

    With r = u instead, points would crowd at the centre.

    Example:
        >>> square_to_uniform_disk(mi.Point2f(0.25, 0.0))
        [[0.5, 0]]
    """
    u, v = unit_square(sample)
    p = cylindrical(dr.sqrt(u), v, mi.Float(0))
    return mi.Point2f(p.x, p.y)


def square_to_uniform_disk_pdf(p: mi.Point2f) -> mi.Float:
    """Density 1/pi per unit area on the unit disk, 0 outside.

    The disk ends a few roundings after 1, because points that are meant to be on the circle do.

    Example:
        >>> round(float(square_to_uniform_disk_pdf(mi.Point2f(0.6, 0.8))[0]), 4)
        0.3183
    """
    p = vector("p", p, 2)
    return dr.select(dr.squared_norm(p) <= 1 + 8 * dr.epsilon(p), dr.inv_pi, mi.Float(0))


def square_to_uniform_sphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to the uniform density 1 / (4 pi) on the unit sphere.

    A solid angle is sin(theta) dtheta dphi = dz dphi up to its sign, with z = cos(theta)
    (Archimedes' hat-box theorem). The density of z is thus constant, 1/2 on [-1, 1], and the chance
    to lie above z is (1 - z) / 2. Set it to u:

        z = 1 - 2 u,    r = sqrt(1 - z^2) = 2 sqrt(u (1 - u)),    phi = 2 pi v

    The last form of r loses no digits at the poles, where z^2 is nearly 1.

    Example:
        >>> square_to_uniform_sphere(mi.Point2f(0.5, 0.0))
        [[1, 0, 0]]
    """
    u, v = unit_square(sample)
    return cylindrical(2 * dr.sqrt(u * (1 - u)), v, 1 - 2 * u)


def square_to_uniform_sphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Density 1 / (4 pi) [1/sr] in the direction of the unit vector `v`.

    Example:
        >>> round(float(square_to_uniform_sphere_pdf(mi.Vector3f(0, 0, -1))[0]), 4)
        0.0796
    """
    return dr.full(mi.Float, dr.inv_four_pi, dr.width(vector("v", v)))


def square_to_uniform_hemisphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to the uniform density 1 / (2 pi) on the hemisphere around +z.

    As on the sphere the density of z = cos(theta) is constant, here 1 on [0, 1], and the chance to
    lie above z is 1 - z. Set it to u:

        z = 1 - u,    r = sqrt(1 - z^2) = sqrt(u (2 - u)),    phi = 2 pi v

    Example:
        >>> square_to_uniform_hemisphere(mi.Point2f(0.0, 0.0))
        [[0, 0, 1]]
    """
    u, v = unit_square(sample)
    return cylindrical(dr.sqrt(u * (2 - u)), v, 1 - u)


def square_to_uniform_hemisphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Density 1 / (2 pi) [1/sr] at the unit vector `v`, 0 below the horizon.

    Example:
        >>> round(float(square_to_uniform_hemisphere_pdf(mi.Vector3f(0, 0, 1))[0]), 4)
        0.1592
    """
    return dr.select(vector("v", v).z >= 0, dr.inv_two_pi, mi.Float(0))


def square_to_cosine_hemisphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to the density cos(theta) / pi on the hemisphere around +z.

    With dω = sin(theta) dtheta dphi the density of theta is 2 sin(theta) cos(theta), the derivative
    of P(theta) = sin(theta)^2. Set it to u:

        r = sin(theta) = sqrt(u),    z = cos(theta) = sqrt(1 - u),    phi = 2 pi v

    Seen from above these are the uniform points of the disk: the cosine is what a patch of the
    hemisphere loses when it is projected onto the ground (Malley's method).

    Example:
        >>> square_to_cosine_hemisphere(mi.Point2f(0.0, 0.0))
        [[0, 0, 1]]
    """
    u, v = unit_square(sample)
    return cylindrical(dr.sqrt(u), v, dr.sqrt(1 - u))


def square_to_cosine_hemisphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Density z / pi [1/sr] at the unit vector `v`, 0 below the horizon.

    Example:
        >>> pdf = square_to_cosine_hemisphere_pdf(mi.Vector3f(0.6, 0, mi.Float(0.8, -0.8)))
        >>> [round(float(each), 4) for each in pdf]
        [0.2546, 0.0]
    """
    return dr.maximum(vector("v", v).z, 0) * dr.inv_pi


def square_to_beckmann(sample: mi.Point2f, alpha: float | mi.Float) -> mi.Vector3f:
    """Warp to the Beckmann density of microfacet normals, weighted with their projected area.

        p(m) = D(m) cos(theta) = exp(-tan(theta)^2 / alpha^2) / (pi alpha^2 cos(theta)^3)

    With dω = sin(theta) dtheta dphi the density of phi is 1 / (2 pi). For theta substitute
    t = tan(theta)^2, dt = 2 sin(theta) / cos(theta)^3 dtheta: all cosines cancel and
    exp(-t / alpha^2) / alpha^2 is left, with P(t) = 1 - exp(-t / alpha^2). Set it to u:

        t = tan(theta)^2 = -alpha^2 ln(1 - u),    phi = 2 pi v
        cos(theta) = 1 / sqrt(1 + t),    sin(theta) = sqrt(t) cos(theta)

    In this form sin(theta) has all its digits when alpha is small; 1 - cos(theta)^2 would not.
    The logarithm is cut where u = 1, at the last number below 1.

    Args:
        sample: Point (u, v) of the unit square.
        alpha: Roughness, the standard deviation of the surface's slopes times sqrt(2); from 1e-6
            to 1e6, other numbers raise a ValueError. A number or a Dr.Jit float.

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
    """Density exp(-tan(theta)^2 / alpha^2) / (pi alpha^2 cos(theta)^3) [1/sr] at the normal `m`.

    At the horizon and below it is 0. The tangent comes from x and y: from z alone, 1 - z^2 would
    lose all digits near the pole, where all normals of a smooth surface are. `alpha` is the
    roughness, as in `square_to_beckmann`.

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
    above = (m.z > 0) & (falloff > 0)  # falloff / z^3 would be 0 / 0 at the horizon
    return dr.select(above, normalization * falloff * dr.square(inv_z) * inv_z, 0)
