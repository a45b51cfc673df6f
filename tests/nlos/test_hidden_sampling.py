"""All ways to sample hidden geometry give the same light, for each number of bounces."""

import functools

import mitsuba as mi
import numpy as np
import pytest
from helpers.confocal import (
    LASER,
    LIT,
    MODES,
    facing,
    found,
    groove_shapes,
    small_film,
    three_of,
    totals,
)
from helpers.parts import diffuse
from helpers.support import agree, film, over_seeds
from oracles import nlos

from tofrender.nlos.light import guided
from tofrender.scenes.meshes import bunny_mesh, letter_z_mesh

SEEDS = range(16)
HIDDEN = {"nlos_hidden_geometry_sampling": True}
ROULETTE = HIDDEN | {"nlos_hidden_geometry_sampling_do_rroulette": True}
WALL_TOO = {"nlos_hidden_geometry_sampling_includes_relay_wall": True}
OPTIONS = {
    "material": {"nlos_hidden_geometry_sampling": False},
    "area": HIDDEN,
    "both": ROULETTE,
    "area, wall too": HIDDEN | WALL_TOO,
    "both, wall too": ROULETTE | WALL_TOO,
}

PANEL = nlos.Rectangle((0.8, 0.0, 0.3), (0, 0.4, 0), (0, 0, -0.3))
"""Stands on the wall at x = 0.8 and faces -x."""
PLATE = facing(nlos.Rectangle.turned((0.1, 0.2, 1.0), 25, 60, half=(0.25, 0.2)))


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("mode", "name"),
    [*(("single", name) for name in OPTIONS), ("confocal", "material"), ("confocal", "area")],
)
def test_hidden_geometry_that_touches_the_wall(mode, name):
    expected = sum(
        totals(nlos.Setup(), nodes, lit=MODES[mode])
        for nodes in (PANEL.nodes(400, 400), PLATE.nodes())
    )
    hidden = {"panel": PANEL.shape(), "plate": PLATE.shape()}
    assert agree(found(three_of(mode, hidden, **OPTIONS[name]), 512), expected, rounding=1e-3)


@pytest.mark.statistical
def test_shapes_of_very_different_areas():
    """A sphere, an ellipse, a plate of 4 m² and a plate of 16 cm², without occlusion."""
    plates = [
        facing(nlos.Rectangle.turned((0.0, 0.3, 2.0), 10, 20, half=(1.0, 1.0))),
        facing(nlos.Rectangle.turned((-0.35, -0.2, 0.5), 20, 200, half=(0.02, 0.02))),
    ]
    shapes = {f"plate_{n}": p.shape() for n, p in enumerate(plates)}
    center, radius = (0.7, -0.75, 0.5), 0.15
    ball = {"type": "sphere", "center": list(center), "radius": radius, "bsdf": diffuse(0.7)}
    place = mi.ScalarTransform4f().translate([0.9, 0.75, 0.6]).rotate([0, 1, 0], 180)
    ellipse = {"type": "disk", "to_world": place.scale([0.1, 0.2, 1]), "bsdf": diffuse(0.7)}
    part = (np.arange(200) + 0.5) / 200
    r, a = (v.ravel() for v in np.meshgrid(np.sqrt(part), 2 * np.pi * part))
    on_ellipse = np.column_stack([0.1 * r * np.cos(a), 0.2 * r * np.sin(a), 0 * r])
    around = nlos.Nodes(
        on_ellipse + np.array([0.9, 0.75, 0.6]),
        np.tile([0.0, 0, -1], (len(r), 1)),
        np.full(len(r), np.pi * 0.02 / len(r)),
    )
    nodes = plates[0].nodes() + plates[1].nodes() + nlos.sphere_nodes(center, radius) + around
    for mode, lit in MODES.items():
        described = three_of(mode, shapes | {"ball": ball, "ellipse": ellipse})
        assert agree(found(described, 512), totals(nlos.Setup(), nodes, lit=lit), rounding=1e-3)


