"""Light in participating media, against what is exact to all orders of scattering."""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.fogs import FLAKES, TWO_LOBES, cube, filled, fog, red, volume
from helpers.parts import plane, rotate, translate
from helpers.scenes import numbers

from tofrender.integrators.plan import Plan
from tofrender.media.flight import sample_channel, value_in
from tofrender.media.participating import Media
from tofrender.media.phases import Phases, as_surface
from tofrender.paths.endpoints import SceneLights
from tofrender.paths.records import Limits, MediumPoint, Path, Vertex
from tofrender.paths.scattering import Materials
from tofrender.sampling.statistics import p_values, smallest_allowed

pytestmark = pytest.mark.statistical

ALPHA = 1e-4  # Chance that a comparison of right code fails
SEEDS = 16
SHINES = {
    "bsdf": {"type": "diffuse", "reflectance": 0.0},
    "light": {"type": "area", "radiance": 1.0},
}
"""A surface of radiance 1 that reflects nothing."""

SHELL = {"type": "sphere", "flip_normals": True, **SHINES}  # The inside of a sphere of radius 1


@dataclass
class Moments:
    """Sum of light, of light times length, and of light in one bin."""

    low: mi.Float
    high: mi.Float
    total: mi.Color3f
    length: mi.Float
    binned: mi.Float

    def add(self, contribution: Any) -> None:
        light = dr.select(contribution.active, contribution.spectrum, 0)
        self.total += light
        self.length += light.x * contribution.opl
        inside = (contribution.opl >= self.low) & (contribution.opl < self.high)
        self.binned += dr.select(inside, light.x, 0)


def traced(
    scene: mi.Scene,
    medium: mi.Medium | None,
    ray: Any,
    seed: int,
    max_depth: int = -1,
    window: tuple[float, float] = (0.0, 1e9),
) -> np.ndarray:
    """Mean light, light times length, and light in a window of lengths, of rays in a medium."""
    sampler = numbers(seed, dr.width(ray))
    space, scattering = Media(scene, medium), Phases(Materials(scene))
    plan = Plan(scene, space, SceneLights(scene), scattering, Limits(max_depth, 10_000))
    origin = mi.Point3f(ray.o)
    ray.o = dr.fma(ray.d, 1e-4, ray.o)  # Off the surface; lengths and media start at the origin
    none = mi.Color3f(0), mi.Float(0), mi.Float(0)
    moments, _ = plan.trace(sampler, ray, origin, Moments(*map(mi.Float, window), *none))
    sums = [moments.total.x, moments.length, moments.binned]
    dr.eval(sums)
    return np.array([dr.mean(each)[0] for each in sums])


def agrees(samples: Any, wanted: Any) -> bool:
    """Whether estimates over independent seeds have this mean."""
    samples = np.asarray(samples)
    p = p_values(samples, np.broadcast_to(np.asarray(wanted, float), samples.shape[1:]))
    return bool(p.min() >= smallest_allowed(ALPHA, p.size))


def from_one_point(direction: Any, count: int) -> mi.Ray3f:
    """Equal rays from the origin."""
    return mi.Ray3f(mi.Point3f(0) + dr.zeros(mi.Float, count), mi.Vector3f(*direction))


def walk(scene: mi.Scene, medium: mi.Medium | None, ray: mi.Ray3f, seed: int):
    """Paths along rays, before each vertex, which comes along: none are active in the end."""
    sampler = numbers(seed, dr.width(ray))
    space, phases = Media(scene, medium), Phases(Materials(scene))
    path = Path.start(ray, medium=space.medium_at_sensor(ray))
    while dr.any(path.active):
        path, vertex = space.next_vertex(path, sampler)
        yield path, vertex
        path.active &= vertex.valid
        _, bsdf_sample = phases.sample(vertex, None, sampler, path.active)
        path.opl += dr.select(path.active, path.η * vertex.length, 0)
        path.medium = space.medium_behind(path, vertex, bsdf_sample.ray.d)
        path.β, path.η = path.β * bsdf_sample.weight, path.η * bsdf_sample.η
        path.ray, path.prev = bsdf_sample.ray, mi.Interaction3f(vertex.si)
        sampler.schedule_state()
        dr.eval(path)


