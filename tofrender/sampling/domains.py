"""Domains of the chi-square test: where points lie, and the plane in which they are counted.

A domain maps points to two coordinates (a, b) in a rectangle, and back. On spheres these are the
azimuth phi and the angle theta to the pole, not z = cos(theta): close to the pole, where a narrow
density has all of its points, single precision tells angles apart but not cosines. Coordinates are
worked out in double precision from the points as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks

TOLERANCE = 1e-5
"""How far rounding may carry a point out of its domain, relative to the domain's size."""


@dataclass(frozen=True)
class Domain:
    """Where points lie and how they are counted; all arrays are float64.

    Attributes:
        labels: Names and units of the coordinates a and b.
        low: Smallest a and b.
        high: Largest a and b.
        aspect: Columns of cells for each row.
        to_plane: Points (dimensions, n) to coordinates (2, n).
        to_points: Coordinates (2, n) to points (dimensions, n).
        area: Area, or solid angle, around a point for each da db, from coordinates (2, n).
        contains: Which of the points (dimensions, n) are in the domain, but for rounding.
        jumps: Values of b where cells have to end, because densities may jump there.
        upper_only: Whether points are directions above the horizon.
        down: Whether b is drawn downwards, as the rows of an image are.
    """

    labels: tuple[str, str]
    low: tuple[float, float]
    high: tuple[float, float]
    aspect: float
    to_plane: Callable[[np.ndarray], np.ndarray]
    to_points: Callable[[np.ndarray], np.ndarray]
    area: Callable[[np.ndarray], np.ndarray]
    contains: Callable[[np.ndarray], np.ndarray]
    jumps: tuple[float, ...] = ()
    upper_only: bool = False
    down: bool = False

    @property
    def dimensions(self) -> int:
        """Coordinates of a point: 2 in the plane, 3 on the sphere."""
        return self.to_points(np.zeros((2, 1))).shape[0]


def rectangle(low: tuple[float, float], high: tuple[float, float], *, down: bool = False) -> Domain:
    """The rectangle between two corners in the plane; with `down`, drawn with y downwards.

    Example:
        >>> rectangle((0, 0), (1, 1)).contains(np.array([[0.5, 2.0], [0.5, 0.5]]))
        array([ True, False])
    """
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
    """All directions; with `upper_only`, points below the horizon are an error.

    Densities are looked at on the whole sphere, so one that is not 0 down there is found as well.
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
    return np.stack([np.arctan2(v[1], v[0]), np.arctan2(np.hypot(v[0], v[1]), v[2])])


def _to_directions(p: np.ndarray) -> np.ndarray:
    phi, theta = p
    r = np.sin(theta)
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.cos(theta)])


DOMAINS: dict[str, Callable[[], Domain]] = {
    "square": lambda: rectangle((0.0, 0.0), (1.0, 1.0)),
    "image": lambda: rectangle((0.0, 0.0), (1.0, 1.0), down=True),
    "plane": lambda: rectangle((-1.0, -1.0), (1.0, 1.0)),
    "disk": lambda: rectangle((-1.0, -1.0), (1.0, 1.0)),
    "sphere": sphere,
    "hemisphere": lambda: sphere(upper_only=True),
}
"""Domains by name: the unit square and [-1, 1]^2, each under two names; all directions, or half."""


def find(domain: Any) -> Domain:
    """The domain of that name, or the one that stands for an object of `mi.chi2`.

    Args:
        domain: A name in `DOMAINS`, a `Domain`, `mi.chi2.SphericalDomain()` or
            `mi.chi2.PlanarDomain(bounds)`.

    Raises:
        ValueError: It is none of these.

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
    return DOMAINS[checks.one_of("domain", domain, DOMAINS)]()


def to_drjit(points: np.ndarray) -> Any:
    """Points (dimensions, n) as `mi.Point2f` or `mi.Vector3f`."""
    kind = mi.Point2f if points.shape[0] == 2 else mi.Vector3f
    return kind(points)


def to_numpy(points: Any, count: int) -> np.ndarray:
    """Dr.Jit points as float64 of shape (dimensions, count); a single one is repeated.

    Example:
        >>> to_numpy(mi.Point2f(0.5, [1, 2]), 2)
        array([[0.5, 0.5],
               [1. , 2. ]])
    """
    dr.eval(points)
    rows = [np.asarray(mi.Float(each), dtype=np.float64) for each in points]
    return np.stack([np.broadcast_to(row, (count,)) for row in rows])
