"""Scenes in fog, smoke and milk: the energy of all bins is what Mitsuba's `volpath` sees.

Connections of `volpath` lose light where they pass a boundary shortly before a lamp or a surface:
the epsilons of its rays add up, and a part of the lamp hides behind itself. (A cube of fog that is
almost empty, 5 cm from the walls of the Cornell box, takes 1.3 % of the picture's light.) In the
scenes below, boundaries are far from all else.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from fogs import cloud, cube, filled, fog, sphere
from support import (
    agree,
    area_light,
    camera,
    diffuse,
    film,
    grey,
    load,
    over_seeds,
    plane,
    point_light,
    rotate,
    scene,
    steady_twin,
    translate,
)

pytestmark = pytest.mark.statistical
SEEDS = range(8)
SPP = 1024
DEPTH = 8


def red(*values: float) -> dict:
    return {"type": "rgb", "value": list(values)}


FLOOR = plane(translate(0, 0, -1), 20.0, bsdf=diffuse(0.6))
LAMP = plane(
    translate(0.5, 0, 3) @ rotate((1, 0, 0), 180), 1.0, bsdf=diffuse(0.0), light=area_light(5.0)
)
LIT = {"floor": FLOOR, "lamp": LAMP}
THIN = fog(0.3, 0.9, 0.5)
COLOURED = fog(red(0.1, 0.3, 0.8), red(0.9, 0.7, 0.95), 0.3)
BALL = {"ball": filled(sphere(0.8), fog(2.0, 0.9, 0.6))}
GLASS = {"type": "dielectric", "int_ior": 1.4, "ext_ior": 1.0}
ROUGH = {"type": "roughdielectric", "int_ior": 1.3, "ext_ior": 1.0, "alpha": 0.3}
TWO_LOBES = {
    "type": "blendphase",
    "weight": 0.3,
    "a": {"type": "hg", "g": 0.8},
    "b": {"type": "isotropic"},
}
SPOT = {
    "type": "spot",
    "to_world": mi.ScalarTransform4f().look_at([0.5, 0.2, 2.5], [0, 0, 0], [0, 1, 0]),
    "intensity": grey(8.0),
    "cutoff_angle": 25.0,
}
SUN = {"type": "directional", "direction": [0.3, 0.1, -1], "irradiance": grey(2.0)}
SKY = {"type": "constant", "radiance": grey(0.7)}
HUGE = {"room": filled(cube(12.0), fog(0.1, 0.8)), "around": fog(0.1, 0.8)}

SCENES: dict[str, dict[str, Any]] = {
    "fog everywhere": LIT | {"around": THIN},
    "coloured fog": LIT | {"around": COLOURED},
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
    "coloured cloud": LIT | {"cloud": filled(cube(0.8), cloud(0.8, albedo=red(0.9, 0.5, 0.2)))},
    "ball in the sun": {"floor": FLOOR, "sun": SUN} | BALL,
    "cloud under a sky": {"floor": FLOOR, "sky": SKY, "cloud": filled(cube(0.8), cloud(0.8))},
    "two balls": LIT | BALL | {"other": filled(sphere(0.4, (1.6, 0, 0)), COLOURED)},
    "milk in glass": LIT | {"ball": sphere(0.8, bsdf=GLASS, interior=fog(3.0, 0.98, 0.5))},
    "rough milk": LIT | {"ball": sphere(0.8, bsdf=ROUGH, interior=fog(3.0, red(0.9, 0.95, 0.6)))},
    "cloud in glass": LIT | {"ball": sphere(0.8, bsdf=GLASS, interior=cloud(0.8))},
    "camera in a room of fog": LIT | HUGE,
    "no connections in fog": LIT | {"around": THIN | {"sample_emitters": False}},
    "dense": LIT | {"ball": filled(sphere(0.8), fog(60.0, 0.6, 0.8))},
}


def described(name: str) -> dict:
    parts = dict(SCENES[name])
    around = parts.pop("around", None)
    more = {} if around is None else {"medium": around}
    view = camera((0.4, -3.5, 1.6), (0, 0, 0), film(4, 4, 20, 0.0, 2.0), up=(0, 0, 1), **more)
    return scene(parts, view, type="transient_volpath", max_depth=DEPTH, rr_depth=20)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_energy_is_that_of_volpath(name):
    description = described(name)
    ours, theirs = load(description), load(steady_twin(description))
    volpath = mi.load_dict({"type": "volpath", "max_depth": DEPTH, "rr_depth": 20})

    def mean(seed: int) -> np.ndarray:
        return np.array(mi.render(ours, spp=SPP, seed=seed)[0], float).mean((0, 1))

    def expected(seed: int) -> np.ndarray:
        image = mi.render(theirs, integrator=volpath, spp=SPP, seed=seed + 1000)
        return np.array(image, float).mean((0, 1))

    samples, reference = over_seeds(mean, SEEDS), over_seeds(expected, SEEDS)
    assert agree(samples, reference, rounding=2e-4)
