"""Lights that are no scene's: in spectral variants they have the colours that they have in RGB.

White is D65, as it is of every emitter that Mitsuba loads; equal energy at all wavelengths would
look pink: 1.21, .95, .91.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from helpers.support import camera, diffuse, film, load, plane, rendered, scene
from oracles.nlos import Rectangle, Setup, confocal, load_nlos, single

SPECTRAL = "llvm_ad_spectral"
DEVICE, LASER, LIT = (-0.6, 0.3, 1.2), (-0.8, -0.5, 0.6), (-0.3, 0.25, 0.0)
TINTED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.6, 0.5]}}


def patch(bsdf: dict) -> dict:
    front = Rectangle.turned((0.1, 0.1, 0.7), 20, 240, half=(0.3, 0.3))
    return {"hidden": front.shape(bsdf)}


def colour(describe, spp: int, **options) -> np.ndarray:
    """The mean colour of a picture, in the active variant; scenes may read transforms of it."""
    return rendered(load_nlos(describe(**options)), spp=spp, seed=1)[0].mean(axis=(0, 1))


def ratio(describe) -> np.ndarray:
    """Red, green and blue of the spectral picture over those of the RGB picture."""
    expected = colour(describe, 1 << 12)
    mi.set_variant(SPECTRAL)
    return colour(describe, 1 << 14) / expected


def test_ambient_occlusion_is_white():
    mi.set_variant(SPECTRAL)
    floor = {"floor": plane(size=50.0, bsdf=diffuse(0.2))}
    described = scene(floor, camera((0, 0, 1), (0, 0, 0), film()))
    steady, _ = rendered(load(described | {"integrator": {"type": "ao"}}), spp=1 << 14)
    assert steady[0, 0] == pytest.approx([1, 1, 1], abs=0.02)


def test_simple_is_white():
    mi.set_variant(SPECTRAL)
    light = {"type": "simple", "position": [0, 0, 1], "energy": 4 * np.pi**2}
    floor = {"floor": plane(size=50.0, bsdf=diffuse(0.2))}
    described = scene(floor, camera((0, 0, 1), (0, 0, 0), film(), fov=1)) | {"integrator": light}
    steady, _ = rendered(load(described), spp=1 << 14)
    assert steady[0, 0] == pytest.approx([1, 1, 1], abs=0.02)


def point_laser(bsdf: dict, **options) -> dict:
    return confocal(Setup(sensor=DEVICE, power=2.0), patch(bsdf), film(2, 2), **options)


def walls_colour(described: dict) -> dict:
    """Lit and seen by a coloured wall."""
    return described | {"relay_wall": described["relay_wall"] | {"bsdf": TINTED}}


def test_a_confocal_laser_is_white():
    found = ratio(lambda: point_laser(diffuse(0.7)))
    assert found == pytest.approx([1, 1, 1], abs=0.03)


def test_the_lit_point_keeps_its_colour():
    """Of three bounces, two are on a tinted wall, the lit point's too."""
    found = ratio(lambda: walls_colour(point_laser(diffuse(0.7))))
    assert found == pytest.approx([1, 1, 1], abs=0.05)


def pattern(colours, bounces: int) -> dict:
    """Spots beside the camera's axis, each of its own colour."""
    where = [(0.5, 0.0), (-0.5, 0.0)]
    spots = {
        "spot_positions": mi.TensorXf(np.array(where, np.float32)),
        "spot_sigmas": mi.TensorXf(np.array([0.3, 0.2], np.float32)),
        "spot_intensities": mi.TensorXf(np.array(colours, np.float32)),
    }
    to_world = mi.ScalarTransform4f().look_at(list(DEVICE), [0, 0, 0], [0, 1, 0])
    lamp = {"type": "confocal_projector", "fov": 0.8, "is_confocal": False, "frame": to_world}
    setup = Setup(sensor=DEVICE)
    described = confocal(setup, patch(diffuse(0.7)), film(2, 2), filter_bounces=bounces)
    integrator = {k: v for k, v in described["integrator"].items() if k != "power"}
    return described | {"integrator": integrator | {"confocal_projector": lamp | spots}}


@pytest.mark.parametrize(
    ("colours", "bounces"),
    [
        pytest.param([(1.0, 1.0, 1.0), (3.0, 3.0, 3.0)], 3, id="white"),
        pytest.param([(1.0, 0.5, 0.25), (0.1, 0.8, 0.4)], 1, id="coloured"),
        pytest.param([(0.0, 2.0, 0.0), (0.0, 1.0, 0.0)], 1, id="green"),
    ],
)
def test_a_projectors_spots(colours, bounces):
    describe = {"colours": colours, "bounces": bounces}
    expected = colour(pattern, 1 << 12, **describe)
    mi.set_variant(SPECTRAL)
    found = colour(pattern, 1 << 14, **describe)
    assert found / expected.max() == pytest.approx(expected / expected.max(), abs=0.05)


@pytest.mark.parametrize(
    "power",
    [None, 2.0],
)
def test_a_scenes_laser(power):
    """`transient_nlos_path` asks the scene's own emitter, or gives it a power in watts."""
    options = {} if power is None else {"laser_power": power}
    setup = Setup(sensor=DEVICE, laser=LASER)
    found = ratio(
        lambda: walls_colour(single(setup, patch(diffuse(0.7)), LIT, film(2, 2), **options))
    )
    assert found == pytest.approx([1, 1, 1], abs=0.05)