def mesh(plate: nlos.Rectangle, normal) -> mi.Mesh:
    """Return the plate as two triangles with modified vertex normals."""
    corners = [(-1, -1, 0, 1), (1, -1, 0, 1), (1, 1, 0, 1), (-1, 1, 0, 1)]
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(diffuse(plate.albedo))
    made = mi.Mesh("plate", 4, 2, properties, has_vertex_normals=True)
    parameters = mi.traverse(made)
    positions = np.array(corners) @ plate.matrix()[:3].T
    parameters["vertex_positions"] = positions.astype(np.float32).ravel()
    parameters["faces"] = np.array([0, 1, 2, 0, 2, 3], dtype=np.uint32)
    parameters["vertex_normals"] = np.tile(normal, 4).astype(np.float32)
    parameters.update()
    return made


@pytest.mark.statistical
def test_mesh_with_other_normals():
    """Areas and densities use the triangles, materials use the vertex normals."""
    tilt = facing(nlos.Rectangle.turned(PLATE.center, 45, -100)).normal
    assert 0.3 < tilt @ PLATE.normal < 0.9
    shape, nodes = mesh(PLATE, tilt), PLATE.nodes(100, 100)
    shading = np.broadcast_to(tilt, nodes.points.shape)
    for mode, lit in MODES.items():
        expected = totals(nlos.Setup(), nodes, lit=lit, shading=shading)
        flat = totals(nlos.Setup(), nodes, lit=lit)
        assert np.abs(expected / flat - 1).max() > 0.1
        assert agree(found(three_of(mode, {"hidden": shape}), 256), expected, rounding=1e-3)


def folded(mode: str) -> dict:
    """Return a groove in front of two perpendicular walls; "single" lights the second wall."""
    to_world = mi.ScalarTransform4f().translate([-1.3, 0, 0.9]).rotate([0, 1, 0], 90).scale(0.5)
    side = {"type": "rectangle", "to_world": to_world, "bsdf": diffuse(0.6)}
    hidden = {"side_wall": side} | groove_shapes(nlos.Groove(z=1.3, half_length=0.3))
    walls = {"relay_wall": "relay_wall, side_wall"}
    if mode == "confocal":
        return nlos.confocal(nlos.Setup(), hidden, film(), **walls)
    lamp = {"laser": nlos.spot((0.5, -0.3, 0.4), (-1.3, 0.2, 0.6), 3.0)}
    return nlos.single(nlos.Setup(laser=LASER), hidden, LIT, film(), **walls) | lamp


def limited(description: dict, depth: int, **options) -> dict:
    integrator = description["integrator"] | {"filter_bounces": -1, "max_depth": depth} | options
    return description | {"integrator": integrator}


@pytest.mark.statistical
@pytest.mark.parametrize("mode", MODES)
def test_bounces_are_a_partition(mode):
    described = folded(mode)
    hidden = {"use_nlos_only": True, "rr_depth": 100}  # the walls alone are mostly noise
    each = [found(limited(described, 8, filter_bounces=n, **hidden), 1024) for n in (3, 4, 5)]
    whole, less = (
        found(limited(described, depth, **hidden), 1024, range(100, 116)) for depth in (5, 4)
    )
    assert min(light.mean() for light in each) > 0
    assert agree(sum(each), whole)
    assert agree(sum(each[:-1]), less)
    assert not agree(sum(each), less)
    assert not agree(sum(each[:-1]), whole)


@pytest.mark.statistical
@pytest.mark.parametrize("mode", MODES)
def test_nlos_only_leaves_out_what_the_walls_do_alone(mode):
    """The remaining light is the light of paths that end on black hidden surfaces."""
    described = folded(mode)
    black = {k: described[k] | {"bsdf": diffuse(0.0)} for k in ("left", "right")}
    only, every, alone, never = (
        found(limited(scene, 5, use_nlos_only=alone), 2048, seeds)
        for scene, alone, seeds in (
            (described, True, SEEDS),
            (described, False, range(100, 116)),
            (described | black, False, SEEDS),
            (described | black, True, SEEDS),
        )
    )
    assert np.all(never == 0)
    assert 0 < only.mean() < 0.9 * every.mean()
    assert agree(only + alone, every)


