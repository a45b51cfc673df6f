"""Mistakes that tracers of light invite: each is put into the package, and must be noticed.

Scenes are chosen so that one render tells: films that must be dark, and means that are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.light_paths import (
    ALBEDO,
    GLASS,
    LIGHT_TRACER,
    TRACERS,
    lamp,
    looking_down,
    spot,
    through,
)
from helpers.support import (
    area_light,
    camera,
    diffuse,
    film,
    plane,
    rendered,
    rotate,
    scene,
    translate,
)
from oracles.light_paths import View, out_of_glass, under_a_point, window_area

from tofrender.films.splats import Splats, footprint
from tofrender.paths.lens import Lens
from tofrender.paths.scattering import Materials
from tofrender.paths.space import Vacuum

SPP = 1024
"""Of 8 x 8 pixels: 2^16 paths."""

EDGES = np.linspace(0, 8, 9)
WIDE = View(1.0, fov=100)


def means(described: dict, technique: str = LIGHT_TRACER, spp: int = SPP, **more) -> np.ndarray:
    """Of the picture, and of its bins, added up."""
    steady, transient = rendered(through(described, technique, **more), spp)
    return np.array([steady.mean(), transient.sum(axis=2).mean()])


def near(found: np.ndarray, expected: float, tolerance: float) -> bool:
    return bool((np.abs(found / expected - 1) < tolerance).all())


# --------------------------------------------------------------------------- refraction


def in_glass() -> tuple[dict, float]:
    """A spot in glass over a floor, and the film's mean: importance does not shrink by n²."""
    view = View(0.5, fov=122)
    face = plane(translate(0, 0, 0.6) @ rotate((1, 0, 0), 180), bsdf=GLASS)
    parts = {"face": face, "lamp": spot((0, 0, 1.4), (0, 0, 0), 25, 25.01)}
    described = looking_down(view, parts, EDGES, max_depth=3)
    return described, out_of_glass(1.5, 0.8, 0.6, math.radians(25)).seen(view, ALBEDO).total


def behind_a_rough_face(side: int) -> tuple[dict, float]:
    """A lamp in glass and the camera in air (1), or the other way round (-1); by a path tracer."""
    frosted = GLASS | {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.4}
    turned = rotate((0, 1, 0), 0 if side > 0 else 180)
    lit = plane(turned @ translate(0.2, 0.1, -1), size=0.8, emitter=area_light(1.0))
    eye = camera((0.5 * side, 0, 1.5 * side), (0, 0, 0), film(8, 8, 8, 0.0, 1.0), fov=50)
    described = scene({"face": plane(bsdf=frosted), "lamp": lit}, eye, max_depth=2)
    return described, float(rendered(described, 256)[0].mean())


def as_radiance(right: Callable) -> Callable:
    """Importance that is scattered as radiance is: eta squared where there is none."""

    def wrong(self, *args, **options):
        right(self, *args, **options)
        self.flux = self.radiance

    return wrong


def not_turned_round(right: Callable) -> Callable:
    """The BSDF of the light's own way, which has eta squared where the camera's has not."""

    def wrong(self, bsdf, si, wo, active):
        _, back = right(self, bsdf, si, wo, active)
        return bsdf.eval(self.radiance, si, wo, active), back

    return wrong


def test_eta_squared_at_smooth_glass(monkeypatch):
    described, expected = in_glass()
    assert near(means(described), expected, 0.02)
    monkeypatch.setattr(Materials, "__init__", as_radiance(Materials.__init__))
    assert near(means(described), 1.5**2 * expected, 0.02)


@pytest.mark.parametrize("side", [1, -1])
def test_eta_squared_at_rough_glass(side, monkeypatch):
    described, expected = behind_a_rough_face(side)
    assert near(means(described), expected, 0.1)
    monkeypatch.setattr(Materials, "_adjoint", not_turned_round(Materials._adjoint))
    assert near(means(described), 1.5 ** (2 * side) * expected, 0.1)