def wandered(medium: dict, length: float, seed: int, count: int = 6000) -> np.ndarray:
    """Where paths are that start along z, when they are so long: means of z and r²."""
    scene, reached = mi.load_dict({"type": "scene"}), dr.zeros(mi.Point3f, count)
    for path, vertex in walk(scene, mi.load_dict(medium), from_one_point([0, 0, 1], count), seed):
        ends = path.active & ~(path.opl + vertex.length < length)
        at = path.prev.p + path.ray.d * (length - path.opl)
        reached = dr.select(ends, at, reached)
        path.active &= ~ends
        dr.eval(reached)
    p = reached.numpy()
    return np.array([p[2].mean(), np.sum(p**2, axis=0).mean()])


@pytest.mark.parametrize("kind", ["even", "dense corner"])
@pytest.mark.parametrize(
    ("g", "mu_s", "length", "z", "r2"),
    [(0.0, 2, 3, 0.49876, 2.50124), (0.7, 2, 3, 1.39117, 5.36277), (0.9, 10, 4, 0.98168, 6.03664)],
)
def test_photons_wander_as_they_must(kind, g, mu_s, length, z, r2):
    """<z> = l (1 - exp(-s/l)) and <r²> = 2 l² (s/l - 1 + exp(-s/l)), l = 1 / (mu_s (1 - g))."""
    medium = fog(float(mu_s), 1.0, g, kind)
    found = [wandered(medium, float(length), seed) for seed in range(5)]
    assert agrees(found, [z, r2])


def inwards(seed: int, count: int) -> mi.Ray3f:
    """Rays from the top of the unit sphere into it, as many as an even radiance brings."""
    u = np.random.default_rng(seed).random((2, count))
    d = mi.warp.square_to_cosine_hemisphere(mi.Point2f(*map(mi.Float, u)))
    return mi.Ray3f(mi.Point3f(0, 0, 1) + dr.zeros(mi.Float, count), mi.Vector3f(d.x, d.y, -d.z))


@pytest.mark.parametrize("kind", ["even", "grid", "dense corner"])
@pytest.mark.parametrize(("mu_s", "g"), [(0.0, 0.0), (3.0, 0.8), (10.0, 0.0)])
def test_mean_path_does_not_know_the_density(kind, mu_s, g):
    """4 V / S in every body under even light, whatever scatters in it; and all light comes out."""
    if kind != "even" and mu_s == 0:
        pytest.skip("a grid of nothing has no majorant")
    medium = mi.load_dict(fog(mu_s, 1.0, g, kind))
    scene = mi.load_dict({"type": "scene", "shell": SHELL})
    found = [traced(scene, medium, inwards(seed, 4000), seed)[:2] for seed in range(SEEDS)]
    assert agrees(found, [1, 4 / 3])


def test_absorption_separates():
    """Every length l is darker by exp(-mu_a l) than without it."""
    scene, mu_s, mu_a = mi.load_dict({"type": "scene", "shell": SHELL}), 4.0, 0.7
    without = mi.load_dict(fog(mu_s))
    dark = mi.load_dict(fog(mu_s + mu_a, mu_s / (mu_s + mu_a)))
    rays = [inwards(seed, 4000) for seed in range(2 * SEEDS)]

    def both(*window):
        return (
            np.array([traced(scene, each, ray, k + s, -1, window)[2] for k, ray in enumerate(rays)])
            for each, s in ((without, 0), (dark, 99))
        )

    bright, dim = both(1.0, 1.5)
    assert np.exp(-mu_a * 1.5) < dim.mean() / bright.mean() < np.exp(-mu_a * 1.0)
    bright, dim = both(1.2, 1.22)
    assert agrees(dim - bright * np.exp(-mu_a * 1.21), 0.0)


@pytest.mark.parametrize("kind", ["even", "grid", "dense corner"])
def test_single_scattering(kind):
    """A point light beside the line of sight, fog from x = 1 on; camera in front of it."""
    mu_s, mu_t, power = 0.3, 0.5, 2.0
    behind = filled(cube([1.5, 30, 30], [2.5, 0, 0]), fog(mu_t, mu_s / mu_t, 0.0, kind))
    lamp = {"type": "point", "position": [2.5, 0.8, 0], "intensity": power}
    scene = mi.load_dict({"type": "scene", "fog": behind, "lamp": lamp})
    window = (3.0, 3.2)
    ray = from_one_point([1, 0, 0], 20_000)
    found = [traced(scene, None, mi.Ray3f(ray), k, 2, window)[[0, 2]] for k in range(SEEDS)]
    assert agrees(found, [0.03865337, 0.00670907])


