"""Rates of light in fog, and of all integrators: by formulas, and by each other."""

import functools

import mitsuba as mi
import numpy as np
import pytest
from helpers.moving import seen_by, share_at
from helpers.parts import area_light, diffuse, gray, plane, point_light, rotate, translate, unit
from helpers.support import agree, camera, film, over_seeds, scene

import tofrender

EYE, AHEAD, LAMP = np.array([0.0, 0.0, -2.0]), np.array([0.0, 0.0, 1.0]), np.array([0.9, 0.5, -0.4])
V, W, U = np.array([0.3, -0.6, 0.8]), np.array([-0.4, 0.3, 1.2]), np.array([0.2, 0.5, -0.7])


def fog(**motion) -> dict:
    medium = {"type": "homogeneous", "sigma_t": 0.7, "albedo": gray(0.9)}
    box = {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}
    return box | {name: list(value) for name, value in motion.items()}


def single_scattering(moves: dict, ω=(0, 0, 0)) -> None:
    """Mean rate of each length of light that fog in a box scatters once."""
    v, w, u = (moves.get(each, np.zeros(3)) for each in ("fog", "lamp", "eye"))
    parts = {
        "fog": fog(velocity=v, angular_velocity=ω),
        "lamp": point_light(LAMP, 3.0) | {"velocity": list(w)},
    }
    sensor = {"velocity": list(u)}
    described = seen_by(EYE, EYE + AHEAD, parts, 2, sensor, type="transient_volpath")
    s = np.linspace(1, 3, 20001)  # Distance in the box
    x = EYE + s[:, None] * AHEAD
    onwards = LAMP - x
    distance = np.linalg.norm(onwards, axis=1)
    there = v + np.cross(ω, x)
    rate = (there - u) @ AHEAD + np.sum((w - there) * onwards, axis=1) / distance
    edges = np.linspace((s + distance).min(), (s + distance).max(), 13)
    span = rate.min() - 0.01, rate.max() + 0.01
    light = tofrender.range_rate(
        described,
        bins=12,
        window=(edges[0], edges[-1]),
        rates=span,
        rate_bins=512,
        spp=1 << 14,
        progress=False,
    )
    found = light["radiance"].mean("channel")[0, 0]
    assert light.attrs["energy_outside_window"] < 1e-3
    bins = np.digitize(s + distance, edges) - 1
    half = float(light["rate"][1] - light["rate"][0]) / 2
    for k in range(12):
        rates = light["rate"].values[found[k].values > 0]
        assert rates.size
        assert rates.min() > rate[bins == k].min() - half - 2e-3
        assert rates.max() < rate[bins == k].max() + half + 2e-3


@pytest.mark.parametrize("moves", [{"eye": U}, {"lamp": W}, {"fog": V}, {"fog": V, "lamp": W}])
def test_fog(moves):
    """Light of one scattering: its length tells the point, and so its rate."""
    single_scattering(moves)


def test_fog_that_rotates():
    single_scattering({"fog": V, "eye": U}, ω=(0.8, -0.5, 0.3))


def test_fog_that_moves_with_all_is_at_rest():
    motion = {"velocity": V.tolist()}
    parts = {"fog": fog(velocity=V), "lamp": point_light(LAMP, 3.0) | motion}
    described = seen_by(EYE, EYE + AHEAD, parts, 8, motion, type="transient_volpath")
    assert share_at(described, 0, 1e-6) == pytest.approx(1, abs=1e-4)


def test_fog_before_a_wall_changes_no_rate():
    """Light through fog at rest that a moving wall reflects: the fog's box counts for nothing."""
    wall = plane(
        translate(0, 0, 2) @ rotate((0, 1, 0), 180), bsdf=diffuse(0.5), velocity=V.tolist()
    )
    parts = {"fog": fog(velocity=W), "wall": wall, "lamp": point_light(LAMP, 3.0)}
    parts["fog"]["interior"] |= {"albedo": gray(0.0)}
    described = seen_by(EYE, EYE + AHEAD, parts, 2, type="transient_volpath")
    spot = np.array([0.0, 0.0, 2.0])
    rate = V @ AHEAD - V @ unit(LAMP - spot)
    assert share_at(described, rate) == pytest.approx(1, abs=1e-4)


# ---------------------------------------------------------------------------------- integrators

INTEGRATORS = ("transient_path", "transient_volpath", "transient_light_tracer", "transient_bdpt")


