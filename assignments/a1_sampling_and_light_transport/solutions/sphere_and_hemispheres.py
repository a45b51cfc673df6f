"""Directions from the disk: an equal-area map from circles of the disk to circles of latitude."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def _polar(sample: mi.Point2f) -> tuple[mi.Float, mi.Point2f]:
    """Squared radius and unit direction of a point of the disk; here the first number turns."""
    sine, cosine = dr.sincos(dr.two_pi * sample.x)
    return sample.y, mi.Point2f(cosine, sine)


def _lifted(height: float, sample: mi.Point2f) -> mi.Vector3f:
    """Lambert's map onto the cap z >= 1 - height: 1 - z = height r^2."""
    r2, out = _polar(sample)
    below = height * r2
    across = dr.sqrt(below * (2 - below))
    return mi.Vector3f(across * out.x, across * out.y, 1 - below)


def square_to_uniform_sphere(sample: mi.Point2f) -> mi.Vector3f:
    """The cap of height 2."""
    return _lifted(2.0, sample)


def square_to_uniform_sphere_pdf(v: mi.Vector3f) -> mi.Float:
    """One over the sphere's area."""
    return mi.Float(0.25 / dr.pi) + 0 * v.z


def square_to_uniform_hemisphere(sample: mi.Point2f) -> mi.Vector3f:
    """The cap of height 1."""
    return _lifted(1.0, sample)


def square_to_uniform_hemisphere_pdf(v: mi.Vector3f) -> mi.Float:
    """One over the hemisphere's area."""
    return dr.select(v.z < 0, mi.Float(0), 0.5 / dr.pi)


def square_to_cosine_hemisphere(sample: mi.Point2f) -> mi.Vector3f:
    """The direction halfway between +z and a uniform point of the sphere.

    The angle at the circumference is half of the angle at the center: theta / 2 of a uniform sphere
    has the density 2 sin cos, because 1 - cos(2 t) = 2 sin(t)^2.
    """
    half = _lifted(2.0, sample) + mi.Vector3f(0, 0, 1)
    length = dr.norm(half)
    return dr.select(length > 0, half / length, mi.Vector3f(1, 0, 0))


def square_to_cosine_hemisphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Cosine over pi, above the horizon."""
    return dr.select(v.z > 0, v.z / dr.pi, 0)
