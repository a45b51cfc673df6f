"""Lights that do not belong to the scene have the same colors in spectral variants as in RGB.

White is D65, as for all emitters that Mitsuba loads. Equal energy at all wavelengths would look
pink: 1.21, .95, .91.
"""

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import diffuse, plane
from helpers.support import camera, film, load, rendered, scene
from oracles.nlos import Rectangle, Setup, confocal, load_nlos, single

SPECTRAL = "llvm_ad_spectral"
DEVICE, LASER, LIT = (-0.6, 0.3, 1.2), (-0.8, -0.5, 0.6), (-0.3, 0.25, 0.0)
TINTED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.6, 0.5]}}
HIDDEN = Rectangle.turned((0.1, 0.1, 0.7), 20, 240, half=(0.3, 0.3))


def color(describe, spp: int) -> np.ndarray:
    """Return the mean color of a picture in the active variant."""
    return rendered(load_nlos(describe()), spp=spp, seed=1)[0].mean(axis=(0, 1))


def both(describe) -> tuple[np.ndarray, np.ndarray]:
    """Return red, green and blue of the spectral picture, and of the RGB picture."""
    expected = color(describe, 1 << 12)
    mi.set_variant(SPECTRAL)
    return color(describe, 1 << 14), expected


@pytest.mark.parametrize(
    "integrator",
    [{"type": "ao"}, {"type": "simple", "position": [0, 0, 1], "energy": 4 * np.pi**2}],
)
def test_lights_of_integrators_are_white(integrator):
    mi.set_variant(SPECTRAL)
    floor = {"floor": plane(size=50.0, bsdf=diffuse(0.2))}
    described = scene(floor, camera((0, 0, 1), (0, 0, 0), film(), fov=1))
    steady, _ = rendered(load(described | {"integrator": integrator}), spp=1 << 14)
    assert steady[0, 0] == pytest.approx([1, 1, 1], abs=0.02)


def point_laser() -> dict:
    return confocal(Setup(sensor=DEVICE, power=2.0), {"hidden": HIDDEN.shape()}, film(2, 2))


def scenes_laser(**options) -> dict:
    setup = Setup(sensor=DEVICE, laser=LASER)
    return single(setup, {"hidden": HIDDEN.shape()}, LIT, film(2, 2), **options)


LASERS = {
    "confocal": (point_laser, diffuse(0.8), 0.03),
    # Of three bounces, two are on a tinted wall, the lit point's too
    "on a tinted wall": (point_laser, TINTED, 0.05),
    # `transient_nlos_path` asks the scene's own emitter, or gives it a power in watts
    "a scene's": (scenes_laser, TINTED, 0.05),
    "a scene's, of some power": (lambda: scenes_laser(laser_power=2.0), TINTED, 0.05),
}


@pytest.mark.parametrize("name", LASERS)
def test_lasers_are_white(name):
    describe, wall, within = LASERS[name]

    def on_wall() -> dict:
        described = describe()
        return described | {"relay_wall": described["relay_wall"] | {"bsdf": wall}}

    found, expected = both(on_wall)
    assert found / expected == pytest.approx([1, 1, 1], abs=within)


@pytest.mark.parametrize(
    ("colors", "bounces"),
    [
        pytest.param([(1.0, 1.0, 1.0), (3.0, 3.0, 3.0)], 3, id="white"),
        pytest.param([(1.0, 0.5, 0.25), (0.1, 0.8, 0.4)], 1, id="colored"),
        pytest.param([(0.0, 2.0, 0.0), (0.0, 1.0, 0.0)], 1, id="green"),
    ],
)
def test_a_projectors_spots(colors, bounces):
    def pattern() -> dict:
        lamp = {"type": "confocal_projector", "fov": 0.8, "is_confocal": False}
        lamp["frame"] = mi.ScalarTransform4f().look_at(list(DEVICE), [0, 0, 0], [0, 1, 0])
        values = {"positions": [(0.5, 0), (-0.5, 0)], "sigmas": [0.3, 0.2], "intensities": colors}
        for key, value in values.items():
            lamp[f"spot_{key}"] = mi.TensorXf(np.array(value, np.float32))
        hidden = {"hidden": HIDDEN.shape()}
        described = confocal(Setup(sensor=DEVICE), hidden, film(2, 2), filter_bounces=bounces)
        del described["integrator"]["power"]
        described["integrator"]["confocal_projector"] = lamp
        return described

    found, expected = both(pattern)
    assert found / expected.max() == pytest.approx(expected / expected.max(), abs=0.05)
