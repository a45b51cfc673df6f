"""Light around the corner through fog: absorption, scattering, and infinite light."""

import math
from functools import partial
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from helpers.fogs import cube, filled, fog
from helpers.parts import diffuse, plane, rotate, translate
from helpers.support import agree, film, load, scene

import tofrender

pytestmark = [
    pytest.mark.statistical,
    pytest.mark.filterwarnings("ignore:.*of the energy arrives outside"),
]
SEEDS, OTHER_SEEDS = range(12), range(1000, 1012)
DEVICE, SPOT = (0.0, -1.2, 1.4), (-0.5, -0.5, 0.0)
BINS, START, WIDTH = 40, 2.5, 0.15
FOV = 0.2
CONFOCAL = {"type": "confocal_transient_path"}
SWITCHES = ("nlos_laser_sampling", "nlos_hidden_geometry_sampling", "discard_direct_paths")
SCAN = {"type": "transient_nlos_path", "account_first_and_last_bounces": True}
SCAN |= dict.fromkeys(SWITCHES, True)
SINGLE, EACH = SCAN | {"capture_type": "single"}, SCAN | {"capture_type": "confocal"}
MODES = {"confocal": CONFOCAL, "single": SINGLE, "each": EACH}
THIN = fog(0.6, 0.95, 0.4)
DIM, DARK = fog(0.3, 0.0), fog(1.5, 0.0)
LEGS = {"confocal": 4.15, "single": 3.71, "each": 4.15}
"""Length of the ways between device and wall, both together: within 2 %."""
DARK_SLAB = {"slab": filled(cube((3, 3, 0.1), (0, 0, 0.5)), DARK)}
ABSORBING: dict[str, tuple[dict, float, Any]] = {
    "around": ({"around": DIM}, 0.3, lambda s, legs: s),
    "in a box": ({"around": DIM, "box": filled(cube(6.0), DIM)}, 0.3, lambda s, legs: s),
    "slab": (DARK_SLAB, 1.5, lambda s, legs: 0.2 * (s - legs) + 0.2 / DEVICE[2] * legs),
}
"""Fog, its extinction [1/m], and how much of a path's length is in it."""


def look(target: Any) -> mi.ScalarTransform4f:
    return mi.ScalarTransform4f().look_at(list(DEVICE), list(target), [0, 0, 1])


def corner(integrator: dict, max_depth: int = 4, **parts: Any) -> dict:
    """Return a wall, a hidden shape above it, a laser and a camera, in the medium `around`."""
    around = parts.pop("around", None)
    laser = {"type": "projector", "fov": FOV, "irradiance": 100.0, "to_world": look(SPOT)}
    hidden = translate(0.2, 0, 1) @ rotate((1, 0, 0), 180)
    window = film(2, 2, BINS, START, WIDTH)
    view = {"type": "perspective", "fov": 12, "to_world": look((0.3, 0.3, 0)), "film": window}
    more = {} if around is None else {"medium": around}
    everything = {
        "relay_wall": plane(size=1.0, bsdf=diffuse(0.8)) | {"id": "relay_wall"},
        "hidden": plane(hidden, size=0.4, bsdf=diffuse(0.7)),
    }
    if integrator["type"] != "confocal_transient_path":
        everything["laser"] = laser
    described = scene(everything | parts, view | more)
    return described | {"integrator": integrator | {"max_depth": max_depth, "rr_depth": 50}}


def seen(described: dict | mi.Scene, spp: int, seeds, mode: str = "") -> list[np.ndarray]:
    """Return the film's values for each seed, for a capture in a mode or for a render."""
    loaded = load(described)
    function = partial(tofrender.capture, mode=mode) if mode else tofrender.render
    options = {"spp": spp, "progress": False}
    return [function(loaded, seed=seed, **options)["transient"].values for seed in seeds]


def bins(described: dict, spp: int, seeds) -> np.ndarray:
    """Return the film's mean in each bin, (seeds, bins)."""
    return np.mean(seen(described, spp, seeds), axis=(1, 2, 4))


