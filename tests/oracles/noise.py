"""A scene whose bins are known, and by how many paths: a diffuse sphere, all in its center."""

import numpy as np
from helpers.parts import diffuse, point_light
from helpers.support import camera, film, scene

from oracles.films import sphere_bounce_masses, sphere_bounce_total

RADIUS, ALBEDO, INTENSITY, BOUNCES = 1.0, 0.8, 1.0, 4
BINS, START, WIDTH = 32, 1.9, 0.2


def sphere(pixels: int = 16) -> dict:
    """Light and camera at its center. Each bounce of a path adds the same, whatever its way."""
    ball = {"type": "sphere", "radius": RADIUS, "flip_normals": True, "bsdf": diffuse(ALBEDO)}
    return scene(
        {"ball": ball, "light": point_light((0, 0, 0), INTENSITY)},
        camera((0, 0, 0), (0, 0, 1), film(pixels, pixels, BINS, START, WIDTH), fov=90),
        max_depth=1 + BOUNCES,
        rr_depth=100,
    )


def masses() -> np.ndarray:
    """Shares of each bounce by bins, shape (bounces, bins)."""
    edges = START + WIDTH * np.arange(BINS + 1)
    return np.stack([sphere_bounce_masses(n, edges, RADIUS) for n in range(BOUNCES)])


def truth() -> np.ndarray:
    """Radiance by bins."""
    totals = [sphere_bounce_total(n, RADIUS, ALBEDO, INTENSITY) for n in range(BOUNCES)]
    return np.array(totals) @ masses()


def paths(spp: int) -> np.ndarray:
    """Contributions that bins expect, but for those of the first bounce, which is no chance."""
    return spp * masses()[1:].sum(axis=0)
