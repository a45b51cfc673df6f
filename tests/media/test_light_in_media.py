"""Light that finds the camera through fog, smoke and milk: paths from the other end agree."""

from copy import copy

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.fogs import (
    DEPTH,
    FLAKES,
    HUGE,
    LIT,
    SCENES,
    THIN,
    cube,
    filled,
    fog,
    looked_at,
    sphere,
)
from helpers.light_paths import BDPT, LIGHT_TRACER, ball, blocks, by, summary
from helpers.mistakes import gives_other
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate
from helpers.support import agree, camera, film, load, over_seeds, rendered, scene

import tofrender
from tofrender.bidirectional.lens_connections import LensEndpoint
from tofrender.media.participating import Media
from tofrender.media.phases import Phases
from tofrender.paths.records import Vertex

pytestmark = pytest.mark.statistical
SEEDS, OTHER_SEEDS = range(8), range(1000, 1008)
MANY_SEEDS = range(32)
SPP = 512
PATH = "transient_path"

BEHIND_GLASS = {"milk in glass", "cloud in glass"}
"""What light from the lamp cannot connect to the lens."""

INSIDE = LIT | {"around": THIN, "hanging": ball((0.4, 0.3, 0.6), 0.2, emitter=area_light(6.0))}
ROOM = LIT | HUGE | {"hanging": INSIDE["hanging"]}
BETWEEN = LIT | {
    "half": filled(cube((9, 9, 0.4), (0, 0, 0.8)), fog(0.8, 0.9, 0.5)),
    "hanging": ball((0.4, 0.3, -0.5), 0.05, emitter=area_light(60.0)),
}
MILK = LIT | {"milk": filled(sphere(0.8), fog(2.0, 0.98, 0.5))}
PUFF = LIT | {"puff": filled(sphere(0.6, (0.4, -3.5, 1.6)), fog(1.5, 0.9))}
MORE = {
    "lamp in fog without end": INSIDE,
    "lamp in a room of fog": ROOM,
    "lamp below a cloud": BETWEEN,
    "lamp in a ball of milk": MILK | {"inside": point_light((0.1, 0.2, 0.1), 3.0)},
    "flakes": LIT | {"ball": filled(sphere(0.8), fog(2.0, 0.9, phase=FLAKES))},
    "lens in a puff": PUFF | {"around": fog(1.5, 0.9)},
}


def through(name: str, technique: str) -> dict:
    found = looked_at((SCENES | MORE)[name])
    return found | {"integrator": by(technique, DEPTH, rr_depth=20)}


def seen(described: dict, spp: int, seeds) -> tuple[np.ndarray, np.ndarray]:
    """Quarters of the picture, and bins of its mean, for each seed."""
    loaded = load(described)
    pictures = [rendered(loaded, spp, seed) for seed in seeds]
    return (
        np.stack([blocks(each, 2) for each, _ in pictures]),
        np.stack([cube.mean(axis=(0, 1, 3)) for _, cube in pictures]),
    )


def same(found, reference) -> bool:
    """Whether quarters agree, and bins do: energy, mean length, shape."""
    shown = summary(reference[1].mean(axis=0), np.arange(reference[1].shape[1] + 1.0), parts=5)
    in_time = agree(found[1] @ shown, reference[1] @ shown, rounding=2e-3)
    return in_time and agree(found[0], reference[0], rounding=2e-3)


@pytest.mark.parametrize("name", [*SCENES, *MORE])
@pytest.mark.parametrize("technique", [LIGHT_TRACER, BDPT])
def test_light_from_both_ends(name, technique):
    if technique == LIGHT_TRACER and name in BEHIND_GLASS:
        pytest.skip("no light connects to the lens through glass")
    found = seen(through(name, technique), SPP, SEEDS)
    assert same(found, seen(through(name, PATH), 4 * SPP, OTHER_SEEDS))


@pytest.mark.parametrize("boxed", [False, True])
@pytest.mark.parametrize("technique", [LIGHT_TRACER, BDPT])
def test_a_lamp_seen_through_absorbing_fog(technique, boxed):
    """4 m of it leave exp(-2), whether it has an end or not."""
    dim = fog(0.5, 0.0)
    view = camera((0, 0, 2), (0, 0, -2), film(2, 2, 1), fov=5, up=(0, 1, 0), medium=dim)
    lamp = plane(translate(0, 0, -2), 0.25, bsdf=diffuse(0.0), light=area_light(1.0))
    box = {"box": filled(cube(12.0), dim)} if boxed else {}
    loaded = load(scene({"lamp": lamp} | box, view) | {"integrator": by(technique)})
    found = np.array([rendered(loaded, SPP, seed)[0].mean() for seed in SEEDS])
    assert agree(found, np.full_like(found, np.exp(-2)), rounding=1e-3)


