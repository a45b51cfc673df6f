"""The strategies that find a path share its light: path by path, their shares add up to 1.

Complete paths of up to five segments, through all kinds of materials, to all kinds of lights, are
walked again from both ends (`replayed_paths.py`). Each share is also compared with the plain
definition, by full products of densities in double precision.
"""

import functools
import math
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.light_paths import GLASS, MIRROR, ball, facing_down, spot
from helpers.mistakes import gives_other, of_other
from helpers.parts import area_light, diffuse, gray, plane, point_light, rotate, translate, unit
from helpers.scenes import numbers
from helpers.support import camera, film, load, scene
from oracles.light_paths import window_area
from oracles.replayed_paths import LONGEST, WIDE, Paths, Products, shares, started

from tofrender.bidirectional.emission import Emission
from tofrender.bidirectional.lens import Lens
from tofrender.bidirectional.lens_connections import LensEndpoint
from tofrender.bidirectional.light_paths import LightPaths, VertexConnection
from tofrender.bidirectional.mis import BidirectionalMIS, PartialSums
from tofrender.paths.records import Vertex
from tofrender.paths.scattering import Materials

LANES = 8192
ROUNDING = 1e-5  # What single precision may make of a share; it makes 5e-7

EYE, TARGET, FOV = (0.3, -2.6, 1.2), (0, 0, 0.7), 50.0
VIEWS = {
    "off center": {"principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1},
    "thin lens": {"kind": "thinlens", "aperture_radius": 0.15, "focus_distance": 2.5},
}
BALLS = (-0.5, 0.4, 0.3), (0.4, 0.3, 0.3), (0.0, -0.2, 0.3)
METAL = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3, "material": "none"}
FROSTED = GLASS | {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}


def lights() -> dict:
    return {
        "globe": ball((-0.3, -0.3, 1.2), 0.2, emitter=area_light(3.0)),
        "spot": spot((0.6, -0.6, 1.8), (0, 0, 0.4), 30, 35, 5.0),
        "sun": {"type": "directional", "direction": [0.2, 0.6, -0.7], "irradiance": gray(1.0)},
        "sky": {"type": "constant", "radiance": gray(0.5)},
    }


def room(view: str, plain: bool = False) -> dict:
    """Half a box with balls and lamps, under a sky; a plain one has few kinds of each."""
    white = diffuse(0.5)
    metal, plastic, frosted = (white,) * 3 if plain else (METAL, {"type": "plastic"}, FROSTED)
    left = translate(-1, 0, 1) @ rotate((0, 1, 0), 90)
    right = translate(1, 0, 1) @ rotate((0, 1, 0), -90)
    back = translate(0, 1, 1) @ rotate((1, 0, 0), 90)
    parts = {
        "left": plane(left, size=1.0, bsdf=metal),
        "right": plane(right, size=1.0, bsdf=plastic),
        "back": plane(back, size=1.0, bsdf=white),
        "floor": plane(size=1.0, bsdf=white),
        "mirror": ball(BALLS[0], 0.3, bsdf=MIRROR),
        "glass": ball(BALLS[1], 0.25, bsdf=MIRROR if plain else GLASS),
        "frosted": ball(BALLS[2], 0.25, bsdf=frosted),
        **facing_down("rectangle", 1.7, 0.4, 6.0),
        "point": point_light((0.3, -0.5, 1.5), 2.0),
    }
    eye = camera(EYE, TARGET, film(8, 8), up=(0, 0, 1), fov=FOV, **VIEWS[view])
    return scene(parts | ({} if plain else lights()), eye)


class Case(NamedTuple):
    """Complete paths: shares by the package and by definition, and which strategies find them."""

    shares: np.ndarray
    expected: np.ndarray
    possible: np.ndarray


def traced(view: str, plain: bool = False) -> tuple[Paths, Products]:
    loaded = load(room(view, plain))
    emission = Emission(loaded, loaded.sensors()[0])
    axis = unit(np.subtract(TARGET, EYE))
    paths = Paths(loaded, LANES)
    return paths, Products(paths, window_area(FOV), axis, float(emission.cross_section[0]))


def found(view: str, exponent: int, camera_connections: bool, plain: bool = False) -> Case:
    paths, products = traced(view, plain)
    options = exponent, camera_connections
    possible = products.possible(camera_connections)
    own, complete = shares(paths, products.started, *options), np.array(paths.complete)
    expected = products.shares(*options)
    return Case(own[complete], expected[complete], possible[complete])


case = functools.cache(found)


def sum_to_1(it: Case) -> bool:
    """Whether those of each path do, of the strategies that find it."""
    total = np.where(it.possible, it.shares, 0).sum(axis=1)
    return total.size > 1000 and bool((np.abs(total - 1) < ROUNDING).all())


def are_plain(it: Case) -> bool:
    """Whether each is what the definition says."""
    difference = np.abs(it.shares - it.expected)[it.possible]
    return bool((difference < ROUNDING).all())


