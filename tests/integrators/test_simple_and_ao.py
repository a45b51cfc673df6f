"""`simple` and `ao` against closed forms, which are worked out here without the renderer."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, gray, plane, point_light, translate, unit
from helpers.support import agree, camera, film, largest, load, refused, rendered, scene
from helpers.tracers import paths
from oracles import films as oracles
from oracles.ball import (
    CENTER,
    ENERGY,
    EYE,
    POSITION,
    RADIUS,
    formula,
    meets_ball,
    occluded,
    spread,
)

import tofrender
from tofrender.scenes import BUILT_IN
from tofrender.scenes.meshes import bust_mesh

SIMPLE = {"type": "simple", "position": POSITION.tolist(), "energy": ENERGY}
AO = {"type": "ao"}


def with_plugin(parts: dict, sensor: dict, plugin: dict) -> dict:
    return scene(parts, sensor) | {"integrator": plugin}


def ball(**more) -> dict:
    return {"type": "sphere", "center": CENTER.tolist(), "radius": RADIUS, **more}


def values(loaded: mi.Scene, plugin: dict, origin, way, seed: int = 0) -> np.ndarray:
    """Radiance along each ray, (rays, channels), by one path each."""
    way = mi.Vector3f(np.atleast_2d(way).T.astype(np.float32))
    ray = mi.Ray3f(mi.Point3f(np.asarray(origin, float).tolist()), dr.normalize(way))
    return paths(loaded, plugin, ray, seed)


FLOOR_AND_BALL = {"floor": plane(bsdf=diffuse(0.3)), "ball": ball(bsdf=diffuse(0.7))}


def looking(the_film: dict, target=(0.2, 0.1, 0.3), **more) -> dict:
    return camera(EYE, target, the_film, up=(0, 0, 1), **more)


@pytest.mark.parametrize("color", [1.0, [3.0, 1.0, 0.25]])
def test_simple_is_its_formula(color):
    """Plane, ball, both in their own and in the ball's shadow: ray by ray."""
    loaded = load(scene(FLOOR_AND_BALL, looking(film())))
    way = spread(96)
    expected, _, sure = formula(way)
    assert sure.mean() > 0.99
    assert 0.05 < (expected == 0).mean() < 0.3
    energy = {"type": "rgb", "value": color} if isinstance(color, list) else color
    found = values(loaded, SIMPLE | {"energy": energy}, EYE, way)
    error = np.abs(found - expected[:, None] * np.array(color))[sure]
    assert error.max() < 2e-5 * found.max()


@pytest.mark.parametrize("unwarp", [False, True])
def test_simple_arrives_at_camera_to_surface_to_light(unwarp):
    """Pixels of a camera that is nearly a ray; one on the ball, one in its shadow."""
    for target in ([-0.8, 0.9, 0], [1.5, -0.4, 0], [0.1, -0.1, 1.45], [-0.45, 0.6, 0]):
        way = unit(np.subtract(target, EYE))
        value, opl, _ = (each[0] for each in formula(way[None]))
        window = film(bins=1024, bin_width=2**-7, start=1.0)
        plugin = SIMPLE | {"camera_unwarp": unwarp}
        sensor = looking(window, target, fov=1e-4, near_clip=0.1)
        total, bins = rendered(with_plugin(FLOOR_AND_BALL, sensor, plugin))
        if unwarp:
            down, to_ball = -EYE[2] / way[2], meets_ball(EYE, way[None])[0]
            opl -= min(down, to_ball)
        assert total[0, 0, 0] == pytest.approx(ENERGY * value, rel=1e-4)
        there = np.flatnonzero(bins[0, 0, :, 0]).tolist()
        assert there == ([int((opl - 1) * 2**7)] if value > 0 else [])
        assert bins.sum(axis=2) == pytest.approx(total, rel=1e-5)
    assert value == 0  # The last one is in the shadow