def across(z: float, **more) -> dict:
    """A square of 40 m."""
    return plane(translate(0, 0, z), 20.0, **more)


def turned_lamp(z: float) -> dict:
    return plane(translate(0, 0, z) @ rotate((1, 0, 0), 180), 20.0, **SHINES)


def test_lengths_are_exact_behind_boundaries():
    """Twenty boundaries of equal index, and a dense grid around: not a millimeter is lost."""
    walls = {f"wall{k}": across(1.0 + 0.37 * k, bsdf={"type": "null"}) for k in range(20)}
    scene = mi.load_dict({"type": "scene", "lamp": turned_lamp(12)} | walls)
    medium = mi.load_dict(fog(1e-3, 0.0, 0.0, "dense corner"))
    for direction in ([0.0, 0.0, 1.0], [0.48, 0.36, 0.8]):
        light, length, _ = traced(scene, medium, from_one_point(direction, 1000), 1)
        assert length / light == pytest.approx(12 / direction[2], abs=1.5e-4)


@pytest.mark.parametrize("boundary", [False, True])
def test_plates_are_no_boundaries(boundary):
    """A polarizer has the flags of `null`, and takes half of the light."""
    parts = {"lamp": turned_lamp(5), "plate": across(2, bsdf={"type": "polarizer"})}
    parts |= {"wall": across(3, bsdf={"type": "null"})} if boundary else {}
    scene = mi.load_dict({"type": "scene"} | parts)
    light, length, _ = traced(scene, mi.load_dict(fog(1e-6)), from_one_point([0, 0, 1], 1000), 1)
    assert light == pytest.approx(0.5, rel=1e-4)
    assert length / light == pytest.approx(5, abs=1.5e-4)


def test_values_are_those_of_the_channel_that_was_drawn():
    channel = sample_channel([0.2, 0.5, 0.3], mi.Float([0.1, 0.3, 0.69, 0.71, 0.99]))
    assert np.array(channel).tolist() == [0, 1, 1, 2, 2]
    assert np.array(value_in(mi.Color3f(3, 4, 5), channel)).tolist() == [3, 4, 4, 5, 5]


SEES_RED = 0.0125, 0.25, 1.0
GRID = volume(np.broadcast_to(SEES_RED, (8, 8, 8, 3)), (-40, -40, -40), 80)
COLORED = {
    "even": fog(red(*SEES_RED), 0.0, scale=4.0),
    "grid": fog(4.0, 0.0, kind="grid") | {"sigma_t": GRID},
}


@pytest.mark.parametrize("kind", COLORED)
def test_colors_are_right_where_they_differ_much(kind):
    """Red sees through, blue does not: the mean of each channel is its own transmittance."""
    lamp = {"type": "constant", "radiance": 1.0}
    wall = filled(cube([30, 30, 1], [0, 0, 3]), COLORED[kind])
    scene = mi.load_dict({"type": "scene", "lamp": lamp, "wall": wall})
    found = []
    for seed in range(SEEDS):
        path, vertex = next(walk(scene, None, from_one_point([0, 0, 1], 5000), seed))
        light = dr.select(vertex.valid & vertex.in_medium.here, 0, path.β)
        found.append(np.array(dr.mean(light, axis=1)).ravel())
    assert agrees(found, np.exp(-2 * np.array([0.05, 1.0, 4.0])))


HALF_SPACE = [
    # by length, isotropic scattering: H of [a, b] is 2 (S(mu_s a) - S(mu_s b)) for radiance 1 from
    # all sides, S(x) = exp(-x/2) (I0(x/2) + I1(x/2)) / 2
    (1.0, None, (0.0, 0.25), 0.1108702),
    (1.0, None, (1.0, 2.0), 0.1498924),
    # at the albedo a: (1 - sqrt(1 - a))² / a in all, 1 - sqrt(1 - a) H(mu) in one direction, with
    # Chandrasekhar's H
    (0.9, None, None, 0.5194939),
    (0.9, 1.0, None, 0.41495),
    (0.9, 0.6, None, 0.48585),
]