def in_slab(sigma_t: float | None, technique: str, seeds=OTHER_SEEDS, hide=True) -> tuple:
    """A lamp in the camera's view, in a slab of fog; None is no slab."""
    parts = LIT | {"hanging": ball((0.2, -0.2, 0.8), 0.25, emitter=area_light(6.0))}
    if sigma_t is not None:
        parts["slab"] = filled(cube((9, 9, 0.4), (0, 0, 0.8)), fog(sigma_t, 0.9, 0.5))
    integrator = by(technique, DEPTH, rr_depth=20, hide_emitters=hide)
    return seen(looked_at(parts) | {"integrator": integrator}, 4 * SPP, seeds)


@pytest.mark.parametrize("technique", [PATH, LIGHT_TRACER, BDPT])
def test_lamps_behind_the_end_of_fog_are_hidden(technique):
    """Fog of no density changes nothing; through other fog, paths from both ends agree."""
    clear = in_slab(None, technique, SEEDS)
    assert same(in_slab(0.0, technique), clear)
    assert not same(in_slab(0.0, technique, hide=False), clear)
    if technique != PATH:
        assert same(in_slab(0.8, technique, SEEDS), in_slab(0.8, PATH))


def small_particles(technique: str) -> dict:
    """Milk of small particles, lit from aside."""
    uniform = {"type": "uniform", "value": 5.0}
    tilted = translate(1.5, 0, 1.5) @ rotate((0, 1, 0), 225) @ mi.ScalarTransform4f().scale(0.5)
    light = {"type": "area", "radiance": uniform}
    lit = {"type": "rectangle", "to_world": tilted, "emitter": light}
    medium = fog(1.0, {"type": "uniform", "value": 0.95}, phase={"type": "rayleigh"})
    view = camera((0, -3.5, 0.4), (0, 0, 0), film(2, 2, 20, 4.5, 0.2), up=(0, 0, 1), fov=20)
    parts = {"lamp": lit, "milk": filled(sphere(0.8), medium)}
    return scene(parts, view) | {"integrator": by(technique, 6, rr_depth=20)}


def backwards(right):
    """Light that a particle turns from where it goes to where it comes from."""

    def wrong(self, *args):
        turned = copy(self)
        turned.importance = False
        return right(turned, *args)

    return wrong


def stokes(technique: str, spp: int, seeds) -> np.ndarray:
    """Stokes vectors of quarters of the picture, and of its mean in time, (seeds, ...)."""
    loaded = load(small_particles(technique))

    def one(seed: int) -> np.ndarray:
        S = tofrender.render(loaded, spp=spp, seed=seed, progress=False)["transient"].values
        S = S.reshape(*S.shape[:3], -1)
        in_time = S.sum(axis=(0, 1)).reshape(5, 4, -1).sum(axis=1)
        return np.concatenate([S.sum(axis=2).ravel(), in_time.ravel()])

    return over_seeds(one, seeds)


@pytest.mark.parametrize("technique", [LIGHT_TRACER, BDPT])
def test_polarized_light_from_both_ends(technique, monkeypatch):
    mi.set_variant("llvm_ad_mono_polarized")
    reference = stokes(PATH, 4 * SPP, OTHER_SEEDS)
    size = np.abs(reference.mean(axis=0)).reshape(-1, 4)
    assert size[:, 1:].max() > 0.1 * size[:, 0].max()
    assert agree(stokes(technique, SPP // 2, MANY_SEEDS), reference, rounding=2e-3)
    if technique == BDPT:  # Where little comes by way of the light's own phase functions
        return
    monkeypatch.setattr(Phases, "_scattered", backwards(Phases._scattered))
    assert not agree(stokes(technique, SPP // 2, MANY_SEEDS), reference, rounding=2e-3)


BALL = "ball"


def flat(self, cosine, d):
    """Cosines to a normal that a point of a medium does not have."""
    return dr.abs(dr.dot(self.si.n, d))


def in_vacuum(self, medium, ray):
    """Light that starts in vacuum, wherever its lamp is."""
    return dr.zeros(mi.MediumPtr, dr.width(ray))


def to_the_near_plane(self, connection, *_):
    """Fog that ends where the camera begins to see surfaces."""
    connection.medium_length = None
    return connection


def one_sided(self, scattered, *_):
    """A phase function that scatters back what comes from the lights."""
    return scattered * (0.9 if self.importance else 1)


MISTAKES = {
    "cosine": (Vertex, "cosine", flat, BDPT, BALL, 0.01),
    "around": (Media, "medium_at", in_vacuum, LIGHT_TRACER, "lamp in fog without end", 0.01),
    "reach": (LensEndpoint, "connect", to_the_near_plane, LIGHT_TRACER, "absorbing", 0.5),
    "adjoint": (Phases, "_scattered", one_sided, LIGHT_TRACER, BALL, 0.01),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_noticed(mistake, monkeypatch):
    owner, name, make, technique, where, near_clip = MISTAKES[mistake]

    def looked(technique):
        found = through(where, technique)
        found["sensor"]["near_clip"] = near_clip
        return found

    reference = seen(looked(PATH), 4 * SPP, OTHER_SEEDS)
    assert same(seen(looked(technique), SPP // 2, MANY_SEEDS), reference)
    monkeypatch.setattr(owner, name, gives_other(make)(getattr(owner, name)))
    assert not same(seen(looked(technique), SPP // 2, MANY_SEEDS), reference)
