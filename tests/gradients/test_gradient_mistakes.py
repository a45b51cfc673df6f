"""Mistakes planted into the derivatives are found by the table's tests.

Each one replaces a function of the package by a wrong one, made of the right one. `TARGETS` names
these functions. Each is replaced once the variant is set, since plugins belong to one.
"""

import importlib
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers import gradient_cases as cases
from helpers.gradient_of import Case, forward, reverse
from helpers.parts import area_light
from helpers.support import over_seeds
from oracles.gradients import Bins

SEEDS = range(6)
HALF_PERCENT = 5e-3

TARGETS = {
    "length of light": "tofrender.gradients.films:Collected.add",
    # Slides along the camera's ray: its Jacobian is 1. Where it follows its surface instead, the
    # Jacobian of the camera's rays belongs to it
    "first vertex": "tofrender.paths.space:Vacuum.next_vertex",
    # Of a connection; that of a hit is another function
    "share of a link": "tofrender.paths.endpoints.scene_lights:SceneLights.mis_weight",
    # What it has of the index of refraction behind it
    "bounce": "tofrender.paths.scattering:Materials.sample",
    # Which contributions count
    "active lanes": "tofrender.paths.walk:accumulate",
    # Of a vertex that follows its surface, and the same with the cosine and the distance there
    "area Jacobian": "tofrender.gradients.detached:element",
    "solid angle": "tofrender.gradients.detached:changing",
    # The energy of a pulse up to a length
    "pulse": "tofrender.signals.pulses:GaussianPulse.cdf",
}
"""What is replaced -> "module:name" or "module:Class.name"."""


class Mistake(NamedTuple):
    """A function of `TARGETS`, the right one -> a wrong one, and a case's number that it changes.

    The options are those of the integrator under which it is looked for.
    """

    what: str
    wrong: Callable[[Callable], Callable]
    case: Case
    measure: str
    options: dict[str, Any] = {}  # noqa: RUF012 (nobody changes it)


def attached_by(value: Any, factor: float) -> Any:
    """A value whose derivative is another one, times a number."""
    still = dr.detach(value)
    return still + factor * (value - still)


def shift(factor: float) -> Callable[[Callable], Callable]:
    """Light, whose length changes by that times its change."""
    return lambda right: (
        lambda measurement, light: right(
            measurement, replace(light, opl=attached_by(light.opl, factor))
        )
    )


def width(factor: float) -> Callable[[Callable], Callable]:
    """A pulse, whose width changes by that times its change."""

    def planted(right: Callable) -> Callable:
        def wrong(pulse: Any, t: Any) -> Any:
            other = copy(pulse)
            if other._width is not None:
                other._width = attached_by(other._width, factor)
            return right(other, t)

        return wrong

    return planted


def detached(right: Callable) -> Callable:
    """Its result without derivative."""
    return lambda *args, **kwargs: dr.detach(right(*args, **kwargs))


def following_surface(right: Callable) -> Callable:
    """The first vertex keeps its place on the surface, as if rays did not choose it."""

    def wrong(space: Any, path: Any, sampler: Any) -> Any:
        path, vertex = right(space, path, sampler)
        flags = mi.RayFlags.All | mi.RayFlags.FollowShape
        si = space.scene.ray_intersect(path.ray, flags, False, path.active)
        first = path.depth == 0
        vertex.si.p = dr.select(first, si.p, vertex.si.p)
        length = dr.norm(si.p - path.prev.p)
        return path, replace(vertex, length=dr.select(first, length, vertex.length))

    return wrong


def index_left_out(right: Callable) -> Callable:
    """A bounce whose index does not change."""

    def wrong(*args: Any) -> Any:
        turn, bounce = right(*args)
        bounce.η = dr.detach(bounce.η)
        return turn, bounce

    return wrong


def all_lanes(right: Callable) -> Callable:
    """Contributions of lanes that are masked count as well."""
    return lambda measurement, light: right(measurement, replace(light, active=mi.Bool(True)))


HITS = {"emitter_sampling": False}
ATTACHED = {"gradient_sampling": "attached"}
NEAR = Bins(1.7, 0.05, 66, 0.05)


