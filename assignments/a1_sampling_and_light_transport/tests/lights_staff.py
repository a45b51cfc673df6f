"""Random lights, and the visible points of them, in NumPy and double precision."""

from __future__ import annotations

import drawn_staff as drawn
import formulas
import numpy as np


def triangle(random, towards, *, emission=None):
    """A triangle of about the size 1 around a point, which emits toward the origin."""
    x, y = _across(towards)
    size = random.uniform(0.5, 1.2, 3)
    turn = random.uniform(0, 2 * np.pi)
    phi = turn + 2 * np.pi / 3 * (np.arange(3) + random.uniform(-0.2, 0.2, 3))
    lift = random.uniform(-0.3, 0.3, (3, 1)) * towards / np.linalg.norm(towards)
    corners = towards + (size * np.cos(phi))[:, None] * x + (size * np.sin(phi))[:, None] * y + lift
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    if normal @ towards > 0:
        corners = corners[[0, 2, 1]]
    return ["Triangle", [*corners.tolist(), color(random) if emission is None else emission], {}]


def sphere(random, center, radius):
    """A sphere."""
    return ["Sphere", [np.asarray(center).tolist(), float(radius), color(random)], {}]


def color(random):
    """Three different radiances."""
    return (random.permutation([1.0, 2.5, 5.0]) * random.uniform(0.6, 1.5)).tolist()


def around(random, count, least=2.2, most=4.0):
    """Points in directions that are far from each other, shape (count, 3)."""
    while True:
        d = drawn.directions(random, count)
        if np.max(d @ d.T - 2 * np.eye(count)) < 0.2:
            return d * random.uniform(least, most, (count, 1))


def turn(random):
    """A rotation, shape (3, 3)."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def _across(axis):
    """Two unit vectors at right angles to an axis and to each other."""
    axis = axis / np.linalg.norm(axis)
    x = np.cross(axis, [0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return x, np.cross(axis, x)


def seen(light, o, v):
    """Visible points of a light from o (n, 3) along unit vectors v (n, 3).

    Returns:
        `distance` (infinite for misses), `n`, `radiance` (n, 3), `pdf`, and `clear`: whether
        rounding cannot change the answer.
    """
    kind, arguments, _ = light
    if kind == "SurfaceGroup":
        return _nearest([seen(each, o, v) for each in arguments])
    shape = _triangle if kind == "Triangle" else _sphere
    distance, n, pdf, clear = shape(arguments, o, v)
    hit = np.isfinite(distance)
    bright = (hit & (np.sum(n * v, axis=1) < 0))[:, None]
    radiance = np.where(bright, np.broadcast_to(arguments[-1], v.shape), 0)
    pdf = np.where(hit, pdf, 0)
    return {"distance": distance, "n": n, "radiance": radiance, "pdf": pdf, "clear": clear}


def _nearest(each):
    first = np.argmin([one["distance"] for one in each], axis=0)
    lane = np.arange(len(first))
    found = {
        name: np.stack([one[name] for one in each])[first, lane]
        for name in ("distance", "n", "radiance")
    }
    found["pdf"] = np.mean([one["pdf"] for one in each], axis=0)
    return found | {"clear": np.all([one["clear"] for one in each], axis=0)}


def _triangle(arguments, o, v):
    corners = np.array(arguments[:3])
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    area = 0.5 * np.linalg.norm(normal)
    normal /= 2 * area
    cos = v @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (corners[0] - o) @ normal / cos
    t = np.where(np.isfinite(t), t, -1)
    p = o + t[:, None] * v
    edges = [np.cross(corners[(i + 1) % 3] - corners[i], p - corners[i]) @ normal for i in range(3)]
    within = np.min(edges, axis=0)
    hit = (t > 0) & (within >= 0)
    pdf = t**2 / (area * np.maximum(np.abs(cos), 1e-9))
    clear = (np.abs(within) > 0.01) & (np.abs(cos) > 0.02) & (np.abs(t) > 0.01)
    clear |= (within < -0.01) & (np.abs(cos) > 0.02)
    return np.where(hit, t, np.inf), np.broadcast_to(normal, v.shape), pdf, clear


def _sphere(arguments, o, v):
    center = np.array(arguments[0])
    radius = arguments[1]
    to = center - o
    far = np.linalg.norm(to, axis=1)
    ahead = np.sum(to * v, axis=1)
    chord2 = radius**2 - np.sum((to - ahead[:, None] * v) ** 2, axis=1)
    half = np.sqrt(np.maximum(chord2, 0))
    outside = far > radius
    t = np.where(outside, ahead - half, ahead + half)
    hit = (chord2 >= 0) & (t > 0)
    n = (o + t[:, None] * v - center) / radius
    quotient = np.minimum(radius / far, 1)
    pdf = np.where(outside, formulas.cone_pdf(quotient, 1.0), 0.25 / np.pi)
    clear = np.abs(chord2) > 0.02 * radius**2
    return np.where(hit, t, np.inf), n, pdf, clear