def room(integrator: str, max_depth: int = 4, lamp: str = "point", **more) -> dict:
    """A corner with a ball of metal, where everything moves, the camera too."""
    lamps = {
        "point": point_light((0.8, 0.9, 0.6), 3.0),
        "area": plane(translate(0.8, 0.9, 0.6) @ rotate((1, 0, 0), 90), 0.2)
        | {"emitter": area_light(9.0)},
    }
    parts = {
        "floor": plane(rotate((1, 0, 0), -90), 2.0, bsdf=diffuse(0.6), velocity=[0.0, 1.0, 0.5]),
        "wall": plane(translate(0, 0, -1), 2.0, bsdf=diffuse(0.7)),
        "block": {
            "type": "cube",
            "to_world": translate(-0.5, 0.3, 0)
            @ rotate((0, 1, 0), 30)
            @ mi.ScalarTransform4f().scale(0.3),
            "bsdf": diffuse(0.8),
            "angular_velocity": [0.0, 4.0, 1.0],
            "rotation_center": [-0.5, 0.3, 0.0],
        },
        "ball": {
            "type": "sphere",
            "center": [0.4, 0.35, 0.0],
            "radius": 0.3,
            "bsdf": {"type": "roughconductor", "alpha": 0.4},
            "velocity": [1.0, -0.5, 2.0],
        },
        "lamp": lamps[lamp] | {"velocity": [-1.0, 0.5, 1.0]},
    }
    view = camera((0.1, 1.2, 3.0), (0, 0.3, 0), film(8, 8), fov=45, velocity=[0.3, 0.2, -0.8])
    return scene(parts, view, max_depth=max_depth, type=integrator, **more)


def histogram(described: dict, seed: int, spp: int = 64) -> np.ndarray:
    light = tofrender.range_rate(
        described,
        bins=6,
        window=(3, 12),
        rates=(-8, 8),
        rate_bins=16,
        spp=spp,
        seed=seed,
        progress=False,
    )
    return light["radiance"].mean("channel").sum(("y", "x")).values.astype(float)


@functools.cache
def estimates(integrator: str, lamp: str) -> np.ndarray:
    described = room(integrator, lamp=lamp)
    seeds = range(16) if integrator == "transient_path" else range(100, 116)
    return over_seeds(functools.partial(histogram, described), seeds)


@pytest.mark.parametrize("lamp", ["point", "area"])
@pytest.mark.parametrize("integrator", INTEGRATORS[1:])
def test_integrators_agree(integrator, lamp):
    found, expected = estimates(integrator, lamp), estimates("transient_path", lamp)
    there = (expected > 0).sum(0) + (found > 0).sum(0) > 24
    assert there.sum() > 20
    assert agree(found[:, there], expected[:, there], rounding=1e-3)


def exchanged(forth: bool, seed: int) -> np.ndarray:
    """Light from a point lamp to a camera by two patches, and with both exchanged.

    A camera sees the lamp's light all over its picture with the importance of a point lamp, but
    for 1 / cos^4 and the picture's area; patches are small, so that the cosine is nearly one.
    """
    a, b = np.array([1.2, 3.0, 0.8]), np.array([-1.0, 2.4, 0.6])
    motions = {"velocity": [0.4, -0.3, 0.7]}, {"velocity": [-0.6, 0.9, 0.2]}
    eye, lamp, of_eye, of_lamp = (a, b, *motions) if forth else (b, a, *motions[::-1])
    middle = np.array([0.0, 0.025, -0.02])
    parts = {
        "floor": plane(rotate((1, 0, 0), -90), 0.05, bsdf=diffuse(0.6), velocity=[0.5, 1.0, 0.5]),
        "wall": plane(
            translate(0, 0.05, -0.05),
            0.05,
            bsdf=diffuse(0.7),
            angular_velocity=[9.0, 4.0, 0.0],
            rotation_center=[0.0, 0.0, 0.0],
        ),
        "lamp": point_light(lamp, 3.0) | of_lamp,
    }
    described = seen_by(eye, middle, parts, 4, {"fov": 10.0} | of_eye)
    light = tofrender.range_rate(
        described,
        bins=1,
        window=(3, 12),
        rates=(-4, 4),
        rate_bins=24,
        spp=1 << 14,
        seed=seed,
        progress=False,
    )
    return light["radiance"].mean("channel").values.ravel().astype(float)


def test_camera_and_lamp_exchanged():
    """Helmholtz: all light by each rate is the same, with what moved exchanged, too."""
    forth = over_seeds(functools.partial(exchanged, True), range(16))
    back = over_seeds(functools.partial(exchanged, False), range(50, 66))
    assert agree(back, forth, rounding=0.02)
