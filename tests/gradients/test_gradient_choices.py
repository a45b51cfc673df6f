"""Derivatives through choices between single directions, and out of fog: against closed forms.

All around is a sphere of light of radiance 3, so that each way a mirror, a pane or a mask sends a
path has its known light.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender
from tofrender.paths.choices import Choices
from tofrender.runtime.plugins import own_name

T = mi.ScalarTransform4f
LIGHT = 3.0
INDEX = 1.5
ONE_PERCENT = 1e-2


def seen(parts: dict, **integrator: Any) -> dict:
    """What one ray along -z sees of some things, 3 m before it."""
    film = {"type": own_name("transient_hdr_film"), "width": 1, "height": 1}
    bins = {"temporal_bins": 60, "start_opl": 0.0, "bin_width_opl": 2.0, "rfilter": {"type": "box"}}
    look = T().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    way = {"type": own_name("transient_path"), "max_depth": 3, "pulse_width_opl": 1.0}
    return {
        "type": "scene",
        "integrator": way | integrator,
        "sensor": {"type": "perspective", "fov": 0.001, "to_world": look, "film": film | bins},
    } | parts


def around(radius: float = 20.0) -> dict:
    """A sphere of light without a material that reflects."""
    lamp = {"type": "area", "radiance": LIGHT}
    black = {"type": "diffuse", "reflectance": 0.0}
    place = T().scale(radius)
    return {
        "type": "sphere",
        "to_world": place,
        "flip_normals": True,
        "bsdf": black,
        "emitter": lamp,
    }


def plate(bsdf: dict, degrees: float = 0.0) -> dict:
    turned = T().rotate([1, 0, 0], degrees).scale(5)
    return seen({"plate": {"type": "rectangle", "to_world": turned, "bsdf": bsdf}, "all": around()})


def fresnel(degrees: float) -> float:
    """The share that an interface of the index 1.5 reflects, of unpolarised light."""
    cos = math.cos(math.radians(degrees))
    inside = math.sqrt(1 - (1 - cos**2) / INDEX**2)
    s = (cos - INDEX * inside) / (cos + INDEX * inside)
    p = (INDEX * cos - inside) / (INDEX * cos + inside)
    return (s**2 + p**2) / 2


def tinted(reflectance: float) -> dict:
    return {"type": "conductor", "material": "none", "specular_reflectance": reflectance}


def blend(**others: Any) -> dict:
    return {"type": "blendbsdf", "weight": 0.4, "one": tinted(1.0), "two": tinted(0.25)} | others


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


def hemisphere_of_plastic() -> dict:
    coat = {"type": "plastic", "int_ior": INDEX, "ext_ior": 1.0, "diffuse_reflectance": 0.0}
    return plate(coat, 60.0)


@dataclass(frozen=True)
class Case:
    """A parameter, and the light that comes by it."""

    describe: Callable[[], dict]
    key: str
    value: Callable[[Any], Any]
    theta: float
    light: Callable[[float], float]
    step: float = 1e-3

    def expected(self) -> float:
        return (self.light(self.theta + self.step) - self.light(self.theta - self.step)) / (
            2 * self.step
        )

    def render(self, spp: int) -> tuple[mi.Float, mi.TensorXf]:
        scene = tofrender.load_scene(self.describe(), optimize=False)
        parameters, theta = mi.traverse(scene), mi.Float(self.theta)
        dr.enable_grad(theta)
        parameters[self.key] = self.value(theta)
        parameters.update()
        return theta, mi.render(scene, parameters, spp=spp, seed=3)[1]


def sky(medium: dict) -> dict:
    box = {"type": "cube", "to_world": T().translate([0, 0, 0.7]).scale([6, 6, 0.5])}
    fog = box | {"bsdf": {"type": "null"}, "interior": medium}
    return seen({"fog": fog, "sky": {"type": "constant", "radiance": LIGHT}})


def grid(value: float, place: Any) -> dict:
    density = mi.VolumeGrid(np.full((2, 2, 2, 1), value, np.float32))
    volume = {"type": "gridvolume", "to_world": place, "grid": density}
    return {"type": "heterogeneous", "albedo": 0.0, "sigma_t": volume}


def in_a_grid() -> dict:
    """The camera is in it, 3 m above where it ends."""
    smoke = grid(0.4, T().translate([-6, -6, -6]).scale(12))
    box = {"type": "cube", "to_world": T().translate([0, 0, 2]).scale([6, 6, 2])}
    fog = box | {"bsdf": {"type": "null"}, "interior": {"type": "ref", "id": "smoke"}}
    parts = {"smoke": smoke, "fog": fog, "sky": {"type": "constant", "radiance": LIGHT}}
    described = seen(parts)
    described["sensor"]["medium"] = {"type": "ref", "id": "smoke"}
    return {"type": "scene", "smoke": described.pop("smoke")} | described


def grey(value: Any) -> Any:
    return mi.TensorXf(dr.repeat(value, 8), (2, 2, 2, 1))


def absorbing() -> dict:
    return {"type": "homogeneous", "sigma_t": 0.4, "albedo": 0.0}


CASES = {
    "blend of mirrors": Case(
        lambda: plate(blend()),
        "plate.bsdf.weight.value",
        mi.Float,
        0.4,
        lambda w: LIGHT * (1 - w + 0.25 * w),
    ),
    "mask of a mirror": Case(
        lambda: plate({"type": "mask", "opacity": 0.4, "mirror": tinted(0.25)}),
        "plate.bsdf.opacity.value",
        mi.Float,
        0.4,
        lambda o: LIGHT * (1 - o + 0.25 * o),
    ),
    "pane": Case(
        lambda: plate(pane(0.0), 60.0),
        "plate.to_world",
        turned,
        60.0,
        lambda degrees: LIGHT * pane_reflects(degrees),
    ),
    "plastic": Case(
        hemisphere_of_plastic,
        "plate.to_world",
        turned,
        60.0,
        lambda degrees: LIGHT * fresnel(degrees),
    ),
    "fog before a sky": Case(
        lambda: sky(absorbing()),
        "fog.interior_medium.sigma_t.value.value",
        mi.Float,
        0.4,
        lambda σ: LIGHT * math.exp(-σ),
    ),
    "grid before a sky": Case(
        lambda: sky(grid(0.4, T().translate([-6, -6, 0]).scale(12))),
        "fog.interior_medium.sigma_t.data",
        grey,
        0.4,
        lambda σ: LIGHT * math.exp(-σ),
    ),
    "in a grid under a sky": Case(
        in_a_grid,
        "smoke.sigma_t.data",
        grey,
        0.4,
        lambda σ: LIGHT * math.exp(-3 * σ),
    ),
}


def light_of(transient: Any) -> float:
    """All of it, in the mean of colours."""
    return float(np.array(transient, dtype=float).mean(axis=3).sum())


def forward(case: Case) -> tuple[float, float]:
    """The light, and its derivative."""
    theta, transient = case.render(1 << 17)
    value = light_of(dr.detach(transient))
    dr.forward(theta)
    return value, light_of(dr.grad(transient))


@pytest.mark.parametrize("name", CASES)
def test_forward_and_reverse_are_the_closed_form(name):
    case = CASES[name]
    value, found = forward(case)
    assert value == pytest.approx(case.light(case.theta), rel=ONE_PERCENT)
    theta, transient = case.render(1 << 17)
    dr.backward(dr.sum(transient.array) / transient.shape[3])
    assert found == pytest.approx(case.expected(), rel=ONE_PERCENT)
    assert dr.grad(theta)[0] == pytest.approx(found, rel=1e-3)


@pytest.mark.parametrize("name", ["blend of mirrors", "pane", "mask of a mirror"])
def test_choices_whose_chance_counts_once_too_little_or_too_much(name, monkeypatch):
    case, right = CASES[name], Choices.change

    def wrong(self: Choices, bsdf: Any, pdf: Any, specular: Any) -> Any:
        return 1 / right(Choices(mi.load_dict({"type": "scene"})), bsdf, pdf, specular)

    nothing = name != "mask of a mirror"
    monkeypatch.setattr(Choices, "change", (lambda *_: 1) if nothing else wrong)
    assert forward(case)[1] != pytest.approx(case.expected(), rel=0.1)


MIXED = {
    "blend of mirror and diffuse": {
        "type": "blendbsdf", "weight": 0.5, "one": tinted(1.0), "two": {"type": "diffuse"},
    },
    "mask over a pane": {"type": "mask", "opacity": 0.5, "pane": pane(1.0)},
    "both sides of it": {
        "type": "twosided", "it": {"type": "mask", "opacity": 0.5, "blend": blend()},
    },
}  # fmt: skip


@pytest.mark.parametrize("name", MIXED)
def test_mixtures_whose_chances_are_not_known(name):
    bsdf = MIXED[name]
    if bsdf["type"] == "twosided":
        bsdf = bsdf["it"]  # Mitsuba's takes no transmission
    scene = tofrender.load_scene(plate(bsdf), optimize=False)
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters["all.emitter.radiance.value"])
    parameters.update()
    with pytest.raises(ValueError, match="has no derivatives; must be a material") as caught:
        tofrender.render(scene, params=parameters, spp=1)
    assert "\n" not in str(caught.value)
