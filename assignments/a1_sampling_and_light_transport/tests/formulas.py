"""Closed forms that submissions are compared with, in NumPy and double precision."""

from __future__ import annotations

import numpy as np

from tofrender.course.judge.inputs import Inputs

inputs = Inputs(__file__)
LAST = 1 - 2.0**-24
"""The largest number below 1 in single precision."""

CORNERS = np.array([(u, v) for u in (0, 2.0**-24, 0.5, LAST) for v in (0, 0.25, 0.5, LAST)])
"""Samples where formulas break, shape (16, 2)."""


def uniform(count, seed):
    """Random points of the unit square as a sampler gives them, shape (count, 2)."""
    return np.random.default_rng(seed).integers(0, 2**24, (count, 2)) / 2.0**24


def cells(p, low, high, shape):
    """Points in each cell of a box that is divided evenly, shape `shape`."""
    edges = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, shape, strict=True)]
    counts, _ = np.histogramdd(p, edges)
    return counts


def direction(theta, phi):
    """Unit vectors, shape (..., 3), of angles to the pole and around it [rad]."""
    theta, phi = np.broadcast_arrays(theta, phi)
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


def sphere_grid(rows=200, columns=40):
    """Midpoints of a grid of directions, shape (n, 3), and the solid angle [sr] of each cell."""
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    phi = (np.arange(columns) + 0.5) * 2 * np.pi / columns
    v = direction(*np.meshgrid(theta, phi, indexing="ij")).reshape(-1, 3)
    edges = np.cos(np.linspace(0, np.pi, rows + 1))
    return v, np.repeat(edges[:-1] - edges[1:], columns) * 2 * np.pi / columns


def azimuth(v):
    """Angle around the pole as a number from 0 to 1."""
    return np.arctan2(v[:, 1], v[:, 0]) / (2 * np.pi) % 1


# ------------------------------------------------------------------------------------ warps


def tent_pdf(p):
    """(1 - |x|) (1 - |y|)."""
    return np.prod(np.maximum(1 - np.abs(p), 0), axis=1)


def tent_cdf(t):
    """Integral of 1 - |s| over s from -1 to t."""
    return np.where(t < 0, 0.5 * (1 + t) ** 2, 1 - 0.5 * (1 - t) ** 2)


def tent_cells(n):
    """Probability of each cell of an n x n grid on [-1, 1]^2."""
    row = np.diff(tent_cdf(np.linspace(-1, 1, n + 1)))
    return np.outer(row, row)


def beckmann_pdf(m, alpha):
    """Density of microfacet normals, weighted with their projected area [1/sr]."""
    z = np.maximum(m[:, 2], 1e-3)
    tan2 = (m[:, 0] ** 2 + m[:, 1] ** 2) / z**2
    density = np.exp(-tan2 / alpha**2) / (np.pi * alpha**2 * z**3)
    return np.where(m[:, 2] > 0, density, 0)


def beckmann_cells(alpha, n):
    """Edges in theta of n rings, the last to the horizon, and the probability of each ring."""
    last = np.arctan(alpha * np.sqrt(-np.log(1e-3)))
    theta = np.append(np.linspace(0, last, n), np.pi / 2)
    with np.errstate(over="ignore"):
        above = np.exp(-(np.tan(theta) ** 2) / alpha**2)
    above[-1] = 0
    return theta, above[:-1] - above[1:]


# ----------------------------------------------------------------------------------- shapes


def triangle_area(corners):
    """Area of a triangle."""
    a, b, c = np.asarray(corners, float)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a))


def triangle_square(corners, p):
    """Where uniform points of a triangle lie in a square, and their distance from its plane.

    b1, b2 are the coordinates along both edges. (b1 + b2)^2 and b1 / (b1 + b2) are independent
    and uniform.
    """
    a, b, c = np.asarray(corners, float)
    edges = np.stack([b - a, c - a], axis=1)
    b12, *_ = np.linalg.lstsq(edges, (p - a).T, rcond=None)
    beside = np.linalg.norm((p - a).T - edges @ b12, axis=0)
    total = b12.sum(axis=0)
    return np.stack([total**2, b12[0] / np.where(total == 0, 1, total)], axis=1), beside