@pytest.mark.parametrize("where", ["around", "in a box", "slab"])
@pytest.mark.parametrize("mode", LEGS)
def test_absorption_separates(mode, where):
    """Each bin is darker by exp(-mu s), with the length s of the path in the fog."""
    integrator, legs = MODES[mode], LEGS[mode]
    fogs, μ, inside = ABSORBING[where]
    clear = bins(corner(integrator), 512, SEEDS)
    dim = bins(corner(integrator, **fogs), 512, OTHER_SEEDS)
    lit = clear.mean(axis=0) > 0.2 * clear.mean(axis=0).max()
    assert lit.sum() > 5
    low, middle, high = (
        np.exp(μ * inside(START + WIDTH * (np.arange(BINS)[lit] + k), legs)) for k in (0, 0.5, 1)
    )
    ratio = clear.mean(axis=0)[lit] / dim.mean(axis=0)[lit]
    assert (ratio > 0.93 * low).all()
    assert (ratio < 1.07 * high).all()
    assert agree((dim[:, lit] * middle).sum(1), clear[:, lit].sum(1), rounding=2e-3)


def test_a_single_bounce_is_in_fog_on_both_ways():
    integrator = EACH | {"discard_direct_paths": False, "use_nlos_only": False}
    fogs, μ, _ = ABSORBING["in a box"]
    clear = bins(corner(integrator, 2), 64, range(4))
    dim = bins(corner(integrator, 2, **fogs), 64, range(4))
    middle = np.exp(μ * (START + WIDTH * (np.arange(BINS) + 0.5)))
    np.testing.assert_allclose((dim * middle).sum(), clear.sum(), rtol=0.5 * WIDTH * μ)


def slab(medium: dict, half: float = 0.2, z: float = 0.5) -> dict:
    return {"slab": filled(cube((3, 3, half), (0, 0, z)), medium)}


FOGS = {
    "around": {"around": THIN},
    "slab": slab(THIN),
    "grid": slab(fog(0.6, 0.95, 0.4, "grid")),
    "hidden inside": slab(THIN, 0.3, 1),
}


@pytest.mark.parametrize("name", FOGS)
def test_fog_scatters_as_a_bidirectional_tracer_finds(name):
    """A very narrow projector is a beam. The lit point represents 1 m²."""
    ours = bins(corner(SINGLE, 3, **FOGS[name]), 2048, SEEDS)
    reference = bins(corner({"type": "transient_bdpt"}, 4, **FOGS[name]), 2048, OTHER_SEEDS)
    r = math.dist(DEVICE, SPOT)
    footprint = (2 * r * math.tan(math.radians(FOV / 2))) ** 2 / (DEVICE[2] / r)
    groups = np.add.reduceat(np.eye(BINS), [10, 16, 20, 25, 30], axis=0).T
    assert agree(ours @ groups, reference @ groups / footprint, rounding=1e-2)


@pytest.mark.parametrize("integrator", [CONFOCAL, EACH], ids=["confocal", "each"])
def test_infinite_light_is_refused(integrator):
    """The camera looks along the beam, or at its end."""
    for around in (THIN, fog(0.6, 0.95, 0.4, "grid")):
        with pytest.raises(ValueError, match=r"\A[^\n]*infinite. Make it absorb[^\n]*\Z"):
            tofrender.render(corner(integrator, around=around), spp=1, progress=False)
    apart = corner(integrator, slab=filled(cube((0.5, 0.5, 0.1), (0, 1.5, 0.5)), THIN))
    wide = corner(CONFOCAL | {"spot_sigma": 0.02}, around=THIN)
    for described in (apart, wide):
        found = tofrender.render(described, spp=4, progress=False, window="auto")
        assert float(found["transient"].sum()) > 0
        assert np.isfinite(found["transient"].values).all()


@pytest.mark.parametrize(("mode", "spp"), [("single", 64), ("confocal", 64), ("exhaustive", 16)])
def test_fog_of_no_density_changes_nothing(mode, spp):
    """Light and noise equal those without fog: no path is sampled towards the fog's boundary."""
    clear, foggy = (
        np.mean(seen(scene, spp, seeds, mode), axis=-1).reshape(12, -1, 10, 30).sum(axis=-1)
        for scene, seeds in (
            (tofrender.nlos_z(width=2, height=2), SEEDS),
            (tofrender.nlos_behind_fog(width=2, height=2, sigma_t=0), OTHER_SEEDS),
        )
    )
    assert agree(foggy, clear, rounding=1e-4)
    assert foggy.std(axis=0).mean() < 1.5 * clear.std(axis=0).mean()


def test_depth_is_that_of_surfaces():
    foggy = corner(SINGLE, **slab(THIN, 0.1))
    depths = [tofrender.true_depth(load(each)) for each in (corner(SINGLE), foggy)]
    np.testing.assert_allclose(depths[0], depths[1], rtol=1e-5)