def lamp_scene(**options) -> dict:
    """Return a scene with only a spot that lights most of the wall."""
    ball = {"type": "sphere", "center": [-0.5, -0.6, 1.3], "radius": 0.3, "bsdf": diffuse(0.9)}
    hidden = {"panel": PANEL.shape(), "plate": PLATE.shape(), "ball": ball}
    options = {"nlos_laser_sampling": False} | options
    described = nlos.single(
        nlos.Setup(laser=LASER), hidden, LIT, small_film(bins=400, start=0), **options
    )
    return described | {"laser": nlos.spot(LASER, (0.3, 0.2, 0), 3.0, angle=45)}


@functools.cache
def by_mitsuba(depth: int) -> np.ndarray:
    path = {"type": "path", "max_depth": depth, "rr_depth": 100}
    loaded = nlos.load_nlos(nlos.in_pictures(lamp_scene(), nlos.picture_film(2), **path))
    return over_seeds(
        lambda s: np.array(mi.render(loaded, spp=4096, seed=s), dtype=float)[..., 0], range(50, 66)
    )


@pytest.mark.statistical
@pytest.mark.parametrize("name", OPTIONS)
def test_the_emitter_itself(name):
    """Three bounces, and up to four; Mitsuba's `path` counts one segment more."""
    options = OPTIONS[name] | {"rr_depth": 100}
    three = found(lamp_scene(filter_bounces=3, **options), 512)
    assert agree(three, by_mitsuba(4) - by_mitsuba(3)[::-1])
    up_to_four = found(lamp_scene(filter_bounces=-1, max_depth=5, **options), 512)
    assert agree(up_to_four, by_mitsuba(5))


RED = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.5, 0.3]}}
BOARD = {"type": "diffuse", "reflectance": {"type": "checkerboard"}}
MIRRORS = {"type": "retroreflector", "reflectance": 0.5, "lobe_exponent": 20.0}


@pytest.mark.parametrize(
    ("kind", "bsdf", "plain"),
    [
        ("rectangle", RED, True),
        ("rectangle", {"type": "twosided", "bsdf": RED}, True),
        ("rectangle", MIRRORS, True),
        ("rectangle", BOARD, False),
        ("rectangle", {"type": "roughconductor", "alpha": 0.3}, False),
        ("disk", RED, True),
        ("cylinder", RED, True),
        ("cube", RED, True),
        ("sphere", RED, False),
    ],
)
@pytest.mark.parametrize("flip", [False, True])
def test_sampled_points_are_those_that_rays_find(kind, bsdf, plain, flip, monkeypatch):
    pose = mi.ScalarTransform4f().translate([0.3, 0.1, 1]).rotate([0, 1, 0], 200).scale(0.3)
    shape = {"type": kind, "to_world": pose, "bsdf": bsdf, "flip_normals": flip}
    setup = nlos.Setup(sensor=(-0.6, 0.3, 1.2))
    loaded = nlos.load_nlos(nlos.confocal(setup, {"hidden": shape}, film(2, 2)))

    def picture() -> np.ndarray:
        return np.array(mi.render(loaded, spp=1024, seed=1)[0], dtype=np.float64)

    shown = picture()
    plan = loaded.integrator().plan(loaded, loaded.sensors()[0])
    assert plan.scattering.targets.plain == plain
    monkeypatch.setattr(guided, "is_plain", lambda shape: False)
    assert shown == pytest.approx(picture(), rel=2e-3, abs=1e-6)


def test_meshes_with_shading_normals_are_looked_at_by_rays():
    for mesh, plain in ((letter_z_mesh(), True), (bunny_mesh(), False)):
        assert guided.is_plain(mesh) == plain
