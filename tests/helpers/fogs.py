"""Media for tests: even ones, grids of the same density, and scenes with them.

In the scenes, boundaries are far from all else: see `test_straight_through.py`.
"""

from typing import Any

import mitsuba as mi
import numpy as np

from helpers.light_paths import spot
from helpers.parts import area_light, diffuse, gray, plane, point_light, rotate, translate
from helpers.support import camera, film, scene

DEPTH = 8


def fog(
    sigma_t: float = 1.0, albedo: Any = 1.0, g: float = 0.0, kind: str = "even", **more: Any
) -> dict:
    """A medium of one density, or a grid of it: "grid", or "dense corner" with null collisions."""
    phase = {"type": "hg", "g": g} if g else {"type": "isotropic"}
    more = {"albedo": albedo, "phase": phase} | more
    if kind == "even":
        return {"type": "homogeneous", "sigma_t": sigma_t, **more}
    density = np.ones((8, 8, 8, 1), np.float32)
    if kind == "dense corner":  # Far from all light; the majorant is 2.5 times what is needed
        density[0, 0, 0] = 2.5
    grid = volume(density, (-40, -40, -40), 80)
    return {"type": "heterogeneous", "sigma_t": grid, "scale": sigma_t, **more}


def volume(density: np.ndarray, corner: Any, size: Any) -> dict:
    """A grid of values, from a corner on."""
    place = mi.ScalarTransform4f().translate(list(corner)).scale(size)
    grid = mi.VolumeGrid(density.astype(np.float32))
    return {"type": "gridvolume", "grid": grid, "to_world": place, "filter_type": "nearest"}


def cloud(size: float, sigma_t: float = 4.0, **more: Any) -> dict:
    """Random densities in a cube around the origin, up to `sigma_t`."""
    density = np.random.default_rng(7).random((6, 6, 6, 1)) ** 2
    grid = volume(density, (-size,) * 3, 2 * size)
    return {"type": "heterogeneous", "sigma_t": grid, "scale": sigma_t, "albedo": 0.9} | more


def filled(shape: dict, medium: dict, **more: Any) -> dict:
    """A shape that is nothing but the boundary of a medium."""
    return shape | {"bsdf": {"type": "null"}, "interior": medium} | more


def cube(scale: Any, position: Any = (0, 0, 0), **more: Any) -> dict:
    place = mi.ScalarTransform4f().translate(list(position)).scale(scale)
    return {"type": "cube", "to_world": place, **more}


def sphere(radius: float, position: Any = (0, 0, 0), **more: Any) -> dict:
    return {"type": "sphere", "radius": radius, "center": list(position), **more}


def red(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


FLOOR = plane(translate(0, 0, -1), 20.0, bsdf=diffuse(0.6))
LAMP = plane(
    translate(0.5, 0, 3) @ rotate((1, 0, 0), 180), 1.0, bsdf=diffuse(0.0), light=area_light(5.0)
)
LIT = {"floor": FLOOR, "lamp": LAMP}
THIN = fog(0.3, 0.9, 0.5)
COLORED = fog(red(0.1, 0.3, 0.8), red(0.9, 0.7, 0.95), 0.3)
BALL = {"ball": filled(sphere(0.8), fog(2.0, 0.9, 0.6))}
GLASS = {"type": "dielectric", "int_ior": 1.4, "ext_ior": 1.0}
ROUGH = {"type": "roughdielectric", "int_ior": 1.3, "ext_ior": 1.0, "alpha": 0.3}
LOBES = {"a": {"type": "hg", "g": 0.8}, "b": {"type": "isotropic"}}
TWO_LOBES = {"type": "blendphase", "weight": 0.3, **LOBES}
S = np.tile([0.3, 0.5, 0.9, 0.05, 0.1, 0.02], (2, 2, 2, 1))
FLAKES = {"type": "sggx", "S": volume(S, (-40, -40, -40), 80)}
SPOT = spot((0.5, 0.2, 2.5), (0, 0, 0), beam=18.75, cutoff=25.0, intensity=8.0)
SUN = {"type": "directional", "direction": [0.3, 0.1, -1], "irradiance": gray(2.0)}
SKY = {"type": "constant", "radiance": gray(0.7)}
HUGE = {"room": filled(cube(12.0), fog(0.1, 0.8)), "around": fog(0.1, 0.8)}

SCENES: dict[str, dict[str, Any]] = {
    "fog everywhere": LIT | {"around": THIN},
    "colored fog": LIT | {"around": COLORED},
    "absorbing": LIT | {"around": fog(0.3, 0.0)},
    "forwards": LIT | {"around": fog(0.5, 1.0, 0.9)},
    "backwards": LIT | {"around": fog(0.5, 1.0, -0.7)},
    "grid everywhere": LIT | {"around": fog(0.3, 0.9, 0.5, "dense corner")},
    "point light": {"floor": FLOOR, "lamp": point_light((0.5, 0.5, 1.5), 5.0), "around": THIN},
    "spot": {"floor": FLOOR, "spot": SPOT, "around": THIN},
    "ball": LIT | BALL,
    "rayleigh": LIT | {"ball": filled(sphere(0.8), fog(2.0, 0.9, phase={"type": "rayleigh"}))},
    "two lobes": LIT | {"ball": filled(sphere(0.8), fog(2.0, 0.9, phase=TWO_LOBES))},
    "cloud": LIT | {"cloud": filled(cube(0.8), cloud(0.8))},
    "colored cloud": LIT | {"cloud": filled(cube(0.8), cloud(0.8, albedo=red(0.9, 0.5, 0.2)))},
    "ball in the sun": {"floor": FLOOR, "sun": SUN} | BALL,
    "cloud under a sky": {"floor": FLOOR, "sky": SKY, "cloud": filled(cube(0.8), cloud(0.8))},
    "two balls": LIT | BALL | {"other": filled(sphere(0.4, (1.6, 0, 0)), COLORED)},
    "milk in glass": LIT | {"ball": sphere(0.8, bsdf=GLASS, interior=fog(3.0, 0.98, 0.5))},
    "rough milk": LIT | {"ball": sphere(0.8, bsdf=ROUGH, interior=fog(3.0, red(0.9, 0.95, 0.6)))},
    "cloud in glass": LIT | {"ball": sphere(0.8, bsdf=GLASS, interior=cloud(0.8))},
    "camera in a room of fog": LIT | HUGE,
    "no connections in fog": LIT | {"around": THIN | {"sample_emitters": False}},
    "dense": LIT | {"ball": filled(sphere(0.8), fog(60.0, 0.6, 0.8))},
}


def looked_at(parts: dict, **integrator: Any) -> dict:
    """A scene from aside; what is "around" all is the camera's medium."""
    parts = dict(parts)
    around = {"medium": parts.pop("around")} if "around" in parts else {}
    view = camera((0.4, -3.5, 1.6), (0, 0, 0), film(4, 4, 20, 0.0, 2.0), up=(0, 0, 1), **around)
    options = {"type": "transient_volpath", "max_depth": DEPTH, "rr_depth": 20}
    return scene(parts, view) | {"integrator": options | integrator}