@pytest.mark.parametrize(("albedo", "cosine", "window", "wanted"), HALF_SPACE)
def test_half_space_under_even_light(albedo, cosine, window, wanted):
    """What comes back from a half-space, for directions uniform in solid angle or one of them."""
    lid = plane(size=1000, flip_normals=True, **SHINES)
    scene, medium = mi.load_dict({"type": "scene", "lid": lid}), mi.load_dict(fog(2.0, albedo))
    limit, which = ({"max_depth": 200, "window": window}, 2) if window else ({}, 0)
    found = []
    for seed in range(SEEDS):
        u = np.random.default_rng(seed).random((2, 10_000))
        if cosine is None:
            d = mi.warp.square_to_uniform_hemisphere(mi.Point2f(*map(mi.Float, u)))
        else:
            d = mi.Vector3f((1 - cosine**2) ** 0.5, 0, cosine) + dr.zeros(mi.Float, 10_000)
        start = mi.Point3f(0, 0, -1e-4) + dr.zeros(mi.Float, 10_000)
        ray = mi.Ray3f(start, mi.Vector3f(d.x, d.y, -d.z))
        found.append(traced(scene, medium, ray, seed, **limit)[which])
    assert agrees(found, wanted)


def lengths_in_glass(scene: mi.Scene, seed: int, count: int) -> np.ndarray:
    """Light that leaves a glass sphere again, and its optical length in there, for rays onto it."""
    ray = inwards(seed, count)
    ray.o = ray.o + mi.Vector3f(0, 0, 1e-4)
    left, times_length = dr.zeros(mi.Float, count), dr.zeros(mi.Float, count)
    for path, vertex in walk(scene, None, ray, seed):
        leaves = dr.select(path.active & ~vertex.valid, path.β.x, 0)
        left += leaves
        times_length += leaves * path.opl
        dr.eval(left, times_length)
    return np.array([dr.mean(left)[0], dr.mean(times_length)[0]])


@pytest.mark.parametrize(("mu_s", "g"), [(0.5, 0.0), (2.0, 0.8)])
def test_mean_path_in_glass(mu_s, g):
    """n² 4 V / S long, and n times that optically, of all light that arrives on a sphere."""
    n = 1.4
    ball = {
        "type": "sphere",
        "bsdf": {"type": "dielectric", "int_ior": n, "ext_ior": 1.0},
        "interior": fog(mu_s, 1.0, g),
    }
    scene = mi.load_dict({"type": "scene", "ball": ball})
    found = [lengths_in_glass(scene, seed, 6000) for seed in range(SEEDS)]
    assert agrees(found, [1, n**3 * 4 / 3])


@pytest.mark.parametrize("phase", [FLAKES, TWO_LOBES | {"a": FLAKES}], ids=["sggx", "blendphase"])
@pytest.mark.parametrize("wi", [(0, 0, 1), (0.6, 0, 0.8), (-0.36, 0.48, -0.8)])
def test_flakes_scatter_by_their_density(phase, wi):
    """E[1 / p] = 4 pi and E[d] = ∫ p d. Mitsuba's own samples make 1.4 to 6 of the first."""
    lanes = 1 << 18
    sampler = numbers(0, lanes)
    loaded = mi.load_dict(
        {"type": "scene", "ball": {"type": "sphere", "interior": fog(phase=phase)}}
    )
    medium = loaded.shapes()[0].interior_medium()
    mei = dr.zeros(mi.MediumInteraction3f, lanes)
    mei.wi = mi.Vector3f(*wi) + dr.zeros(mi.Float, lanes)
    mei.sh_frame, mei.medium = mi.Frame3f(mei.wi), dr.full(mi.MediumPtr, medium, lanes)
    here = dr.full(mi.Bool, True, lanes)
    point = as_surface(dr.zeros(mi.SurfaceInteraction3f, lanes), mei, here)
    vertex = Vertex(point, mi.Float(0), here, MediumPoint(mei, here))
    phases = Phases(Materials(loaded), media=[medium])
    bsdf_sample = phases.sample(vertex, None, sampler, here)[1]
    even = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    weight = 4 * dr.pi * phases.eval_pdf(vertex, even, here).pdf
    drawn = [dr.rcp(4 * dr.pi * bsdf_sample.pdf), *bsdf_sample.ray.d]
    expected = [mi.Float(1), *(weight * even)]
    for found, right in zip(drawn, expected, strict=True):
        off = np.array(found, float).mean() - np.array(right, float).mean()
        assert abs(off) < 0.02
    assert np.array(bsdf_sample.weight) == pytest.approx(np.ones((3, lanes)), abs=1e-3)
