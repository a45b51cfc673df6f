"""Derivatives by parameters whose light has no closed form, against differences of renders.

Both are estimates with noise: means over seeds are compared, bins by bins, at the suite's alpha.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_cases import eye, flat_film, moved
from helpers.gradient_of import moved_render, tracked
from helpers.support import agree, area_light, diffuse, over_seeds, plane, point_light, scene
from oracles.gradients import Bins, View

import tofrender

SEEN = Bins(0.5, 0.25, 44, 0.25)
VIEW = View((0.3, -1.2, 1.6), (0, 0, 0), 25, (0, 0, 1))


@dataclass(frozen=True)
class Setting:
    """A parameter of a scene: its key, θ -> its value, θ, half the step of differences."""

    describe: Callable[[], dict]
    key: str
    value: Callable[[Any], Any]
    theta: float
    step: float
    spp: int = 1 << 13

    def render(self, theta: Any, seed: int) -> Any:
        loaded = tofrender.load_scene(self.describe(), optimize=False)
        return moved_render(loaded, self.key, self.value(theta), spp=self.spp, seed=seed)[1]

    def differences(self, seed: int) -> np.ndarray:
        right, left = (bins(self.render(self.theta + s * self.step, seed)) for s in (1, -1))
        return (right - left) / (2 * self.step)

    def forward(self, seed: int) -> np.ndarray:
        theta = tracked(self.theta)
        transient = self.render(theta, seed)
        dr.forward(theta)
        return bins(dr.grad(transient))


def bins(values: Any) -> np.ndarray:
    """Every four bins together, all pixels and colours."""
    return np.array(values, np.float64).mean(axis=(0, 1, 3)).reshape(-1, 4).sum(axis=1)


def lit_by_panel(floor: dict | None = None, **integrator: Any) -> dict:
    """A floor of some material under a panel of light, and a diffuse wall behind it."""
    under = mi.ScalarTransform4f().translate([0, 0.4, 1.4]).rotate([1, 0, 0], 180)
    wall = mi.ScalarTransform4f().translate([0, 1.5, 0]).rotate([1, 0, 0], 90)
    parts = {
        "floor": plane(bsdf=floor or diffuse(0.5)),
        "wall": plane(wall, bsdf=diffuse(0.6)),
        "lamp": plane(under, 0.4, bsdf=diffuse(0), emitter=area_light(5.0)),
    }
    plain = {"max_depth": 4, "rr_depth": 99, "pulse_width_opl": SEEN.sigma}
    return scene(parts, eye(VIEW, flat_film(SEEN)), **plain | integrator)


def rough() -> dict:
    return lit_by_panel({"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"})


def principled() -> dict:
    return lit_by_panel({"type": "principled", "roughness": 0.5, "specular": 0.6})


TEXELS = np.linspace(0.2, 0.8, 12, dtype=np.float32)


def checked() -> dict:
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(TEXELS.reshape(2, 2, 3)), "raw": True}
    return lit_by_panel({"type": "diffuse", "reflectance": texture})


def hazy() -> dict:
    haze = {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.8, "phase": {"type": "hg", "g": 0.3}}
    described = lit_by_panel(type="transient_volpath")
    described["sensor"]["medium"] = haze
    return described


def spot_lit() -> dict:
    place = mi.ScalarTransform4f().look_at([0.2, 0.1, 2], [0, 0, 0], [0, 1, 0])
    spot = {"type": "spot", "intensity": 3.0, "to_world": place, "cutoff_angle": 40.0}
    return {k: v for k, v in lit_by_panel().items() if k != "lamp"} | {"spot": spot}


def glass_before_floor() -> dict:
    """Rough glass that bends what the camera and the lamp see of the floor."""
    glass = {"type": "roughdielectric", "int_ior": 1.4, "alpha": 0.2}
    block = mi.ScalarTransform4f().translate([0, 0, 0.5]).scale([3, 3, 0.1])
    return lit_by_panel(max_depth=6) | {"glass": {"type": "cube", "to_world": block, "bsdf": glass}}


def single_vertex() -> dict:
    """A triangle mesh as floor, one vertex of which is lifted."""
    below = mi.ScalarTransform4f().translate([0, 0, -1])
    cube = {"type": "cube", "to_world": below, "bsdf": diffuse(0.5)}
    return lit_by_panel() | {"floor": cube, "lamp2": point_light((0.2, 0.3, 1.2), 1.0)}


def lifted(theta: Any) -> Any:
    """Positions of the cube of `single_vertex`, its top four corners lifted by θ."""
    loaded = tofrender.load_scene(single_vertex(), optimize=False)
    positions = mi.Float(mi.traverse(loaded)["floor.vertex_positions"])
    top = (dr.arange(mi.UInt32, dr.width(positions)) % 3 == 2) & (positions > -0.5)
    return positions + dr.select(top, mi.Float(theta), 0)


PANEL = np.diag([0.4, -0.4, -1, 1])
PANEL[1, 3] = 0.4
SETTINGS = {
    "roughness": Setting(rough, "floor.bsdf.alpha.value", mi.Float, 0.3, 0.02),
    "roughness, principled": Setting(principled, "floor.bsdf.roughness.value", mi.Float, 0.5, 0.03),
    "texture": Setting(
        *(checked, "floor.bsdf.reflectance.data"),
        *(lambda a: mi.TensorXf(mi.Float(TEXELS) * a, (2, 2, 3)), 1.0, 0.05),
    ),
    "extinction": Setting(hazy, "sensor.medium.sigma_t.value.value", mi.Float, 0.3, 0.02, 1 << 15),
    "albedo of a medium": Setting(
        *(hazy, "sensor.medium.albedo.value.value", mi.Float, 0.7, 0.05, 1 << 15)
    ),
    "spot": Setting(spot_lit, "spot.intensity.value", mi.Float, 3.0, 0.2),
    "rough glass, index": Setting(
        *(glass_before_floor, "glass.bsdf.eta", mi.Float, 1.4, 0.03, 1 << 15)
    ),
    "rough glass, roughness": Setting(
        *(glass_before_floor, "glass.bsdf.alpha.value", mi.Float, 0.2, 0.02, 1 << 15)
    ),
    "panel of light": Setting(
        *(lit_by_panel, "lamp.to_world", moved((0, 0, 1), lambda: PANEL), 1.4, 0.02)
    ),
    "vertices": Setting(single_vertex, "floor.vertex_positions", lifted, 0.0, 0.01),
}


@pytest.mark.statistical
@pytest.mark.parametrize("name", SETTINGS)
def test_derivative_agrees_with_differences(name):
    setting = SETTINGS[name]
    found = over_seeds(setting.forward, range(12))
    expected = over_seeds(setting.differences, range(100, 112))
    assert agree(found, expected, rounding=1e-2)
    scale = np.abs(expected.mean(axis=0)).sum()
    error = np.abs(found.mean(axis=0) - expected.mean(axis=0)).sum()
    assert error < 0.1 * scale
    assert not agree(1.3 * found, expected, rounding=1e-2)
