"""Derivatives against closed forms where paths choose single directions, and against differences.

First, all around is a sphere of light of radiance 3, so that each way a mirror, a pane or a mask
sends a path has its known light, and so has fog before it. Then media and parameters whose light
has no closed form: there means over seeds are compared, at the suite's alpha.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_cases import eye, flat_film, moved
from helpers.gradient_of import fog_box, from_above, grid_of, moved_render, tracked
from helpers.parts import area_light, diffuse, plane, point_light
from helpers.refusals import innermost_message
from helpers.support import agree, over_seeds, scene
from oracles import gradients as forms

import tofrender

T = mi.ScalarTransform4f
LIGHT = 3.0
ABSORBING = {"type": "homogeneous", "sigma_t": 0.4, "albedo": 0.0}
INDEX = 1.5
ONE_PERCENT = 1e-2
RAY_BINS = forms.Bins(0.0, 2.0, 60, 1.0)


def seen(parts: dict) -> dict:
    """What one ray along -z sees of some things, 3 m before it."""
    return from_above(3, 0.001, RAY_BINS, parts, max_depth=3)


AROUND = {
    "type": "sphere",
    "to_world": T().scale(20.0),
    "flip_normals": True,
    "bsdf": {"type": "diffuse", "reflectance": 0.0},
    "emitter": {"type": "area", "radiance": LIGHT},
}


def plate(bsdf: dict, degrees: float = 0.0) -> dict:
    turned = T().rotate([1, 0, 0], degrees).scale(5)
    return seen({"plate": {"type": "rectangle", "to_world": turned, "bsdf": bsdf}, "all": AROUND})


def fresnel(degrees: float) -> float:
    return forms.fresnel(math.sin(math.radians(degrees)), INDEX)


def tinted(reflectance: float) -> dict:
    return {"type": "conductor", "material": "none", "specular_reflectance": reflectance}


BLEND = {"type": "blendbsdf", "weight": 0.4, "one": tinted(1.0), "two": tinted(0.25)}
MASK = {"type": "mask", "opacity": 0.4, "mirror": tinted(0.25)}
PLASTIC = {"type": "plastic", "int_ior": INDEX, "ext_ior": 1.0, "diffuse_reflectance": 0.0}


def pane(transmitted: float) -> dict:
    """Only what the pane reflects comes back whole."""
    specular = {"specular_reflectance": 1.0, "specular_transmittance": transmitted}
    return {"type": "thindielectric", "int_ior": INDEX, "ext_ior": 1.0} | specular


def turned(degrees: Any) -> Any:
    return mi.Transform4f().rotate([1, 0, 0], degrees).scale(5)


def pane_reflects(degrees: float) -> float:
    """r (1 + t² / (1 - r²)) of all reflections within the pane."""
    r = fresnel(degrees)
    return r + (1 - r) ** 2 * r / (1 - r**2)


@dataclass(frozen=True)
class Case:
    """A parameter, and the light that comes by it."""

    describe: Callable[[], dict]
    key: str
    value: Callable[[Any], Any]
    theta: float
    light: Callable[[float], float]

    def expected(self) -> float:
        right, left = (self.light(self.theta + step) for step in (1e-3, -1e-3))
        return (right - left) / 2e-3

    def render(self) -> tuple[mi.Float, mi.TensorXf]:
        scene = tofrender.load_scene(self.describe(), optimize=False)
        theta = tracked(self.theta)
        return theta, moved_render(scene, self.key, self.value(theta), spp=1 << 17, seed=3)[1]


def sky(medium: dict) -> dict:
    return seen(
        {"fog": fog_box(0.2, 1.2, 6, medium), "sky": {"type": "constant", "radiance": LIGHT}}
    )


def grid(z: float) -> dict:
    return grid_of(np.full((2, 2, 2, 1), 0.4), [-6, -6, z], 12, 0.0)


def in_a_grid() -> dict:
    """The camera is in it, 3 m above where it ends."""
    smoke = {"type": "ref", "id": "smoke"}
    described = sky(smoke) | {"fog": fog_box(0, 4, 6, smoke)}
    described["sensor"]["medium"] = smoke
    return {"type": "scene", "smoke": grid(-6)} | described


def gray(value: Any) -> Any:
    return mi.TensorXf(dr.repeat(value, 8), (2, 2, 2, 1))


SIGMA = "fog.interior_medium.sigma_t"
CASES = {
    "blend of mirrors": Case(
        *(lambda: plate(BLEND), "plate.bsdf.weight.value", mi.Float, 0.4),
        lambda w: LIGHT * (1 - w + 0.25 * w),
    ),
    "mask of a mirror": Case(
        *(lambda: plate(MASK), "plate.bsdf.opacity.value", mi.Float, 0.4),
        lambda o: LIGHT * (1 - o + 0.25 * o),
    ),
    "pane": Case(
        *(lambda: plate(pane(0.0), 60.0), "plate.to_world", turned, 60.0),
        lambda degrees: LIGHT * pane_reflects(degrees),
    ),
    "plastic": Case(
        *(lambda: plate(PLASTIC, 60.0), "plate.to_world", turned, 60.0),
        lambda degrees: LIGHT * fresnel(degrees),
    ),
    "fog before a sky": Case(
        *(lambda: sky(ABSORBING), f"{SIGMA}.value.value", mi.Float, 0.4),
        lambda σ: LIGHT * math.exp(-σ),
    ),
    "grid before a sky": Case(
        *(lambda: sky(grid(0)), f"{SIGMA}.data", gray, 0.4), lambda σ: LIGHT * math.exp(-σ)
    ),
    "in a grid under a sky": Case(
        *(in_a_grid, "smoke.sigma_t.data", gray, 0.4), lambda σ: LIGHT * math.exp(-3 * σ)
    ),
}


def light_of(transient: Any) -> float:
    """All of it, in the mean of colors."""
    return float(np.array(transient, dtype=float).mean(axis=3).sum())


def forward(case: Case) -> tuple[float, float]:
    """The light, and its derivative."""
    theta, transient = case.render()
    value = light_of(dr.detach(transient))
    dr.forward(theta)
    return value, light_of(dr.grad(transient))


@pytest.mark.parametrize("name", CASES)
def test_forward_and_reverse_are_the_closed_form(name):
    case = CASES[name]
    value, found = forward(case)
    assert value == pytest.approx(case.light(case.theta), rel=ONE_PERCENT)
    theta, transient = case.render()
    dr.backward(dr.sum(transient.array) / transient.shape[3])
    assert found == pytest.approx(case.expected(), rel=ONE_PERCENT)
    assert dr.grad(theta)[0] == pytest.approx(found, rel=1e-3)


MIXED = {
    "blend of mirror and diffuse": BLEND | {"two": {"type": "diffuse"}},
    "mask over a pane": {"type": "mask", "opacity": 0.5, "pane": pane(1.0)},
    "mask over a blend": {"type": "mask", "opacity": 0.5, "blend": BLEND},
}


@pytest.mark.parametrize("name", MIXED)
def test_mixtures_whose_chances_are_not_known(name):
    scene = tofrender.load_scene(plate(MIXED[name]), optimize=False)
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters["all.emitter.radiance.value"])
    parameters.update()
    text = innermost_message(lambda: mi.render(scene, parameters, spp=1))
    assert "not supported. Use a material" in text


AXIS = forms.Bins(2.0, 0.1, 200, 0.1)
CENTERS = AXIS.centers
FOG = {"type": "homogeneous", "sigma_t": 0.8, "albedo": 0.7}
DENSITY = 1.6 * np.random.default_rng(0).random((4, 4, 4, 1))
SMOKE = grid_of(DENSITY, [-1, -1, 0.2], [2, 2, 1], 0.7)


def foggy(medium: dict) -> mi.Scene:
    parts = {
        "floor": plane(size=5),
        "box": fog_box(0.2, 1.2, 1, medium),
        "lamp": point_light((0.7, 0.2, 2.5), 1.0),
    }
    return tofrender.load_scene(from_above(3, 20, AXIS, parts, max_depth=5), optimize=False)


class Varied:
    """A scene whose coefficient is multiplied by θ."""

    def __init__(self, medium: dict, coefficient: str) -> None:
        self.scene = foggy(medium)
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
        weights = np.repeat(CENTERS, channels) / channels
        dr.backward(dr.sum(transient.array * mi.Float(weights.astype(np.float32))))
        return float(dr.grad(theta)[0])


def moment(transient) -> float:
    """Sum of light times length, a mean over colors."""
    return float(np.array(transient, dtype=np.float64).mean(axis=(0, 1, 3)) @ CENTERS)


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
        moved_render(foggy(FOG), "floor.to_world", place, spp=1)
    assert "in scenes with grids or with index-matched boundaries" in str(caught.value.__cause__)


SEEN = forms.Bins(0.5, 0.25, 44, 0.25)
VIEW = forms.View((0.3, -1.2, 1.6), (0, 0, 0), 25, (0, 0, 1))


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
        right, left = (fours(self.render(self.theta + s * self.step, seed)) for s in (1, -1))
        return (right - left) / (2 * self.step)

    def forward(self, seed: int) -> np.ndarray:
        theta = tracked(self.theta)
        transient = self.render(theta, seed)
        dr.forward(theta)
        return fours(dr.grad(transient))


def fours(values: Any) -> np.ndarray:
    """Every four bins together, all pixels and colors."""
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
