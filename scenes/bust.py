"""A head-and-shoulders bust on a round foot, made of ellipses and smooth bumps.

The body is a stack of horizontal cross sections. Each section consists of two half ellipses with
the same width, one to the front and one to the back. Smooth curves through `PROFILE` give the width
and the depths of each section. `FEATURES` push the surface in or out to form nose, eyes and mouth.
Finally the head is rotated slightly to its left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROWS, COLUMNS = 100, 96

# Height, half-width, reach to the front, reach to the back [m]
PROFILE = np.array(
    [
        (0.000, 0.092, 0.092, 0.092),  # foot
        (0.006, 0.099, 0.099, 0.099),
        (0.018, 0.102, 0.102, 0.102),
        (0.026, 0.088, 0.088, 0.088),
        (0.050, 0.056, 0.056, 0.056),
        (0.078, 0.052, 0.052, 0.052),
        (0.088, 0.062, 0.062, 0.062),
        (0.098, 0.064, 0.062, 0.062),
        (0.112, 0.090, 0.072, 0.066),  # chest
        (0.150, 0.145, 0.098, 0.080),
        (0.200, 0.196, 0.118, 0.092),
        (0.250, 0.214, 0.118, 0.098),
        (0.285, 0.205, 0.104, 0.097),  # shoulders
        (0.312, 0.160, 0.084, 0.090),
        (0.334, 0.100, 0.064, 0.080),
        (0.356, 0.066, 0.050, 0.070),  # neck
        (0.389, 0.056, 0.046, 0.064),
        (0.408, 0.057, 0.056, 0.066),
        (0.418, 0.056, 0.080, 0.068),  # chin
        (0.430, 0.059, 0.090, 0.072),
        (0.454, 0.066, 0.093, 0.082),  # mouth
        (0.484, 0.071, 0.094, 0.094),
        (0.514, 0.075, 0.096, 0.103),  # eyes
        (0.544, 0.077, 0.098, 0.108),
        (0.574, 0.077, 0.096, 0.108),
        (0.604, 0.072, 0.086, 0.100),
        (0.629, 0.060, 0.068, 0.084),
        (0.646, 0.043, 0.047, 0.060),
        (0.656, 0.024, 0.026, 0.032),
        (0.660, 0.006, 0.006, 0.008),  # crown
    ]
)

# Bumps on the front of the head: x, height, half-width, half-height, push along z [m]. A bump with
# x other than 0 is mirrored to -x.
FEATURES = np.array(
    [
        (0.000, 0.520, 0.0070, 0.024, 0.011),  # bridge of the nose
        (0.000, 0.496, 0.0095, 0.014, 0.018),  # nose
        (0.000, 0.486, 0.0110, 0.008, 0.011),  # its tip
        (0.013, 0.483, 0.0065, 0.006, 0.008),  # nostrils
        (0.029, 0.544, 0.0200, 0.007, 0.009),  # brows
        (0.029, 0.523, 0.0170, 0.011, -0.018),  # eye sockets
        (0.029, 0.521, 0.0110, 0.007, 0.014),  # eyes
        (0.029, 0.5295, 0.0130, 0.0035, 0.004),  # upper lids
        (0.029, 0.5130, 0.0120, 0.0035, 0.002),  # lower lids
        (0.040, 0.496, 0.0160, 0.014, 0.006),  # cheekbones
        (0.040, 0.464, 0.0150, 0.016, -0.006),  # cheeks
        (0.000, 0.4690, 0.0170, 0.0050, 0.0060),  # upper lip
        (0.000, 0.4620, 0.0230, 0.0036, -0.0050),  # mouth
        (0.000, 0.4550, 0.0150, 0.0052, 0.0060),  # lower lip
        (0.000, 0.4460, 0.0160, 0.0050, -0.0050),  # hollow under it
        (0.000, 0.4310, 0.0160, 0.0100, 0.0070),  # chin
    ]
)

TURN = np.deg2rad(18.0)
"""Rotation of the head to its left [rad]."""


def bust() -> tuple[Array, NDArray[np.int64], Array]:
    """Return the bust as a closed triangle mesh, 0.67 m tall, that looks along +z.

    Returns:
        vertices: Positions [m], shape (v, 3); the foot is at y = 0.
        faces: Vertex indices of the triangles, counter-clockwise from outside, shape (f, 3).
        normals: Unit normals of the smooth surface at the vertices, outwards, shape (v, 3).
    """
    height = _rows()
    azimuth = _azimuths()
    grid = _features(_body(height, azimuth))
    poles = grid[[0, -1]].mean(axis=1)
    vertices = _rotate_head(np.concatenate([grid.reshape(-1, 3), poles]))
    faces = _faces()
    return vertices, faces, _normals(vertices, faces)


def _rows() -> Array:
    """Return the heights of the cross sections [m]; about two thirds of them are in the head."""
    foot = np.linspace(0.0, 0.112, 18, endpoint=False)
    chest = np.linspace(0.112, 0.395, 18, endpoint=False)
    head = np.linspace(0.395, 0.629, 52, endpoint=False)
    crown = 0.629 + 0.031 * np.sin(np.linspace(0.0, np.pi / 2, 12))
    return np.concatenate([foot, chest, head, crown])


def _azimuths() -> Array:
    """Return angles about the vertical, from +z towards +x [rad], densely spaced at the face."""
    uniform = np.arange(COLUMNS) * (2 * np.pi / COLUMNS)
    return uniform - 0.5 * np.sin(uniform)


def _body(height: Array, azimuth: Array) -> Array:
    """Return the points of the body without features [m], shape (rows, columns, 3)."""
    width, front, back = (_curve(height, PROFILE[:, i])[:, None] for i in (1, 2, 3))
    sine = np.sin(azimuth)
    cosine = np.cos(azimuth)
    x = width * sine
    z = np.where(cosine > 0, front, back) * cosine
    return np.stack([x, np.broadcast_to(height[:, None], x.shape), z], axis=-1)


def _curve(height: Array, values: Array) -> Array:
    """Interpolate a column of the profile smoothly without overshoot (Fritsch, Butland 1984)."""
    # Slopes of the segments
    knots = PROFILE[:, 0]
    step = np.diff(knots)
    slope = np.diff(values) / step
    tangent = np.zeros_like(values)

    # Tangents at the knots: a weighted harmonic mean of the slopes, 0 at extrema
    rising = slope[:-1] * slope[1:] > 0
    before = step[:-1] + 2 * step[1:]
    after = 2 * step[:-1] + step[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (before + after) / (before / slope[:-1] + after / slope[1:])
    tangent[1:-1] = np.where(rising, mean, 0.0)
    tangent[0] = slope[0]
    tangent[-1] = slope[-1]

    # Cubic Hermite interpolation
    i = np.clip(np.searchsorted(knots, height, side="right") - 1, 0, len(step) - 1)
    t = (height - knots[i]) / step[i]
    return (
        values[i] * (1 + 2 * t) * (1 - t) ** 2
        + values[i + 1] * t**2 * (3 - 2 * t)
        + step[i] * (tangent[i] * t * (1 - t) ** 2 - tangent[i + 1] * t**2 * (1 - t))
    )


def _features(grid: Array) -> Array:
    """Return the points of the body after face, hair, ears and collarbones are added."""
    x, y, z = np.moveaxis(grid, -1, 0).copy()

    # Face
    front = _step(z, 0.0, 0.04)
    push = np.zeros_like(z)
    for x0, y0, half_width, half_height, depth in FEATURES:
        for side in {x0, -x0}:
            push += depth * _bump(x - side, half_width) * _bump(y - y0, half_height)

    # Hair: a cap behind the hairline, with waves from the forehead to the neck
    head = _step(y, 0.372, 0.412)
    hairline = 0.600 - 1.25 * np.maximum(0.045 - z, 0.0) + 0.02 * _bump(x, 0.03)
    hair = head * _step(y - hairline, -0.006, 0.008)
    wave = 0.009 + 0.0022 * np.sin(170.0 * y + 90.0 * np.abs(x) - 40.0 * z)
    outwards = np.stack([x / 0.6, (y - 0.534) * _step(y, 0.534, 0.604), z], axis=-1)
    outwards /= np.linalg.norm(outwards, axis=-1, keepdims=True)

    # Ears
    ears = 0.016 * _bump(z - 0.002, 0.012) * _bump(y - 0.507, 0.020)
    ears -= 0.006 * _bump(z - 0.006, 0.007) * _bump(y - 0.509, 0.011)

    # Collarbones, which rise from the center to the shoulders, and muscles of the chest
    collar = _bump(y - 0.292 - 0.12 * np.abs(x), 0.008) * _step(np.abs(x), 0.008, 0.03)
    chest = _bump(np.abs(x) - 0.075, 0.05) * _bump(y - 0.215, 0.04)
    torso = front * (0.006 * collar + 0.010 * chest)

    # Move the points
    moved = grid + outwards * (hair * wave)[..., None]
    moved[..., 0] += np.sign(x) * ears
    moved[..., 2] += front * push + torso
    return moved


def _bump(distance: Array, half_width: float) -> Array:
    """Return a Gaussian bump of height 1 that falls to 1/e at `half_width`."""
    return np.exp(-((distance / half_width) ** 2))


def _step(value: Array, low: float, high: float) -> Array:
    """Return a smooth step from 0 below `low` to 1 above `high`."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _rotate_head(vertices: Array) -> Array:
    """Rotate the head to its left, with an angle that grows along the neck."""
    x, y, z = vertices.T
    angle = TURN * _step(y, 0.32, 0.44)
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return np.stack([x * cosine + z * sine, y, z * cosine - x * sine], axis=-1)


