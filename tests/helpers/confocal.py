"""Confocal captures of small scenes, and their closed forms."""

import mitsuba as mi
import numpy as np
from oracles import nlos

from helpers.support import film, over_seeds

SEEDS = range(16)

GRID = nlos.Grid(2, 2)

LASER = (-0.8, -0.5, 0.6)

LIT = (-0.3, 0.25, 0.0)


def totals(
    setup: nlos.Setup, hidden: nlos.Nodes, albedo: float = 0.7, lit=None, **more
) -> np.ndarray:
    """What the four points of GRID see; each lights itself unless `lit` is given."""

    def at(p) -> float:
        return nlos.total(setup, hidden, albedo, p if lit is None else lit, p, **more)

    return np.array([[at(p) for p in row] for row in GRID.points()])


def small_film(**more) -> dict:
    return film(2, 2, **more)


MODES = {"confocal": None, "single": LIT}
"""How the wall is scanned -> what the laser lights, unless each point lights itself."""


def setup_of(mode: str, **more) -> nlos.Setup:
    return nlos.Setup(laser=None if mode == "confocal" else LASER, **more)


def three_of(mode: str, hidden: dict, the_film=None, setup=None, **options) -> dict:
    setup, the_film = setup or setup_of(mode), the_film or small_film()
    if mode == "confocal":
        return nlos.confocal(setup, hidden, the_film, **options)
    return nlos.single(setup, hidden, LIT, the_film, **options)


def found(description: dict, spp: int = 512, seeds=SEEDS) -> np.ndarray:
    """Steady pictures over seeds."""
    return over_seeds(nlos.estimates(description, spp), seeds)


def facing(patch: nlos.Rectangle) -> nlos.Rectangle:
    """The side towards which the middle of the wall is."""
    return patch if np.dot(patch.normal, patch.center) < 0 else patch.flipped()


def groove_shapes(groove: nlos.Groove) -> dict:
    left, right = groove.faces()
    return {"left": left.shape(), "right": right.shape()}


PLACE = (-0.3, 0.2, 1.4)

FOV = 1.0


def pointed(target=(0.1, -0.1, 0.0)) -> mi.ScalarTransform4f:
    return mi.ScalarTransform4f().look_at(list(PLACE), list(target), [0, 1, 0])


def projector(**options) -> dict:
    """One fixed to a place, with a pulse of no width unless one is asked for."""
    fixed = {"is_confocal": False, "frame": pointed()}
    return {"type": "confocal_projector", "fov": FOV} | fixed | options


def spots(positions, sigmas, powers) -> dict:
    arrays = {"positions": positions, "sigmas": sigmas, "intensities": powers}
    return {f"spot_{k}": mi.TensorXf(np.array(v, np.float32)) for k, v in arrays.items()}


def lit_by(pattern: dict, hidden: dict | None = None, the_film=None, **options) -> dict:
    described = nlos.confocal(
        nlos.Setup(sensor=PLACE), hidden or {}, the_film or film(8, 8), **options
    )
    integrator = {k: v for k, v in described["integrator"].items() if k != "power"}
    return described | {"integrator": integrator | {"confocal_projector": pattern}}
