"""Problem a1.sphere_and_hemispheres: uniform and cosine-weighted directions.

Directions are unit vectors; the pole is +z, theta is the angle to it. Densities are per solid
angle [1/sr]. A hemisphere's density is 0 below the horizon (z < 0), never negative.
"""

from __future__ import annotations

import mitsuba as mi


def square_to_uniform_sphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to a constant density on the unit sphere.

    Args:
        sample: Uniform points (u, v) of the unit square, each number in [0, 1).

    Returns:
        Unit vectors.
    """
    raise NotImplementedError("a1.sphere_and_hemispheres: square_to_uniform_sphere")


def square_to_uniform_sphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Density of `square_to_uniform_sphere` [1/sr] at the unit vectors `v`."""
    raise NotImplementedError("a1.sphere_and_hemispheres: square_to_uniform_sphere_pdf")


def square_to_uniform_hemisphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to a constant density on the hemisphere z >= 0.

    Args:
        sample: Uniform points (u, v) of the unit square, each number in [0, 1).

    Returns:
        Unit vectors with z >= 0.
    """
    raise NotImplementedError("a1.sphere_and_hemispheres: square_to_uniform_hemisphere")


def square_to_uniform_hemisphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Density of `square_to_uniform_hemisphere` [1/sr] at the unit vectors `v`; 0 for z < 0."""
    raise NotImplementedError("a1.sphere_and_hemispheres: square_to_uniform_hemisphere_pdf")


def square_to_cosine_hemisphere(sample: mi.Point2f) -> mi.Vector3f:
    """Warp to the density cos(theta) / pi on the hemisphere z >= 0.

    Args:
        sample: Uniform points (u, v) of the unit square, each number in [0, 1).

    Returns:
        Unit vectors with z >= 0.
    """
    raise NotImplementedError("a1.sphere_and_hemispheres: square_to_cosine_hemisphere")


def square_to_cosine_hemisphere_pdf(v: mi.Vector3f) -> mi.Float:
    """Density of `square_to_cosine_hemisphere` [1/sr] at the unit vectors `v`; 0 for z < 0."""
    raise NotImplementedError("a1.sphere_and_hemispheres: square_to_cosine_hemisphere_pdf")
