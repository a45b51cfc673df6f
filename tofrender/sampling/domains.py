"""Domains of the chi-square test, and the plane in which their points are counted.

A domain maps points to two coordinates (a, b) in a rectangle, and back. On spheres, these are the
azimuth phi and the angle theta to the pole. theta is used instead of z = cos(theta), because narrow
densities have all their points near the pole, where single precision distinguishes angles but not
cosines. Coordinates are computed from the points in double precision.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks

# Distance by which rounding may move a point out of its domain, relative to the domain's size
TOLERANCE = 1e-5

Map = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Domain:
    """A set of points (dimensions, n), and their coordinates (2, n). All arrays are float64."""

    # Names and units of the coordinates a and b
    labels: tuple[str, str]

    # Smallest and largest a and b
    low: tuple[float, float]
    high: tuple[float, float]

    # Number of columns of cells for each row
    aspect: float

    # Conversion of points to coordinates, and of coordinates to points
    to_plane: Map
    to_points: Map

    # Area or solid angle per da db, as a function of coordinates
    area: Map

    # Mask of the points in the domain, with a tolerance for rounding
    contains: Map

    # Values of b at which densities may be discontinuous, so that cells end there
    jumps: tuple[float, ...] = ()

    # Whether only directions above the horizon are valid
    upper_only: bool = False

    # Whether b is drawn downwards, like the rows of an image
    down: bool = False

    @property
    def dimensions(self) -> int:
        """Return the number of coordinates of a point: 2 in the plane, 3 on the sphere."""
        return self.to_points(np.zeros((2, 1))).shape[0]


def rectangle(low: tuple[float, float], high: tuple[float, float], *, down: bool = False) -> Domain:
    """Return the rectangle between two corners in the plane. With `down`, y is drawn downwards."""
    corners = np.array([low, high])[..., None]
    margin = TOLERANCE * (corners[1] - corners[0])
    return Domain(
        labels=("x", "y"),
        low=low,
        high=high,
        aspect=1.0,
        to_plane=lambda p: p,
        to_points=lambda p: p,
        area=lambda p: np.ones(p.shape[1]),
        contains=lambda p: np.all((p >= corners[0] - margin) & (p <= corners[1] + margin), axis=0),
        down=down,
    )


def sphere(upper_only: bool = False) -> Domain:
    """Return the unit sphere of directions. With `upper_only`, points below the horizon are errors.

    Densities are integrated over the whole sphere, also with `upper_only`. Therefore a density
    above 0 below the horizon is found as well.
    """
    lowest = 0.0 if upper_only else -1.0
    return Domain(
        labels=("φ [rad]", "θ [rad]"),
        low=(-math.pi, 0.0),
        high=(math.pi, math.pi),
        aspect=0.5,
        to_plane=_to_angles,
        to_points=_to_directions,
        area=lambda p: np.sin(p[1]),
        contains=lambda v: (
            (np.abs(np.sum(v * v, axis=0) - 1) <= TOLERANCE) & (v[2] >= lowest - TOLERANCE)
        ),
        jumps=(math.pi / 2,),
        upper_only=upper_only,
    )


def _to_angles(v: np.ndarray) -> np.ndarray:
    """Convert directions (3, n) to azimuth and polar angle (2, n) [rad]."""
    return np.stack([np.arctan2(v[1], v[0]), np.arctan2(np.hypot(v[0], v[1]), v[2])])


def _to_directions(p: np.ndarray) -> np.ndarray:
    """Convert azimuth and polar angle (2, n) [rad] to directions (3, n)."""
    phi, theta = p
    r = np.sin(theta)
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.cos(theta)])


DOMAINS: dict[str, Domain] = {
    "square": rectangle((0.0, 0.0), (1.0, 1.0)),
    "image": rectangle((0.0, 0.0), (1.0, 1.0), down=True),
    "plane": rectangle((-1.0, -1.0), (1.0, 1.0)),
    "disk": rectangle((-1.0, -1.0), (1.0, 1.0)),
    "sphere": sphere(),
    "hemisphere": sphere(upper_only=True),
}
"""Domains by name. The unit square and [-1, 1]^2 have two names each."""


def find(domain: Any) -> Domain:
    """Return a domain, given by a name in `DOMAINS`, an object of `mi.chi2`, or a `Domain`.

    Example:
        >>> find("disk").low, find(mi.chi2.PlanarDomain(mi.ScalarBoundingBox2f(0, 2))).high
        ((-1.0, -1.0), (2.0, 2.0))
    """
    if isinstance(domain, Domain):
        return domain
    if isinstance(domain, mi.chi2.SphericalDomain):
        return sphere()
    if isinstance(domain, mi.chi2.PlanarDomain):
        box = domain.bounds()
        return rectangle((box.min.x, box.min.y), (box.max.x, box.max.y))
    return DOMAINS[checks.one_of("domain", domain, DOMAINS)]


def to_drjit(points: np.ndarray) -> Any:
    """Convert points (dimensions, n) to `mi.Point2f` or `mi.Vector3f`."""
    return (mi.Point2f if points.shape[0] == 2 else mi.Vector3f)(points)


def to_numpy(points: Any, count: int) -> np.ndarray:
    """Convert Dr.Jit points to float64 (dimensions, count). A single point is repeated.

    Example:
        >>> to_numpy(mi.Point2f(0.5, [1, 2]), 2)
        array([[0.5, 0.5],
               [1. , 2. ]])
    """
    dr.eval(points)
    rows = [np.asarray(mi.Float(each), dtype=np.float64) for each in points]
    return np.stack([np.broadcast_to(row, (count,)) for row in rows])