def test_shares_in_a_plain_room():
    it = found("off center", 2, True, plain=True)
    assert sum_to_1(it)
    assert are_plain(it)


@pytest.mark.parametrize("camera_connections", [True, False])
@pytest.mark.parametrize("exponent", [1, 2])
@pytest.mark.parametrize("view", VIEWS)
def test_shares_sum_to_1_and_are_the_plain_definition(view, exponent, camera_connections):
    it = case(view, exponent, camera_connections)
    assert sum_to_1(it)
    assert are_plain(it)
    assert not are_plain(case(view, 3 - exponent, camera_connections)._replace(shares=it.shares))


@pytest.mark.parametrize("view", VIEWS)
def test_paths_are_of_all_kinds(view):
    """Of all lengths, to all lights, through mirrors and glass; up to six strategies find one."""
    paths, products = traced(view)
    complete, k = np.array(paths.complete), np.array(paths.count)
    for emitter in paths.scene.emitters():
        ends = np.array(paths.end.emitter == mi.EmitterPtr(emitter))
        assert (ends & complete).sum() > 30, emitter.id()
    for length in range(LONGEST):
        assert (complete & (k == length)).sum() > 100, length
        for j in range(1, length + 1):
            assert products.specular[complete & (k == length), j].any(), (length, j)
    strategies = products.possible()[complete].sum(axis=1)
    assert (np.bincount(strategies, minlength=WIDE + 1)[1:] > 20).all()
    inner = (products.j >= 1) & (products.j <= k[:, None]) & complete[:, None]
    for shape in paths.scene.shapes():
        here = np.array(paths.si.shape == mi.ShapePtr(shape)).reshape(-1, WIDE)
        assert shape.is_emitter() or (here & inner).sum() > 50, shape.id()


def emitted(loaded: mi.Scene) -> tuple[Emission, Any]:
    """Where light starts, for each of LANES paths."""
    emission = Emission(loaded, loaded.sensors()[0])
    return emission, emission.sample(
        numbers(0, LANES), mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1))
    )


INSTANCE = {
    "group": {"type": "shapegroup", "a": {"type": "sphere"}},
    "instance": {"type": "instance", "of": {"type": "ref", "id": "group"}},
}
"""It knows no points of its own, and must not be asked."""


@pytest.mark.parametrize("beside", [{}, INSTANCE], ids=["alone", "beside an instance"])
def test_light_starts_with_its_density(beside):
    """That of the definition, emitter by emitter."""
    alive = mi.load_dict({"type": "scene"} | beside)
    loaded = load(room("thin lens"))
    emission, it = emitted(loaded)
    cross_section = float(emission.cross_section[0])
    surface = np.array(mi.has_flag(it.emitter.flags(), mi.EmitterFlags.Surface))
    cos = np.where(surface, np.abs(np.array(dr.dot(it.normal, it.ray.d))), 1)
    expected = started(loaded, it.emitter, cos, cross_section)
    assert np.array(it.density) == pytest.approx(expected, rel=1e-4)
    for emitter in loaded.emitters():
        assert dr.count(it.emitter == mi.EmitterPtr(emitter))[0] > LANES / 8
    before = np.array(emission.sphere.length(it.origin, -it.ray.d))
    distant = np.array(mi.has_flag(it.emitter.flags(), mi.EmitterFlags.Infinite))
    assert np.abs(before[distant]).max() < 1e-5  # As paths from the sensor measure it
    del alive


def test_light_of_many_lamps_starts_beside_instances():
    """On each of them as often, and even in area, however bright it is there."""
    halves = mi.Bitmap(np.array([[[1.0], [9.0]]], np.float32))
    bright = {"type": "bitmap", "raw": True, "bitmap": halves}
    kinds = (
        {"type": "rectangle", "emitter": {"type": "area", "radiance": bright}},
        {"type": "sphere", "emitter": area_light(1.0)},
        {"type": "cube", "emitter": area_light(2.0)},
    )
    size = mi.ScalarTransform4f().scale(0.1)
    lamps = {f"lamp{k}": kinds[k % 3] | {"to_world": translate(k, 0, 5) @ size} for k in range(20)}
    view = camera(EYE, TARGET, film())
    loaded = load(scene(lamps | INSTANCE | {"point": point_light((0, 3, 0), 1.0)}, view))
    _, it = emitted(loaded)
    places = np.array(it.origin).T
    for shape in filter(None, (emitter.get_shape() for emitter in loaded.emitters())):
        here = np.array(it.emitter == mi.EmitterPtr(shape.emitter()))
        assert here.sum() == pytest.approx(LANES / 21, rel=0.3)
        box, found = shape.bbox(), places[here]
        assert (found >= np.array(box.min) - 1e-5).all()
        assert (found <= np.array(box.max) + 1e-5).all()
        off = (found - np.array(box.center())).mean(axis=0)
        assert np.abs(off).max() < 5 * 0.1 / math.sqrt(here.sum())
        expected = np.array(it.cos)[here] / (21 * math.pi * shape.surface_area()[0])
        assert np.array(it.density)[here] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("importance", [False, True])
