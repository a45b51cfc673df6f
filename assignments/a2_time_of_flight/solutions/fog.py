"""Fog by means over bins and van de Hulst's formula for directions; polarizers by matrices."""

from __future__ import annotations

import numpy as np


def absorb(
    transient_data: np.ndarray, mu_a: float, start_opl: float, bin_width_opl: float
) -> np.ndarray:
    """exp(-x) at the bin's center, times the mean of exp over the offsets from the center."""
    center = start_opl + (np.arange(np.shape(transient_data)[2]) + 0.5) * bin_width_opl
    half = mu_a * bin_width_opl / 2
    around = np.sinh(half) / half if half > 1e-6 else 1.0
    return np.einsum("yxtc,t->yxtc", transient_data, around * np.exp(-mu_a * center))


def sample_turn(xi: np.ndarray, g: float) -> np.ndarray:
    """The inverse of the cdf, without a division by g."""
    u = 2 * np.asarray(xi, float) - 1
    below = 1 + g * u
    return np.clip((u + g * (u * u + 3) / 2 + g * g * u + g**3 * (u * u - 1) / 2) / below**2, -1, 1)


def wander(
    random: np.random.Generator, mu_s: float, g: float, opl: float, count: int
) -> np.ndarray:
    """Steps of all photons together, until each has gone its way."""
    x = np.zeros((3, count))
    d = np.zeros((3, count))
    d[2] = 1
    gone = np.zeros(count)
    while gone.min() < opl:
        xi = random.random((3, count))
        free = -np.log1p(-xi[0]) / mu_s if mu_s > 0 else np.full(count, np.inf)
        step = np.minimum(free, opl - gone)
        x += step * d
        gone = np.where(free < opl - gone, gone + step, opl)
        d = rotated(d, sample_turn(xi[1], g), 2 * np.pi * xi[2])
    return x.T


def rotated(d, cosine, azimuth):
    """Directions, turned by an angle at an azimuth."""
    sine = np.sqrt(1 - cosine**2)
    across = np.sqrt(np.maximum(1 - d[2] ** 2, 0))
    along_z = across < 1e-6
    safe = np.where(along_z, 1, across)
    a = np.cos(azimuth) * sine
    b = np.sin(azimuth) * sine
    new = np.array(
        [
            (d[0] * d[2] * a - d[1] * b) / safe + d[0] * cosine,
            (d[1] * d[2] * a + d[0] * b) / safe + d[1] * cosine,
            -across * a + d[2] * cosine,
        ]
    )
    new = np.where(along_z, np.array([a, b, np.sign(d[2]) * cosine]), new)
    return new / np.linalg.norm(new, axis=0)


def through_polarizer(stokes: np.ndarray, angle: float) -> np.ndarray:
    """Turn to the axis, pass, turn back."""
    passes = np.zeros((4, 4))
    passes[:2, :2] = 0.5
    matrix = turn(-angle) @ passes @ turn(angle)
    return np.asarray(stokes, float) @ matrix.T


def turn(angle):
    """Mueller matrix from the frame to one that is turned by an angle."""
    c, s = np.cos(2 * angle), np.sin(2 * angle)
    return np.array([[1, 0, 0, 0], [0, c, s, 0], [0, -s, c, 0], [0, 0, 0, 1]])