def test_simple_uses_the_shading_normal():
    """A triangle whose vertex normals all lean by 30 degrees."""
    mesh = mi.Mesh("leaning", 3, 1, has_vertex_normals=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = [-9.0, -9, 0, 9, -9, 0, 0, 9, 0]
    parameters["vertex_normals"] = [0.0, 0.5, math.sqrt(0.75)] * 3
    parameters["faces"] = [0, 1, 2]
    parameters.update()
    loaded = load(scene({"mesh": mesh}, looking(film())))
    found = values(loaded, SIMPLE, (0.1, 0.2, 2.0), (0, 0, -1))[0, 0]
    to_light = POSITION - [0.1, 0.2, 0]
    cosine = unit(to_light) @ [0, 0.5, math.sqrt(0.75)]
    expected = ENERGY * cosine / (4 * math.pi**2 * to_light @ to_light)
    assert found == pytest.approx(expected, rel=1e-5)


def test_simple_lights_the_side_that_is_seen():
    for flip in (False, True):
        loaded = load(scene({"floor": plane(flip_normals=flip)}, looking(film())))
        seen = [values(loaded, SIMPLE, (0, 0, z), (0, 0, -z))[0, 0] for z in (2.0, -2.0)]
        expected = ENERGY * 3.0 / (4 * math.pi**2 * (POSITION @ POSITION) ** 1.5)
        assert seen == pytest.approx([expected, 0.0], rel=1e-5)


LIT = {
    "lamp": point_light((0, 1, 3), 40.0),
    "sky": {"type": "constant", "radiance": gray(2.0)},
    "far": plane(translate(0, 0, 50), 0.1, emitter=area_light(9.0)),
}
ODD = {
    "glass": {"type": "dielectric"},
    "mirror": {"type": "conductor"},
    "black": diffuse(0.0),
    "hole": {"type": "mask", "opacity": 0.0, "nested": diffuse(0.5)},
}


@pytest.mark.parametrize("name", ODD)
@pytest.mark.parametrize("plugin", [SIMPLE, AO], ids=["simple", "ao"])
def test_lights_and_materials_of_the_scene_make_no_difference(plugin, name):
    plain = {"floor": plane(), "ball": ball()}
    odd = {"floor": plane(bsdf=ODD[name]), "ball": ball(bsdf=ODD[name], emitter=area_light(5.0))}
    pictures = [
        values(load(scene(parts, looking(film()))), plugin, EYE, spread(40))
        for parts in (plain, odd | LIT)
    ]
    assert 0.1 < (pictures[0] > 0).mean() < 1
    if plugin is SIMPLE:
        assert largest(pictures[1], pictures[0]) < 1e-5
    else:  # One bit per path; rounding may change a few
        assert (pictures[1] != pictures[0]).mean() < 2e-3
    assert (values(load(scene(odd | LIT, looking(film()))), plugin, EYE, (0.3, 0.2, 1)) == 0).all()


VARIANTS = [n for n in mi.variants() if n.startswith("llvm") and "polarized" not in n]


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant(variant):
    mi.set_variant(variant)
    target = (-0.8, 0.9, 0)
    expected = ENERGY * formula(unit(np.subtract(target, EYE))[None])[0][0]
    sensor = looking(film(bins=400), target, fov=1e-4)
    parts = {"floor": plane(), "ball": ball()}
    for plugin, value in ((SIMPLE, expected), (AO, None)):
        total, bins = rendered(with_plugin(parts, sensor, plugin), spp=4096)
        value = 1 - occluded(np.array(target)) if value is None else value
        assert total.mean() == pytest.approx(value, rel=0.05 if "spectral" in variant else 0.02)
        assert bins.sum(axis=2) == pytest.approx(total, rel=1e-4)


def at_point(parts: dict, x, seed: int = 0, eye=(0.0, 0.0, 1e-2), count: int = 1 << 16):
    """Means of 32 batches at a point, seen from just beside it."""
    way = np.repeat([np.negative(eye)], count, axis=0)
    loaded = load(scene(parts, looking(film())))
    found = values(loaded, AO, np.add(x, eye), way, seed).round(6)
    assert set(np.unique(found)) <= {0.0, 1.0}
    return found[:, 0].reshape(32, -1).mean(axis=1)


def test_open_plane_is_one_and_a_closed_box_zero():
    for eye in ((0.0, 0.0, 0.5), (0.3, -0.4, 0.2), (0.3, 0.1, -0.5)):
        assert (at_point({"floor": plane()}, (0.7, 0.2, 0), eye=eye, count=4096) == 1).all()
    for flip in (False, True):
        box = {"type": "cube", "flip_normals": flip}
        assert (at_point({"box": box}, (0.3, 0.2, -1.0), count=4096) == 0).all()


@pytest.mark.statistical
@pytest.mark.parametrize("steepness", [0.25, 4.0])
def test_beside_an_infinite_wall(steepness):
    """AO = (1 + cos b) / 2 with b = atan(H / d).

    The wall hides elevations up to b of the half plane around its normal. The cosine-weighted
    directions are even on the unit disk; their projections (x, y) are hidden where x >= 0 is above
    cos b times the disk's rim: half of the disk less the half ellipse, (1 - cos b) / 2.
    """
    d, top = 0.5, 0.5 * steepness
    stand = mi.ScalarTransform4f().translate([d, 0, 0.5 * top]).rotate([0, 1, 0], -90)
    wall = plane(stand @ mi.ScalarTransform4f().scale([0.5 * top, 1000, 1]), 1.0)
    found = at_point({"floor": plane(size=2000.0), "wall": wall}, (0, 0, 0))
    expected = 0.5 * (1 + math.cos(math.atan(steepness)))
    assert agree(found, np.array(expected))
    assert not agree(found + 0.02, np.array(expected))


@pytest.mark.statistical
@pytest.mark.parametrize("x", [(0.2, 0.1), (0.9, 0.1), (-0.5, -1.2)])
def test_under_a_ball(x):
    parts, expected = {"floor": plane(size=100.0), "ball": ball()}, 1 - occluded(np.array([*x, 0]))
    found = at_point(parts, (*x, 0), count=1 << 17)
    assert agree(found, np.array(expected))
    assert not agree(found + 0.02, np.array(expected))


@pytest.mark.statistical
def test_ao_is_path_with_a_white_world():
    """Albedo 1 under a sky of radiance 1, over the bust with its smoothed normals."""
    described = BUILT_IN["bust_ao"](width=24, height=32)
    white = described | {
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "white": diffuse(1.0),
        "bust": bust_mesh(bsdf=diffuse(1.0)),
        "sky": {"type": "constant", "radiance": gray(1.0)},
    }

    def blocks(each, seeds):
        loaded = tofrender.load_scene(each)
        images = [np.array(mi.render(loaded, spp=16, seed=s), float)[..., 0] for s in seeds]
        return np.reshape(images, (len(images), 4, 8, 4, 6)).mean(axis=(2, 4))

    ours, path = blocks(described, range(8)), blocks(white, range(100, 108))
    assert agree(ours, path)
    assert not agree(1.05 * ours, path)


@pytest.mark.statistical
def test_ao_in_time():
    """Light of the cosine c starts on a plane, radius + z c from the plane's middle: c² is even.

    As for a sky over a diffuse floor; the camera is at (0, 0, 3), and z is half of that.
    """
    center, radius = oracles.enclosing_sphere((-1, -1, 0), (1, 1, 3))
    sensor = camera(
        (0, 0, 3), (0, 0, 0), film(8, 8, bins=64, start=3.0, bin_width=1 / 16), fov=1e-4
    )
    total, bins = rendered(with_plugin({"floor": plane(size=1.0)}, sensor, AO), spp=4096)
    assert total == pytest.approx(np.ones((8, 8, 3)))
    assert bins.sum(axis=2) == pytest.approx(total, rel=1e-5)
    edges = 3.0 + np.arange(65) / 16
    expected = np.diff(np.clip((edges - 3.0 - radius) / center[2], 0, 1) ** 2)
    assert expected.sum() == pytest.approx(1)
    found, shown = bins[..., 0].reshape(64, 64), expected > 1e-3
    assert agree(found[:, shown], expected[shown])
    assert not agree(np.roll(found, 1, axis=1)[:, shown], expected[shown])


@pytest.mark.parametrize("plugin", [SIMPLE, AO], ids=["simple", "ao"])
def test_hidden_emitters_still_cast_shadows(plugin):
    """The camera sees the plane through the ball, shaded by it."""
    parts = {"floor": plane(size=100.0), "ball": ball(emitter=area_light(1.0))}
    loaded = load(scene(parts, looking(film())))
    down, up = np.subtract([0.9, 0.1, 0], EYE), np.subtract([0.3, 0.2, 0], EYE)
    for way in (down, up):
        assert np.isfinite(meets_ball(EYE, unit(way)[None])).all()
        found = values(loaded, plugin | {"hide_emitters": True}, EYE, np.repeat([way], 4096, 0))
        x = EYE + way
        to_light = POSITION - x
        lit = not np.isfinite(meets_ball(x, unit(to_light)[None])[0])
        direct = lit * to_light[2] / (4 * math.pi**2 * np.linalg.norm(to_light) ** 3)
        expected = ENERGY * direct if plugin is SIMPLE else 1 - occluded(x)
        assert found.mean() == pytest.approx(expected, abs=1e-5 if plugin is SIMPLE else 0.04)


@pytest.mark.parametrize("name", ["bust_simple", "bust_ao"])
def test_busts_render_without_an_emitter(name):
    """A window makes them transient."""
    loaded = tofrender.load_scene(name, width=12, height=16, spp=4)
    assert loaded.emitters() == []
    picture = np.array(mi.render(loaded), float)
    assert np.isfinite(picture).all()
    assert picture.mean() > 0.05
    window = {"temporal_bins": 64, "start_opl": 0.0, "bin_width_opl": 4.0}
    loaded = tofrender.load_scene(name, width=12, height=16, spp=4, **window)
    dataset = tofrender.render(loaded, progress=False)
    assert dataset.sizes["opl"] == 64
    assert dataset["steady"].values.mean() == pytest.approx(picture.mean(), rel=0.1)
    assert dataset["transient"].values.sum() == pytest.approx(dataset["steady"].values.sum())


def test_another_integrators_depth_is_not_inherited():
    options = {"size": (4, 4), "spp": 1, "window": (3.5, 15), "progress": False}
    assert tofrender.render("cornell_box", integrator="ao", **options).attrs["max_depth"] == 2


@pytest.mark.parametrize(
    ("plugin", "text"),
    [
        ({"type": "simple", "energy": 1.0}, "position is missing. Set position"),
        ({"type": "simple", "position": [0, 0, 1]}, "energy is missing. Set energy"),
        (SIMPLE | {"position": [0, 0, math.nan]}, "position = .*nan.*:"),
        (SIMPLE | {"energy": -1.0}, "energy = -1.0:"),
        (SIMPLE | {"energy": math.inf}, "energy = inf:"),
        (SIMPLE | {"energy": {"type": "rgb", "value": [1, -2, 3]}}, "energy = .*-2.*:"),
        (SIMPLE | {"max_bounces": 1}, "max_bounces = 1:"),
        (AO | {"max_bounces": 1}, "max_bounces = 1:"),
        (AO | {"max_depth": 2}, "max_depth = 2:"),
        (AO | {"energy": 1.0}, "energy"),
        (SIMPLE | {"power": 1.0}, "power"),
    ],
)
def test_bad_input_is_one_line(plugin, text):
    described = BUILT_IN["bust_ao"](width=4, height=4) | {"integrator": plugin}
    refused(text, tofrender.load_scene, described)
