"""Derivatives by the coefficients of media that have boundaries of equal index, or are grids."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_of import fog_box, from_above, grid_of, moved_render, tracked
from helpers.support import plane, point_light
from oracles.gradients import Bins

import tofrender

SEEN = Bins(2.0, 0.1, 200, 0.1)
CENTRES = SEEN.centres


FOG = {"type": "homogeneous", "sigma_t": 0.8, "albedo": 0.7}


DENSITY = 1.6 * np.random.default_rng(0).random((4, 4, 4, 1))
SMOKE = grid_of(DENSITY, [-1, -1, 0.2], [2, 2, 1], 0.7)


def load(medium: dict) -> mi.Scene:
    parts = {
        "floor": plane(size=5),
        "box": fog_box(0.2, 1.2, 1, medium),
        "lamp": point_light((0.7, 0.2, 2.5), 1.0),
    }
    return tofrender.load_scene(from_above(3, 20, SEEN, parts, max_depth=5), optimize=False)


class Varied:
    """A scene whose coefficient is multiplied by θ."""

    def __init__(self, medium: dict, coefficient: str) -> None:
        self.scene = load(medium)
        parameters = mi.traverse(self.scene)
        names = [name for name, _ in parameters if f".{coefficient}." in name]
        self.name = next(name for name in names if name.endswith(("data", "value")))
        self.value = dr.detach(parameters[self.name])

    def render(self, theta, spp: int, seed: int = 0):
        value = self.value
        if isinstance(value, mi.TensorXf):
            scaled = mi.TensorXf(value.array * theta, value.shape)
        else:
            scaled = value * theta
        return moved_render(self.scene, self.name, scaled, spp=spp, seed=seed)[1]

    def forward(self, spp: int, seed: int = 0) -> float:
        theta = tracked(1.0)
        transient = self.render(theta, spp, seed)
        dr.forward(theta)
        return moment(dr.grad(transient))

    def reverse(self, spp: int, seed: int = 0) -> float:
        theta = tracked(1.0)
        transient = self.render(theta, spp, seed)
        channels = transient.shape[3]
        weights = np.repeat(CENTRES, channels) / channels
        dr.backward(dr.sum(transient.array * mi.Float(weights.astype(np.float32))))
        return float(dr.grad(theta)[0])


def moment(transient) -> float:
    """Sum of light times length, a mean over colours."""
    return float(np.array(transient, dtype=np.float64).mean(axis=(0, 1, 3)) @ CENTRES)


MEDIA = pytest.mark.parametrize("medium", [FOG, SMOKE], ids=["fog", "smoke"])


@MEDIA
@pytest.mark.parametrize("coefficient", ["sigma_t", "albedo"])
def test_reverse_is_forward_in_media(medium, coefficient):
    varied = Varied(medium, coefficient)
    found = varied.forward(1 << 12, seed=3)
    assert found != 0
    assert varied.reverse(1 << 12, seed=3) == pytest.approx(found, rel=1e-4)


@pytest.mark.statistical
@MEDIA
@pytest.mark.parametrize(("coefficient", "within"), [("sigma_t", 0.1), ("albedo", 0.02)])
def test_media_agree_with_differences(medium, coefficient, within):
    """Differences of flights that other collisions end are noisy themselves: 1 to 2 % here."""
    varied = Varied(medium, coefficient)
    found, right, left = (
        np.mean([of(seed) for seed in range(4)])
        for of in (
            lambda seed: varied.forward(1 << 17, seed),
            lambda seed: moment(varied.render(1.1, 1 << 18, seed)),
            lambda seed: moment(varied.render(0.9, 1 << 18, seed)),
        )
    )
    assert found == pytest.approx((right - left) / 0.2, rel=within)


def test_things_that_move_in_bounded_media_are_refused():
    height = tracked(0.0)
    place = mi.Transform4f().translate([0, 0, height]).scale(5)
    with pytest.raises(RuntimeError) as caught:
        moved_render(load(FOG), "floor.to_world", place, spp=1)
    assert "have no derivatives in a scene with media" in str(caught.value.__cause__)