def wall_behind_rough_glass() -> dict:
    """A wall whose light comes through a sheet of rough glass."""
    frosted = GLASS | {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
    lit = plane(translate(0, 0, -0.6), size=0.3, emitter=area_light(10.0), bsdf=diffuse(0))
    wall = plane(translate(0, 0, 1) @ rotate((1, 0, 0), 180), size=3.0, bsdf=diffuse(0.7))
    eye = camera((0.5, -1.0, 0.5), (0.2, 0, 1), film(8, 8, 8, 0.0, 1.0), up=(0, 0, 1), fov=60)
    return scene({"sheet": plane(bsdf=frosted), "wall": wall, "lamp": lit}, eye, max_depth=3)


def failed_choices_count(right: Callable) -> Callable:
    """A facet that reflects light into the glass sends it on, as if it were refracted."""

    def wrong(self, vertex, link, sampler, active):
        turn, bounce = right(self, vertex, link, sampler, active)
        if self.importance:
            f = self.turn(vertex, bounce.ray.d, active & ~bounce.specular & (bounce.pdf > 0)).f
            again = dr.select(bounce.pdf > 0, f / bounce.pdf, 0)
            bounce.weight = dr.select(bounce.specular, bounce.weight, again)
        return turn, bounce

    return wrong


def test_failed_choices_of_rough_glass(monkeypatch):
    described = wall_behind_rough_glass()
    expected = float(means(described, "transient_path", 4 * SPP)[0])
    assert near(means(described), expected, 0.1)
    monkeypatch.setattr(Materials, "scatter", failed_choices_count(Materials.scatter))
    assert means(described).min() > 1.3 * expected


# ------------------------------------------------------------------------- shading normals


def on_a_tilted_floor() -> dict:
    """A floor whose shading normals lean towards the light."""
    leaning = np.tile(np.array([0.7, 0.5, 0.95], np.float32), (2, 2, 1))
    texture = {"type": "bitmap", "raw": True, "data": mi.TensorXf(leaning)}
    tilted = {"type": "normalmap", "normalmap": texture, "nested": diffuse(ALBEDO)}
    parts = {"floor": plane(bsdf=tilted), "lamp": spot((1, 0, 1.5), (0, 0, 0), 14.99, 15)}
    return looking_down(WIDE, parts, EDGES)


def test_shading_normals(monkeypatch):
    """They do not count both ways alike."""
    expected = float(means(on_a_tilted_floor(), "transient_path")[0])
    assert near(means(on_a_tilted_floor()), expected, 0.03)
    monkeypatch.setattr(Materials, "_adjoint", not_turned_round(Materials._adjoint))
    assert not near(means(on_a_tilted_floor()), expected, 0.1)


# ---------------------------------------------------------------------------- visibility


def under_a_card(parts: dict) -> dict:
    """A card right under the camera, over the whole window."""
    card = plane(translate(0, 0, 1.8), size=0.5, bsdf=diffuse(0))
    return looking_down(View(2.0), {"card": card} | parts, EDGES)


def seen_through(right: Callable) -> Callable:
    """Connections to the lens, which alone have a place on the film, that nothing stops."""

    def wrong(self, path, vertex, connection, sampler):
        if connection.position is not None:
            return mi.Float(1)
        return right(self, path, vertex, connection, sampler)

    return wrong


@pytest.mark.parametrize("technique", TRACERS)
def test_visibility_of_the_lens(technique, monkeypatch):
    described = under_a_card(lamp((0.1, 0, 1)))
    assert means(described, technique, 64).max() == 0
    monkeypatch.setattr(Vacuum, "transmittance", seen_through(Vacuum.transmittance))
    assert means(described, technique, 64).min() > 0


def test_visibility_of_a_lamp(monkeypatch):
    """Of the one that the lens connects to itself."""
    lit = plane(translate(0, 0, 1), size=0.5, emitter=area_light(1.0), bsdf=diffuse(0))
    described = under_a_card({"lamp": lit})
    assert means(described, spp=64).max() == 0
    monkeypatch.setattr(mi.Scene, "ray_test", lambda *_: mi.Bool(False))
    assert means(described, spp=64).min() > 0


# ------------------------------------------------------------------- the camera's density

CUTOFF = 20.0


def under_a_spot() -> tuple[dict, float]:
    """All of whose light is in the window: each path adds the same to the mean, without noise."""
    lit = {"lamp": spot((0, 0, 2), (0, 0, 0), CUTOFF - 0.01, CUTOFF)}
    power = 2 * math.pi * (1 - math.cos(math.radians(CUTOFF - 0.005)))
    return looking_down(WIDE, lit, EDGES), ALBEDO / math.pi * power / window_area(WIDE.fov)


def cosine_to_the(power: int) -> Callable:
    def wrongly(right: Callable) -> Callable:
        return lambda self, d: right(self, d) * dr.abs(dr.dot(d, self.axis)) ** (3 - power)

    return wrongly


def no_area(right: Callable) -> Callable:
    return lambda self, d: right(self, d) * self.area


DENSITIES = {f"cosine to the {power}": cosine_to_the(power) for power in (0, 2, 4)}
DENSITIES |= {"no area": no_area, "none": lambda right: lambda self, d: mi.Float(1)}


@pytest.mark.parametrize("mistake", DENSITIES)
def test_density_of_the_camera(mistake, monkeypatch):
    described, expected = under_a_spot()
    assert near(means(described), expected, 1e-3)
    monkeypatch.setattr(Lens, "density", DENSITIES[mistake](Lens.density))
    assert not near(means(described), expected, 0.05)


def test_distance_to_the_camera(monkeypatch):
    described, expected = under_a_spot()
    arrive = Lens.arrive

    def wrong(self, *args):
        return replace(arrive(self, *args), distance=mi.Float(1))

    monkeypatch.setattr(Lens, "arrive", wrong)
    assert not near(means(described), expected, 0.05)


# -------------------------------------------------------------------------------- splats

NARROW = View(1.0, fov=40)


def partly_seen() -> tuple[dict, float]:
    """A third of the spot's light lands in the picture."""
    described, _ = under_a_spot()
    lit = {"lamp": described["lamp"]}
    expected = under_a_point(NARROW, (0, 0, 2), 1.0, ALBEDO).total
    return looking_down(NARROW, lit, EDGES), expected


def counted(monkeypatch, factor: Callable[[np.ndarray], np.ndarray]) -> None:
    """Multiply splats by a function of how many have landed in each pixel."""
    init, add = Splats.__init__, Splats.add

    def with_count(self, film, count):
        init(self, film, count)
        height, width = self.cells.shape[:2]
        self.landed = dr.zeros(mi.UInt32, height * width)
        dr.eval(self.landed)
        tensor = self.cells.tensor

        def wrong(*args):
            landed = np.array(self.landed, float).reshape(height, width, 1, 1)
            return mi.TensorXf((np.array(tensor(*args)) * factor(landed)).astype(np.float32))

        self.cells.tensor = wrong

    def counting(self, position, values, first, active):
        add(self, position, values, first, active)
        [(x, y, _)] = footprint(self.film, position)
        height, width = self.cells.shape[:2]
        inside = active & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        dr.scatter_add(self.landed, mi.UInt32(1), mi.UInt32(y * width + x), inside)

    monkeypatch.setattr(Splats, "__init__", with_count)
    monkeypatch.setattr(Splats, "add", counting)


COUNTS = {
    "divided by those that landed": lambda landed: 64 * SPP / landed.sum(),
    "samples of their pixel": lambda landed: SPP / (SPP + landed),
}


@pytest.mark.parametrize("mistake", COUNTS)
def test_splats_are_divided_by_all_paths(mistake, monkeypatch):
    described, expected = partly_seen()
    assert near(means(described), expected, 0.03)
    counted(monkeypatch, COUNTS[mistake])
    found = means(described)
    assert not near(found[:1], expected, 0.1)
    assert not near(found[1:], expected, 0.1)
