"""Scenes that are found again from their film: a wall, a lamp, and a patch around the corner."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import diffuse, plane, point_light, rotate, translate
from helpers.support import camera, film, scene

import tofrender
from tofrender.integrators.differentiable import VisibilityWarning

LAMP, POWER = "lamp.position", "lamp.intensity.value"
SIDE = 0.1
WINDOW = {"width": 8, "height": 8, "bins": 120, "bin_width": 0.05}


def in_time(max_depth: int, view: dict, **parts: Any) -> mi.Scene:
    described = scene(parts, view, max_depth=max_depth, pulse_width_opl=0.1)
    return mi.load_dict(described)


def seen_wall(depth: float, albedo: float) -> mi.Scene:
    """A camera with a flash before a wall."""
    return in_time(
        2,
        camera((0, 0, 0), (0, 0, 1), film(start=1.5, **WINDOW), fov=40),
        flash=point_light((0.1, 0, 0), 5.0),
        wall=plane(translate(0, 0, depth) @ rotate((0, 1, 0), 180), 3, bsdf=diffuse(albedo)),
    )


def move_wall(params, values):
    move = mi.Transform4f().translate(values["depth"] * mi.Vector3f(0, 0, 1))
    params["wall.to_world"] = move.rotate([0, 1, 0], 180).scale([3, 3, 1])
    params["wall.bsdf.reflectance.value"] = mi.Color3f(values["albedo"])


def corner(position: Any, power: float) -> mi.Scene:
    """A lamp in the corner of a room, which the camera does not see."""
    return in_time(
        3,
        camera((2, 2, 2), (0, 0, 0), film(start=2.5, **WINDOW), fov=30),
        lamp=point_light(position, power),
        floor=plane(translate(1, 0, 1) @ rotate((1, 0, 0), -90), 1, bsdf=diffuse(0.6)),
        back=plane(translate(1, 1, 0), 1, bsdf=diffuse(0.6)),
        left=plane(translate(0, 1, 1) @ rotate((0, 1, 0), 90), 1, bsdf=diffuse(0.6)),
    )


def move_lamp(params, values):
    params[LAMP] = mi.Point3f(values[LAMP])
    params[POWER] = mi.Color3f(values[POWER])


def hidden_patch(place: Any, tilt: float) -> mi.Scene:
    """A patch before a wall that is scanned confocally, seen in light of three bounces."""
    bins = {"temporal_bins": 100, "start_opl": 1.6, "bin_width_opl": 0.02}
    scene = tofrender.nlos_patch(side=SIDE, position=place, tilt=tilt, width=8, height=8, **bins)
    paths = {"capture_type": "confocal", "filter_bounces": 3, "max_depth": 4}
    scene["integrator"] |= paths | {"pulse_width_opl": 0.05}
    return mi.load_dict(scene, optimize=False)


def move_patch(params, values):
    turned = mi.Transform4f().translate(values["place"]).rotate([0, 1, 0], 180 + values["tilt"])
    params["hidden_patch.to_world"] = turned.scale([SIDE / 2, SIDE / 2, 1])


@dataclass
class Problem:
    """A scene to find."""

    scene: Callable[..., mi.Scene]  # makes it of values
    apply: Callable[[mi.SceneParameters, dict[str, Any]], None]  # writes values into it
    # name -> true value, where the fit starts, learning rate, how far from the truth it may end
    values: dict[str, tuple[Any, Any, float, float]]
    spp: int  # samples per pixel
    of_target: int = 1024  # those of what was measured
    bounds: dict[str, Any] = field(default_factory=dict)  # those of the values

    def __post_init__(self) -> None:
        self.true, self.start, self.rates, self.within = (
            dict(zip(self.values, each, strict=True))
            for each in zip(*self.values.values(), strict=True)
        )

    def measured(self) -> Any:
        return mi.render(self.scene(*self.true.values()), spp=self.of_target)

    def off(self, values: dict[str, Any]) -> dict[str, float]:
        return {k: float(np.linalg.norm(np.subtract(values[k], v))) for k, v in self.true.items()}

    def fit(self, **options: Any) -> tofrender.Fit:
        made = self.scene(*self.start.values())
        options |= {"apply": self.apply, "learning_rate": self.rates, "bounds": self.bounds}
        return tofrender.fit(
            made, self.start, self.measured(), spp=self.spp, progress=False, **options
        )


PROBLEMS = {
    "wall": Problem(
        seen_wall,
        move_wall,
        {"depth": (2.0, 2.5, 0.03, 2e-3), "albedo": (0.7, 0.3, 0.03, 3e-3)},
        spp=16,
        bounds={"depth": (0.5, 3.5), "albedo": (0.01, 1)},
    ),
    "lamp": Problem(
        corner,
        move_lamp,
        {LAMP: ([0.5, 1.2, 0.8], [0.9, 0.7, 0.4], 0.04, 0.01), POWER: (3.0, 1.0, 0.1, 0.06)},
        spp=128,
        of_target=4096,
    ),
    "patch": Problem(  # Starts ten centimeters off
        hidden_patch,
        move_patch,
        {
            "place": ([0.2, 0.1, 1.0], [0.26, 0.16, 1.053], 0.01, 1e-3),
            "tilt": (20.0, 35.0, 2.0, 0.1),
        },
        spp=64,
    ),
}


def along(problem: Problem, loss: Callable[[Any, Any], Any], points: int = 9) -> np.ndarray:
    """Losses on the straight line from start to truth."""
    scene, measured = problem.scene(*problem.start.values()), problem.measured()[1]
    params = mi.traverse(scene)
    found = []
    for part in np.linspace(0, 1, points):
        values = {}
        for name, true in problem.true.items():
            start = np.array(problem.start[name], float)
            between = (start + part * (np.array(true) - start)).tolist()
            values[name] = mi.Float(between) if start.ndim == 0 else mi.Vector3f(*between)
        problem.apply(params, values)
        params.update()
        light = mi.render(scene, spp=problem.spp, seed=3)[1]
        found.append(float(np.array(loss(light, measured)).item()))
    return np.array(found)


@pytest.mark.parametrize("name", PROBLEMS)
def test_arrival_times_fall_on_the_way(name):
    assert np.all(np.diff(along(PROBLEMS[name], tofrender.wasserstein_loss)) < 0)


@pytest.mark.parametrize("name", PROBLEMS)
def test_is_found(name):
    problem = PROBLEMS[name]
    found = problem.fit(loss="wasserstein", steps=120)
    off = problem.off(found.values)
    assert all(off[each] < limit for each, limit in problem.within.items()), found


def test_warns_once_of_what_becomes_hidden():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        PROBLEMS["wall"].fit(steps=3)
    assert [each.category for each in caught] == [VisibilityWarning]
    assert str(caught[0].message).startswith("params = 'wall.to_world': ")
