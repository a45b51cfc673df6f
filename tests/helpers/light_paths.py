"""Scenes for paths that start at lights, estimates of them, and comparisons with what is exact."""

import math
from typing import Any

import mitsuba as mi
import numpy as np
from oracles.films import disk_light_masses, rectangle_light_masses
from oracles.light_paths import View

from helpers.parts import area_light, diffuse, gray, plane, point_light, rotate, translate
from helpers.support import agree, beam, camera, film, follow, load, over_seeds, rendered, scene
from tofrender.scenes import cornell_box

SEEDS, OTHER_SEEDS = range(16), range(1000, 1016)
ALBEDO = 0.5
PATH, LIGHT_TRACER, BDPT = "transient_path", "transient_light_tracer", "transient_bdpt"
TRACERS = (LIGHT_TRACER, BDPT)
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
MIRROR = {"type": "conductor", "material": "none"}


def by(technique: str, max_depth: int = 2, **more: Any) -> dict:
    """An integrator: a plugin's name, or the "s,t" of one strategy alone."""
    if technique[0].isdigit():
        more = {"strategy": technique} | more
    kind = BDPT if technique[0].isdigit() else technique
    return {"type": kind, "max_depth": max_depth, **more}


def through(described: dict, technique: str, **more: Any) -> dict:
    """The scene with another integrator; depths stay."""
    own = {k: v for k, v in described["integrator"].items() if k != "type"}
    return described | {"integrator": by(technique, **own | more)}


def floor(size: float = 10.0, albedo: float = ALBEDO) -> dict:
    return {"floor": plane(size=size, bsdf=diffuse(albedo))}


def looking_down(
    view: View, parts: dict, edges: np.ndarray, size: int = 8, max_depth: int = 2, **more: Any
) -> dict:
    """A floor under a camera; `edges` of the film's bins are at equal steps."""
    bins = {"bins": edges.size - 1, "start": float(edges[0])}
    window = film(size, size, bin_width=float(edges[1] - edges[0]), **bins)
    lens = {"fov": view.fov, "principal_point_offset_x": view.shift}
    eye = camera((0, 0, view.height), (0, 0, 0), window, **lens | more)
    return scene(floor() | parts, eye, max_depth=max_depth)


def facing_down(kind: str, height: float, half: float, radiance: float) -> dict:
    """A rectangle or disk over the origin that shines on the floor."""
    to_world = translate(0, 0, height) @ rotate((1, 0, 0), 180) @ mi.ScalarTransform4f().scale(half)
    return {"lamp": {"type": kind, "to_world": to_world, "emitter": area_light(radiance)}}


def ball(center, radius: float, **more: Any) -> dict:
    return {"type": "sphere", "center": list(center), "radius": radius, **more}


def spot(origin, target, beam: float, cutoff: float, intensity: float = 1.0) -> dict:
    """Constant up to the angle `beam` from its axis, dark beyond `cutoff` [degrees]."""
    up = [0, 1, 0] if origin[0] == target[0] else [0, 0, 1]
    to_world = mi.ScalarTransform4f().look_at(list(origin), list(target), up)
    angles = {"beam_width": beam, "cutoff_angle": cutoff}
    return {"type": "spot", "intensity": gray(intensity), "to_world": to_world} | angles


def lamp(position, intensity: float = 1.0) -> dict:
    return {"lamp": point_light(position, intensity)}


def disk_over_receiver(
    eye=(2.5, 0.0, 1.5), lanes: int = 1024, parts: dict | None = None, **options: Any
):
    """A receiver at the origin under a disk, seen from above the disk's edge.

    Returns:
        What arrives with a seed, what is exact, and the edges of bins of the light's distance.
    """
    h, radius, radiance = 1.0, 1.5, 4.0
    lit = floor() | facing_down("disk", h, radius, radiance) | (parts or {})
    loaded = load(scene(lit, camera(eye, (0, 0, 0), film())))
    edges = np.linspace(h, math.hypot(h, radius), 17)
    segment = math.hypot(*eye)

    def estimate(seed):
        ray = beam(eye, (0, 0, 0), lanes)
        return follow(loaded, ray, seed=seed, **options).histogram(edges + segment)

    exact = ALBEDO / math.pi * disk_light_masses(edges, h, radius, radiance)
    total = ALBEDO * radiance * radius**2 / (h**2 + radius**2)
    np.testing.assert_allclose(exact.sum(), total)
    return estimate, exact, edges


def cornell_light_over_floor(lanes: int, **options: Any):
    """The same for a point of the floor of the Cornell box that neither box shades."""
    x, eye, h = (-0.5, -1.0, 0.7), (0.0, 0.0, 3.9), 1.99
    loaded = load(cornell_box(width=4, height=4, max_depth=2))
    ranges = (-0.23 - x[0], 0.23 - x[0]), (0.01 - 0.19 - x[2], 0.01 + 0.19 - x[2])
    edges = np.linspace(1.95, 2.4, 19)
    segment = np.linalg.norm(np.subtract(x, eye))

    def estimate(seed):
        return follow(loaded, beam(eye, x, lanes), seed=seed, **options).histogram(edges + segment)

    masses = rectangle_light_masses(edges, h, *ranges, radiance=18.387)
    assert 0 == masses[0] == masses[-1] < masses.sum()  # the bins hold all of it
    return estimate, 0.885809 / math.pi * masses


def arrivals(described: dict | mi.Scene, spp: int, seeds=SEEDS) -> np.ndarray:
    """Bins of the film's mean, first channel, shape (seeds, bins)."""
    loaded = load(described) if isinstance(described, dict) else described
    return over_seeds(lambda seed: rendered(loaded, spp, seed)[1][..., 0].mean((0, 1)), seeds)


def blocks(image: np.ndarray, n: int) -> np.ndarray:
    """Means of n x n blocks of a picture (height, width, ...)."""
    height, width = (length // n for length in image.shape[:2])
    cut = image[: height * n, : width * n]
    return cut.reshape(n, height, n, width, *image.shape[2:]).mean(axis=(1, 3))


def summary(exact: np.ndarray, edges: np.ndarray, parts: int = 8) -> np.ndarray:
    """What to compare of bins, as a matrix (bins, 2 + parts) for those that hold `exact`.

    Total, first moment about the exact mean length, and groups of neighboring bins that each have
    about the same part of the light.
    """
    centers = 0.5 * (edges[1:] + edges[:-1])
    before = np.cumsum(exact) - 0.5 * exact
    group = np.minimum(parts * before / exact.sum(), parts - 1).astype(int)
    rows = [np.ones(exact.size), centers - exact @ centers / exact.sum()]
    rows += [(group == k) * 1.0 for k in np.unique(group)]
    return np.stack(rows, axis=-1)


def arrives(samples: np.ndarray, exact: np.ndarray, edges: np.ndarray, *, rounding=1e-3) -> bool:
    """Whether bins (seeds, bins) agree with exact ones: energy, mean length, and shape."""
    shown = summary(exact, edges)
    return agree(samples @ shown, exact @ shown, rounding=rounding)