def patch_pdf(p, o, normal, area):
    """Density [1/sr] seen from o of uniform points p of a flat shape."""
    to_p = p - o
    distance = np.linalg.norm(to_p, axis=1)
    cos = np.abs(to_p @ normal) / distance
    return distance**2 / (area * cos)


def cone_pdf(radius, distance):
    """Density [1/sr] of uniform directions toward a sphere seen from outside."""
    half = 0.5 * np.arcsin(radius / distance)
    return 1 / (4 * np.pi * np.sin(half) ** 2)


def polygon_irradiance(corners, o, normal, radiance):
    """Irradiance at o from a flat polygon that is above the horizon (Lambert 1760)."""
    to = np.asarray(corners, float) - o
    to /= np.linalg.norm(to, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(to, np.roll(to, -1, axis=0), strict=True):
        cross = np.cross(a, b)
        sine = np.linalg.norm(cross)
        total += np.arctan2(sine, a @ b) * (cross @ normal) / sine
    return 0.5 * radiance * abs(total)


def sphere_irradiance(center, radius, o, normal, radiance):
    """Irradiance at o from a sphere that is above the horizon."""
    to_center = np.asarray(center, float) - o
    far = np.linalg.norm(to_center)
    return np.pi * radiance * (radius / far) ** 2 * (to_center @ normal) / far


def disk_irradiance(radius, height, radiance):
    """Irradiance below the middle of a disk that faces the receiver."""
    return np.pi * radiance * radius**2 / (height**2 + radius**2)


# -------------------------------------------------------------------------------- renderers


def integrating_sphere(radius, radiance, albedo, bounces):
    """Radiance of the wall of a diffuse unit sphere around a black ball of `radius` that emits.

    From every point of the wall, weighted with the cosine, the ball covers the part radius^2 of the
    view. So the wall receives pi radiance radius^2 everywhere, and after each reflection the part
    1 - radius^2 of what it reflected: a geometric series. `bounces` is -1 for all of it.
    """
    first = albedo * radiance * radius**2
    ratio = albedo * (1 - radius**2)
    return first / (1 - ratio) * (1 if bounces < 0 else 1 - ratio**bounces)


def ball_in_a_sphere(radius, emission, ball, wall, bounces):
    """Radiances of a ball that emits and reflects, and of the diffuse unit sphere around it.

    As in `integrating_sphere`, the wall sees the ball in the part radius^2 of its view and itself
    in the rest; the ball sees the wall alone.
    """
    of_ball = np.asarray(emission, float)
    of_wall = np.zeros_like(emission, float)
    for _ in range(bounces):
        arriving = radius**2 * of_ball + (1 - radius**2) * of_wall
        of_ball = emission + ball * of_wall
        of_wall = wall * arriving
    return of_ball, of_wall


def point_light(position, energy, x, normal):
    """Radiance of a white diffuse surface at x (n, 3) under a point light of power `energy`."""
    to_light = position - x
    distance = np.linalg.norm(to_light, axis=1)
    cos = np.maximum(np.sum(to_light * normal, axis=1), 0) / distance
    return energy / (4 * np.pi**2) * cos / distance**2


def wall_openness(height, distance):
    """Ambient occlusion on the ground next to an infinitely long wall."""
    return 0.5 * (1 + np.cos(np.arctan2(height, distance)))


def camera_rays(origin, target, fov_degrees, width, height):
    """Unit directions through the pixels' middles, shape (height, width, 3), rows from the top.

    The pinhole camera has y up. Its field of view refers to the smaller side.
    """
    forward = np.subtract(target, origin)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    scale = 2 * np.tan(np.radians(fov_degrees) / 2) / min(width, height)
    x = scale * (np.arange(width) + 0.5 - width / 2)
    y = scale * (height / 2 - np.arange(height) - 0.5)
    d = forward + x[None, :, None] * right + y[:, None, None] * up
    return d / np.linalg.norm(d, axis=-1, keepdims=True)
