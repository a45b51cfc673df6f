"""A ball over the plane z = 0, in NumPy alone: its light from a point, and the sky it hides.

Lengths are in meters. Nothing here knows the renderer.
"""

import math

import numpy as np

POSITION, ENERGY = np.array([1.2, -0.7, 3.0]), 50.0
CENTER, RADIUS = np.array([0.2, 0.1, 0.9]), 0.6
EYE = np.array([-1.5, -1.0, 3.5])


def meets_ball(origin: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Distance along unit vectors to the ball, infinity if they miss it; shape (n,)."""
    to = origin - CENTER
    b = np.sum(to * way, axis=-1)
    root = b**2 - np.sum(to * to, axis=-1) + RADIUS**2
    t = -b - np.sqrt(np.maximum(root, 0))
    return np.where((root > 0) & (t > 1e-6), t, np.inf)


def formula(way: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """L / energy and OPL of the ball on the plane z = 0 along rays from EYE, and how sure V is."""
    down = np.where(way[:, 2] < 0, -EYE[2] / np.minimum(way[:, 2], -1e-9), np.inf)
    to_ball = meets_ball(EYE, way)
    t = np.minimum(down, to_ball)
    x = EYE + t[:, None] * way
    normal = np.where((to_ball < down)[:, None], (x - CENTER) / RADIUS, [0.0, 0.0, 1.0])
    to_light = POSITION - x
    d = np.linalg.norm(to_light, axis=1)
    to_light /= d[:, None]
    cosine = np.maximum(0, np.sum(normal * to_light, axis=1))
    blocked = np.isfinite(meets_ball(x + 1e-4 * normal, to_light))
    # How far the connection passes the ball's rim
    along = np.sum((CENTER - x) * to_light, axis=1)
    rim = np.abs(np.linalg.norm(x + along[:, None] * to_light - CENTER, axis=1) - RADIUS)
    grazing = (rim < 1e-3) & (to_ball >= down)
    return np.where(blocked, 0, cosine) / (4 * math.pi**2 * d**2), t + d, ~grazing


def spread(n: int) -> np.ndarray:
    """Unit vectors from EYE to a square of the plane around the ball, (n², 3)."""
    u = np.linspace(-2.0, 2.0, n) + 0.013
    x, y = np.meshgrid(u, u)
    way = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) - EYE
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def occluded(x: np.ndarray) -> float:
    """Share of a plane point's sky that the ball hides, the ball all above the plane.

    Directions to the ball fill a cone of half-angle a, sin a = r / D, around the direction to its
    center, at theta from the normal. The integral of w over the cone is, by symmetry, along the
    axis: 2 pi times that of cos t sin t from 0 to a, pi sin² a. So that of w · n / pi is
    sin² a cos theta, if the cone is above the horizon.
    """
    to = CENTER - x
    distance = float(np.linalg.norm(to))
    assert CENTER[2] > RADIUS
    return (RADIUS / distance) ** 2 * to[2] / distance