def test_choices_have_the_densities_that_connections_have(importance):
    """Both ways; paths that are walked again rest on it."""
    loaded = load(room("off center"))
    materials = Materials(loaded, importance=importance, both_ways=True)
    sampler = numbers(0, LANES)
    d = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    si = loaded.ray_intersect(mi.Ray3f(mi.Point3f(0.2, -0.6, 0.7), d))
    vertex = Vertex(si, si.t, si.is_valid())
    _, bsdf_sample = materials.sample(vertex, None, sampler, vertex.valid)
    bsdf_eval = materials.eval_pdf(vertex, bsdf_sample.ray.d, vertex.valid & ~bsdf_sample.specular)
    rough = vertex.valid & ~bsdf_sample.specular & dr.any(bsdf_sample.weight > 0)
    compared = np.flatnonzero(np.array(rough & (dr.abs(dr.dot(si.n, bsdf_sample.ray.d)) > 0.01)))
    assert compared.size > LANES / 10
    for own, other in (
        (bsdf_sample.pdf, bsdf_eval.pdf),
        (bsdf_sample.pdf_reverse, bsdf_eval.pdf_reverse),
    ):
        own, other = (np.array(each, float)[compared] for each in (own, other))
        assert own == pytest.approx(other, rel=1e-2, abs=1e-3)


def no_way_back(connection):
    if isinstance(connection, VertexConnection):
        return replace(connection, pdf_reverse=mi.Float(0))
    return connection


def as_points(connection):
    """Emitter samples as those of lights that cannot be hit."""
    return replace(connection, delta=mi.Bool(True))


def no_other_way_to_start(path, vertex, hit):
    path = copy(path)
    path.history = PartialSums(path.history.a, mi.Float(0))
    return path, vertex, hit


def no_cosine_on_arrival(self, it, rivals, path, vertex):
    power = self.power(dr.abs(dr.dot(vertex.si.n, path.ray.d)))
    return PartialSums(it.a * power, it.b * power)


def no_cosine_on_leaving(self, it, rivals, vertex, bsdf_sample):
    return PartialSums(it.a, it.b / self.power(dr.abs(dr.dot(vertex.si.n, bsdf_sample.ray.d))))


def cosine_to_the(power: int) -> Callable:
    return gives_other(lambda self, it, d: it * dr.abs(dr.dot(d, self.axis)) ** (3 - power))


MISTAKES: dict[str, tuple[Any, str, Callable]] = {
    "no way back to the lens": (
        LensEndpoint,
        "mis_weight",
        of_other(
            lambda p, v, connection, bsdf_eval: (
                p,
                v,
                connection,
                replace(bsdf_eval, pdf_reverse=mi.Float(0)),
            )
        ),
    ),
    "no way back at the far end": (
        LightPaths,
        "mis_weight",
        of_other(lambda p, v, connection, bsdf_eval: (p, v, no_way_back(connection), bsdf_eval)),
    ),
    "no other way to start": (LightPaths, "hit_weight", of_other(no_other_way_to_start)),
    "lamps as points": (
        LightPaths,
        "mis_weight",
        of_other(lambda p, v, connection, bsdf_eval: (p, v, as_points(connection), bsdf_eval)),
    ),
    "no cosine on arrival": (BidirectionalMIS, "at_vertex", gives_other(no_cosine_on_arrival)),
    "no cosine on leaving": (BidirectionalMIS, "after_sample", gives_other(no_cosine_on_leaving)),
    "mirrors that connect": (
        BidirectionalMIS,
        "after_sample",
        of_other(
            lambda rivals, v, bsdf_sample: (
                rivals,
                v,
                replace(bsdf_sample, specular=mi.Bool(False)),
            )
        ),
    ),
    "no pi": (Emission, "ratio", gives_other(lambda self, it, *_: it / dr.pi)),
}
IN_ALL_ALIKE = {
    "cos²": cosine_to_the(2),
    "cos⁴": cosine_to_the(4),
    "no area": gives_other(lambda self, it, d: it * self.area),
}


@pytest.mark.parametrize(("owner", "name", "mistake"), MISTAKES.values(), ids=MISTAKES)
def test_a_wrong_share_is_found(owner, name, mistake, monkeypatch):
    monkeypatch.setattr(owner, name, mistake(getattr(owner, name)))
    it = found("off center", 2, True, plain=True)
    assert not sum_to_1(it)
    assert not are_plain(it)


@pytest.mark.parametrize("mistake", IN_ALL_ALIKE)
def test_a_wrong_density_of_the_lens_is_found(mistake, monkeypatch):
    """All strategies take the same, so that shares still sum to 1: the definition tells."""
    monkeypatch.setattr(Lens, "density", IN_ALL_ALIKE[mistake](Lens.density))
    it = found("off center", 2, True, plain=True)
    assert sum_to_1(it)
    assert not are_plain(it)