def _faces() -> NDArray[np.int64]:
    """Return vertex indices of the faces: two triangles for each cell, and a fan at each pole."""
    # Vertex indices of the four corners of each cell
    index = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    a = index[:-1]
    b = np.roll(index, -1, axis=1)[:-1]
    c = np.roll(index, -1, axis=1)[1:]
    d = index[1:]

    # Vertex indices of the poles and of the rings next to them
    bottom = ROWS * COLUMNS
    top = ROWS * COLUMNS + 1
    first = index[0]
    last = index[-1]

    # Diagonals of the left half mirror the diagonals of the right half
    left = np.arange(COLUMNS) < COLUMNS // 2
    parts = [
        np.stack([a, b, np.where(left, d, c)], axis=-1),
        np.stack([np.where(left, b, a), c, d], axis=-1),
        np.stack([np.full(COLUMNS, bottom), np.roll(first, -1), first], axis=-1),
        np.stack([np.full(COLUMNS, top), last, np.roll(last, -1)], axis=-1),
    ]
    return np.concatenate([part.reshape(-1, 3) for part in parts])


def _normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """Return unit normals at the vertices: means of adjacent triangles, weighted by their areas."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    np.add.at(total, faces.ravel(), np.repeat(cross, 3, axis=0))
    return total / np.linalg.norm(total, axis=-1, keepdims=True)
