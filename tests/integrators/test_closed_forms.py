"""Light against closed forms: how much arrives, and when. The formulas are in `oracles`."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.light_paths import MIRROR
from helpers.parts import area_light, diffuse, gray, plane, point_light, rotate, translate, unit
from helpers.support import agree, beam, camera, film, follow, load, over_seeds, rendered, scene
from oracles import films as oracles

from tofrender.paths.endpoints import SceneLights

UP = (0.0, 0.0, 1.0)
SEEDS = range(32)

LIGHT, INTENSITY, ALBEDO = (1.0, 0.3, 2.0), 3.0, 0.5


def floor_and_lamp(**integrator) -> dict:
    parts = {"floor": plane(bsdf=diffuse(ALBEDO)), "lamp": point_light(LIGHT, INTENSITY)}
    x = (0.4, 0.0)
    sensor = camera((*x, 1.5), (*x, 0), film(bins=640, bin_width=2**-6), fov=0.001)
    return scene(parts, sensor, **integrator)


@pytest.mark.parametrize("x", [-2.0, 0.4, 1.0, 3.0])
def test_point_light(x):
    eye, point = (x, 0.2, 1.5), (x, 0, 0)
    expected, opl = oracles.point_light_on_plane(eye, point, UP, LIGHT, INTENSITY, ALBEDO)
    found = follow(load(floor_and_lamp()), beam(eye, point))
    assert found.all()[1] == pytest.approx([expected], rel=2e-6)
    assert found.all()[0] == pytest.approx([opl], abs=2e-6)
    below = floor_and_lamp() | {"lamp": point_light((1, 0.3, -2), INTENSITY)}
    assert follow(load(below), beam(eye, point)).all()[0].size == 0


def test_point_light_in_the_film():
    eye, x = (0.4, 0, 1.5), (0.4, 0, 0)
    expected, opl = oracles.point_light_on_plane(eye, x, UP, LIGHT, INTENSITY, ALBEDO)
    assert expected == pytest.approx(0.10172586, abs=2e-8)  # As in the table of the documentation
    steady, transient = rendered(floor_and_lamp())
    bins = transient[0, 0, :, 0]
    assert np.flatnonzero(bins).tolist() == [int(opl * 2**6)]
    assert bins.sum() == pytest.approx(expected, rel=1e-5)  # the pixel sees 26 micrometers
    assert steady[0, 0] == pytest.approx([expected] * 3, rel=1e-5)


def test_camera_unwarp_leaves_the_first_segment_out():
    x = (0.4, 0, 0)
    segment = np.linalg.norm(np.subtract(LIGHT, x))
    _, transient = rendered(floor_and_lamp(camera_unwarp=True))
    assert np.flatnonzero(transient[0, 0, :, 0]).tolist() == [int(segment * 2**6)]
    found = follow(load(floor_and_lamp()), beam((0.4, 0, 1.5), x), camera_unwarp=True)
    assert found.all()[0] == pytest.approx([segment], abs=1e-6)


def test_camera_unwarp_sets_an_emitter_in_view_to_zero():
    sensor = camera((0, 0, 3), (0, 0, 0), film())
    lamp = load(scene({"lamp": plane(emitter=area_light(2.0))}, sensor))
    ray = beam((0, 0, 3), (0, 0, 0))
    assert follow(lamp, ray, camera_unwarp=True).all()[0].tolist() == [0.0]
    assert follow(lamp, ray).all()[0] == pytest.approx([3.0])


RADIUS = 2.0
BALL = {"type": "sphere", "radius": RADIUS, "flip_normals": True, "bsdf": diffuse(0.6)}


def in_sphere(max_depth: int, lanes: int = 4096, seed: int = 0, **options):
    parts = {"ball": BALL, "lamp": point_light((0, 0, 0), INTENSITY)}
    loaded = load(scene(parts, camera((0, 0, 0), (0, 0, 1), film())))
    ray = beam((0, 0, 0), (0.36, 0.48, 0.8), lanes)
    limits = {"max_depth": max_depth, "slots": max_depth, "rr_depth": 200}
    return follow(loaded, ray, seed=seed, **limits, **options)


def test_sphere_bounces_one_by_one():
    """Each bounce carries its exact energy, along every path, and within its time."""
    found = in_sphere(max_depth=5)
    for n in range(4):
        total = oracles.sphere_bounce_total(n, RADIUS, 0.6, INTENSITY)
        # Mitsuba's sphere is right to a few 1e-6, and that of a chord's cosine
        assert found.value[:, n] == pytest.approx(np.full(4096, total), rel=2e-4)
        assert found.opl[:, n].min() >= 2 * RADIUS - 1e-4
        assert found.opl[:, n].max() <= 2 * RADIUS + 2 * RADIUS * n + 1e-4
    assert found.opl[:, 0] == pytest.approx(np.full(4096, 2 * RADIUS), abs=1e-5)
    assert np.isnan(found.opl[:, 4]).all()


def test_camera_unwarp_leaves_out_the_first_segment_of_every_bounce():
    plain, unwarped = in_sphere(max_depth=4, lanes=64), in_sphere(4, lanes=64, camera_unwarp=True)
    assert unwarped.opl[:, :3] == pytest.approx(plain.opl[:, :3] - RADIUS, abs=1e-5)


def test_sphere_all_bounces():
    """Without roulette, the sum over 60 bounces; the rest is below 1e-9 of it."""
    total = np.nansum(in_sphere(max_depth=62, lanes=64).value, axis=1)
    expected = oracles.sphere_total(RADIUS, 0.6, INTENSITY)
    assert total == pytest.approx(np.full(64, expected), rel=5e-4)


@pytest.mark.statistical
def test_sphere_all_bounces_with_roulette():
    parts = {"ball": BALL, "lamp": point_light((0, 0, 0), INTENSITY)}
    sensor = camera((0, 0, 0), (0, 0, 1), film(bins=400, bin_width=0.25), fov=60)
    loaded = load(scene(parts, sensor, max_depth=-1, rr_depth=2))
    totals = over_seeds(lambda seed: rendered(loaded, 1024, seed)[1][0, 0, :, :1].sum(0), SEEDS)
    expected = np.array([oracles.sphere_total(RADIUS, 0.6, INTENSITY)])
    assert agree(totals, expected, rounding=1e-4)
    assert not agree(totals * 1.1, expected)


@pytest.mark.statistical
@pytest.mark.parametrize("index", [1.5, 3.0])
def test_glass_slab(index):
    thickness, eye, radiance = 0.25, (0.3, 0.2, 2.0), 2.0
    glass = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
    half = mi.ScalarTransform4f().scale([5, 5, 0.5 * thickness])
    slab = {"type": "cube", "to_world": translate(0, 0, 0.5 * thickness) @ half, "bsdf": glass}
    lamp = plane(translate(0, 0, -1.0), emitter=area_light(radiance))
    loaded = load(scene({"slab": slab, "lamp": lamp}, camera(eye, (0.3, 0.2, 0), film())))
    air = eye[2] - thickness + 1.0

    def paths(seed):
        ray = beam(eye, (0.3, 0.2, 0), 8192)
        return follow(loaded, ray, max_depth=24, rr_depth=100, seed=seed)

    opl = paths(0).all()[0]
    order = np.round(((opl - air) / (index * thickness) - 1) / 2).astype(int)
    assert np.unique(order)[:2].tolist() == [0, 1]
    exact = np.array([oracles.slab_opl(m, air, index, thickness) for m in order])
    assert opl == pytest.approx(exact, abs=2e-5)

    def orders(seed):
        found = paths(seed)
        edges = [oracles.slab_opl(m - 0.5, air, index, thickness) for m in range(4)]
        masses = found.histogram(np.array(edges))
        return np.append(masses, found.all()[1].sum() / 8192)

    expected = [oracles.slab_order(m, index, radiance) for m in range(3)]
    expected = np.array([*expected, oracles.slab_total(index, radiance)])
    samples = over_seeds(orders, SEEDS)
    shown = [0, 1, 3] if index == 1.5 else [0, 1, 2, 3]  # order 2 is 2e-6 in ordinary glass
    assert agree(samples[:, shown], expected[shown])
    assert not agree(samples[:, shown] * 1.1, expected[shown])


def test_mirror():
    """Camera, mirror at z = 2 that faces down, floor at z = 0, lamp."""
    eye, lamp, x = (-1.0, 0.2, 0.7), (1.0, 0.6, 1.6), (0.8, -0.3, 0.0)
    mirror = plane(translate(0, 0, 2) @ rotate((1, 0, 0), 180), bsdf=MIRROR)
    parts = {"mirror": mirror, "floor": plane(bsdf=diffuse(ALBEDO)), "lamp": point_light(lamp, 3.0)}
    loaded = load(scene(parts, camera(eye, x, film())))
    image = oracles.mirrored(eye, (0, 0, 2), UP)
    reflected = unit(np.subtract(x, image)) * [1, 1, -1]  # the ray that leaves the eye
    found = follow(loaded, beam(eye, eye + reflected), max_depth=3)
    radiance, opl = oracles.point_light_on_plane(image, x, UP, lamp, 3.0, ALBEDO)
    assert found.all()[1] == pytest.approx([radiance], rel=1e-5)
    assert found.all()[0] == pytest.approx([opl], abs=1e-4)  # rays leave 0.2 mm off the mirror


def test_environment_in_view():
    """A ray that leaves the scene runs on to the touching plane; none has a negative length."""
    eye = (0.5, 0.2, 3.0)
    sky = {"type": "constant", "radiance": gray(2.0)}
    loaded = load(scene({"floor": plane(size=1.0), "sky": sky}, camera(eye, (0, 0, 0), film())))
    sensor = loaded.sensors()[0]
    center, radius = oracles.enclosing_sphere((-1, -1, 0), (1, 1, 3))
    for d in [(0, 0, 1), (1, 2, 0.1), (-3, 1, 0)]:
        ray = beam(eye, np.add(eye, d))
        found = follow(loaded, ray, lights=lambda s: SceneLights(s, sensor))
        expected = oracles.distant_length(eye, unit(d), center, radius)
        assert expected >= 0
        assert found.all()[0] == pytest.approx([expected], abs=2e-6)
        assert found.all()[1] == pytest.approx([2.0])