def glowing_scene() -> dict:
    """A floor whose own light comes straight to the camera, and does not count."""
    described = cases.floor_scene(seen=NEAR)
    described["floor"]["emitter"] = area_light(1.0)
    described["integrator"]["discard_direct_light"] = True
    return described


GLOWING = replace(cases.PLANE, scene="a floor that glows", describe=glowing_scene, seen=NEAR)

MISTAKES = {
    "shift left out": Mistake("length of light", shift(0), cases.PLANE_2, "moment"),
    "shift left out, phase": Mistake("length of light", shift(0), cases.MIRROR_2, "correlation"),
    "shift left out, hidden": Mistake("length of light", shift(0), cases.DEPTH, "moment"),
    "shift with the other sign": Mistake("length of light", shift(-1), cases.PLANE_2, "moment"),
    "shift twice": Mistake("length of light", shift(2), cases.CORRIDOR, "moment"),
    "first Jacobian left out": Mistake("first vertex", following_surface, cases.PLANE_2, "sum"),
    "first Jacobian left out, moment": Mistake(
        "first vertex", following_surface, cases.PLANE_2, "moment"
    ),
    "area Jacobian without derivative": Mistake("area Jacobian", detached, cases.RADIUS, "sum"),
    "area Jacobian of a lamp left out": Mistake(
        "area Jacobian", detached, cases.RADIUS_2, "sum", HITS
    ),
    "solid angle without derivative": Mistake("solid angle", detached, cases.CORRIDOR, "sum"),
    "weights of one strategy attached": Mistake("share of a link", detached, cases.LIGHT_2, "sum"),
    "index not attached": Mistake("bounce", index_left_out, cases.INDEX_2, "moment", ATTACHED),
    "derivative of masked lanes": Mistake("active lanes", all_lanes, GLOWING, "moment"),
    "width left out": Mistake("pulse", width(0), cases.PULSE, "square"),
    "width with the other sign": Mistake("pulse", width(-1), cases.PULSE, "square"),
}


def plant(monkeypatch: pytest.MonkeyPatch, mistake: Mistake) -> None:
    """Put the wrong function in place of the right one."""
    module, _, name = TARGETS[mistake.what].partition(":")
    owner: Any = importlib.import_module(module)
    *outer, last = name.split(".")
    for each in outer:
        owner = getattr(owner, each)
    monkeypatch.setattr(owner, last, mistake.wrong(getattr(owner, last)))


def deviation(mistake: Mistake) -> tuple[np.ndarray, float]:
    """Relative errors of forward mode over seeds, and of reverse mode."""
    case = mistake.case
    weights = case.weights()[mistake.measure]
    expected = float(weights @ case.expected()[1])
    found = over_seeds(lambda seed: forward(case, seed=seed, **mistake.options) @ weights, SEEDS)
    backward = reverse(case, weights, seed=SEEDS[0], **mistake.options)
    return found / expected - 1, backward / expected - 1


@pytest.mark.statistical
@pytest.mark.parametrize("name", MISTAKES)
def test_planted_mistakes_are_found(name, monkeypatch):
    """What is wrong is off by more than the table allows, surely, in the mode that it is made in.

    The same measure of the right code is within it: `test_gradient_table.py`.
    """
    mistake = MISTAKES[name]
    plant(monkeypatch, mistake)
    off, off_backward = deviation(mistake)
    surely = abs(off.mean()) - 5 * off.std(ddof=1) / np.sqrt(off.size)
    not_a_number = not np.isfinite(off).all() or not np.isfinite(off_backward)
    assert not_a_number or max(surely, abs(off_backward)) > 2 * HALF_PERCENT, (off, off_backward)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["area Jacobian of a lamp left out", "derivative of masked lanes"])
def test_right_code_is_right_where_the_table_does_not_look(name):
    off, off_backward = deviation(MISTAKES[name])
    assert abs(off.mean()) < HALF_PERCENT
    assert abs(off_backward) < 2 * HALF_PERCENT  # Of one seed
