"""Derivatives by the coefficients of media that have boundaries of equal index, or are grids."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender
from tofrender.runtime.plugins import own_name

T = mi.ScalarTransform4f
WITHIN = T().translate([-1, -1, 0.2]).scale([2, 2, 1])
CENTRES = 2 + 0.1 * (np.arange(200) + 0.5)


def fog() -> dict:
    return {"type": "homogeneous", "sigma_t": 0.8, "albedo": 0.7}


def smoke() -> dict:
    density = (1.6 * np.random.default_rng(0).random((4, 4, 4, 1))).astype(np.float32)
    grid = {"type": "gridvolume", "to_world": WITHIN, "grid": mi.VolumeGrid(density)}
    return {"type": "heterogeneous", "albedo": 0.7, "sigma_t": grid}


def load(medium: dict) -> mi.Scene:
    film = {"type": own_name("transient_hdr_film"), "width": 1, "height": 1}
    bins = {
        "temporal_bins": 200,
        "start_opl": 2.0,
        "bin_width_opl": 0.1,
        "rfilter": {"type": "box"},
    }
    look = T().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    box = {"type": "cube", "to_world": T().translate([0, 0, 0.7]).scale([1, 1, 0.5])}
    described = {
        "type": "scene",
        "integrator": {
            "type": own_name("transient_path"),
            "max_depth": 5,
            "pulse_width_opl": 0.1,
        },
        "sensor": {"type": "perspective", "fov": 20, "to_world": look, "film": film | bins},
        "floor": {"type": "rectangle", "to_world": T().scale(5)},
        "box": box | {"bsdf": {"type": "null"}, "interior": medium},
        "lamp": {"type": "point", "position": [0.7, 0.2, 2.5], "intensity": 1.0},
    }
    return tofrender.load_scene(described, optimize=False)


def scaled(value, factor):
    if isinstance(value, mi.TensorXf):
        return mi.TensorXf(value.array * factor, value.shape)
    return value * factor


class Varied:
    """A scene whose coefficient is multiplied by θ."""

    def __init__(self, medium: dict, coefficient: str) -> None:
        self.scene = load(medium)
        self.parameters = mi.traverse(self.scene)
        names = [name for name in self.parameters.keys() if f".{coefficient}." in name]  # noqa: SIM118
        self.name = next(name for name in names if name.endswith(("data", "value")))
        self.value = dr.detach(self.parameters[self.name])

    def render(self, theta, spp: int, seed: int = 0):
        self.parameters[self.name] = scaled(self.value, theta)
        self.parameters.update()
        return mi.render(self.scene, self.parameters, spp=spp, seed=seed)[1]

    def forward(self, spp: int, seed: int = 0) -> float:
        theta = mi.Float(1.0)
        dr.enable_grad(theta)
        transient = self.render(theta, spp, seed)
        dr.forward(theta)
        return moment(dr.grad(transient))

    def reverse(self, spp: int, seed: int = 0) -> float:
        theta = mi.Float(1.0)
        dr.enable_grad(theta)
        transient = self.render(theta, spp, seed)
        channels = transient.shape[3]
        weights = np.repeat(CENTRES, channels) / channels
        dr.backward(dr.sum(transient.array * mi.Float(weights.astype(np.float32))))
        return float(dr.grad(theta)[0])


def moment(transient) -> float:
    """Sum of light times length, a mean over colours."""
    return float(np.array(transient, dtype=np.float64).mean(axis=(0, 1, 3)) @ CENTRES)


@pytest.mark.parametrize("medium", [fog, smoke])
@pytest.mark.parametrize("coefficient", ["sigma_t", "albedo"])
def test_reverse_is_forward_in_media(medium, coefficient):
    varied = Varied(medium(), coefficient)
    found = varied.forward(1 << 12, seed=3)
    assert found != 0
    assert varied.reverse(1 << 12, seed=3) == pytest.approx(found, rel=1e-4)


@pytest.mark.statistical
@pytest.mark.parametrize("medium", [fog, smoke])
@pytest.mark.parametrize(("coefficient", "within"), [("sigma_t", 0.1), ("albedo", 0.02)])
def test_media_agree_with_differences(medium, coefficient, within):
    """Differences of flights that other collisions end are noisy themselves: 1 to 2 % here."""
    varied = Varied(medium(), coefficient)
    found = np.mean([varied.forward(1 << 17, seed) for seed in range(4)])
    sides = ((1.1, 1), (0.9, -1))
    apart = np.mean(
        [
            sum(sign * moment(varied.render(theta, 1 << 18, seed)) for theta, sign in sides) / 0.2
            for seed in range(4)
        ]
    )
    assert found == pytest.approx(apart, rel=within)


def test_things_that_move_in_bounded_media_are_refused():
    scene = load(fog())
    parameters = mi.traverse(scene)
    height = mi.Float(0.0)
    dr.enable_grad(height)
    parameters["floor.to_world"] = mi.Transform4f().translate([0, 0, height]).scale(5)
    parameters.update()
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene, parameters, spp=1)
    assert "have no derivatives in a scene with media" in str(caught.value.__cause__)
