"""Rates of change of lengths by NumPy: by finite differences, or by velocities."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

STEP_S = 1e-4  # Time to either side for finite differences; parts move by 0.1 mm/s to 1 m/s here


@dataclass
class Surface:
    """A plane through `point`, or a sphere around it, that reflects or refracts."""

    point: Any  # point of the plane, or center of the sphere
    normal: Any = None  # normal of the plane; None for a sphere
    radius: float = 0.0  # radius of the sphere
    # index of refraction before and behind; None for a mirror
    indices: tuple[float, float] | None = None

    def meet(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the first point of a ray on the surface, and the normal there."""
        if self.normal is not None:
            n = np.asarray(self.normal, float)
            x = o + d * ((self.point - o) @ n / (d @ n))
            return x, n
        b, c = (o - self.point) @ d, (o - self.point) @ (o - self.point) - self.radius**2
        root = np.sqrt(b * b - c)
        x = o + d * (-b - root if -b - root > 1e-9 else -b + root)
        return x, (x - self.point) / self.radius

    def turned(self, d: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Return the direction behind the surface."""
        cosine = d @ n
        if self.indices is None:
            return d - 2 * cosine * n
        η = self.indices[0] / self.indices[1]
        n = n * np.sign(cosine)
        cosine = abs(cosine)
        return η * (d - cosine * n) + np.sqrt(1 - η**2 * (1 - cosine**2)) * n


def follow(o, d, surfaces: list[Surface]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the optical length up to the last surface, the point there, and the direction."""
    o, d, length = np.asarray(o, float), np.asarray(d, float), 0.0
    for each in surfaces:
        x, n = each.meet(o, d)
        length += (each.indices or (1.0,))[0] * np.linalg.norm(x - o)
        o, d = x, each.turned(d, n)
    return length, o, d


def specular_length(a, b, guess, surfaces: list[Surface]) -> float:
    """Return the optical length from a to b over surfaces; `guess` is nearly the direction at a."""
    guess = np.asarray(guess, float)
    across = np.linalg.svd(guess[None])[2][1:]

    def end(turn: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        d = guess + turn @ across
        return follow(a, d / np.linalg.norm(d), surfaces)

    def missed(turn: np.ndarray) -> np.ndarray:
        _, x, d = end(turn)
        return np.cross(b - x, d)

    turn = least_squares(missed, np.zeros(2), xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert np.abs(missed(turn)).max() < 1e-9
    length, x, _ = end(turn)
    behind = surfaces[-1].indices
    return length + (behind[1] if behind else 1.0) * np.linalg.norm(b - x)


def change(length: Callable[[float], float]) -> float:
    """Return the rate of change of a length at the time 0, by central differences."""
    return (length(STEP_S) - length(-STEP_S)) / (2 * STEP_S)


def rate(points, velocities, indices=None) -> float:
    """Return Σ n (v' - v)·d over the segments between material points."""
    x, v = np.array(points, float), np.array(velocities, float)
    d = np.diff(x, axis=0)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    n = np.ones(len(d)) if indices is None else np.asarray(indices, float)
    return float(np.sum(n[:, None] * np.diff(v, axis=0) * d))


def turned(x, axis, angle: float, center=(0, 0, 0)) -> np.ndarray:
    """Return a point after a rotation about an axis through a center (Rodrigues)."""
    k, center = np.asarray(axis, float), np.asarray(center, float)
    k, r = k / np.linalg.norm(k), np.asarray(x, float) - center
    c, s = np.cos(angle), np.sin(angle)
    return center + r * c + np.cross(k, r) * s + k * (k @ r) * (1 - c)
