"""The scenes of non-line-of-sight captures: identities, and who sees whom."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.nlos import BOXES, CONFOCAL, WALLS, WITH_WALL, builder, stands_alone
from helpers.scenes import numbers

SMALL = {"width": 16, "height": 12, "spp": 4}
DEVICES = dict.fromkeys(WALLS, (-0.5, 0, 0.25)) | dict.fromkeys(BOXES, (0, 0, 0))


@pytest.mark.parametrize("optimize", [True, False])
@pytest.mark.parametrize("name", WITH_WALL)
def test_shapes_keep_their_identity(name, optimize):
    described = builder(name, **SMALL)
    named = {key for key in described if key.startswith(("relay", "hidden", "occluder"))}
    assert "relay_wall" in named
    scene = stands_alone(described, optimize)
    assert sorted(shape.id() for shape in scene.shapes()) == sorted(named)
    wall = next(shape for shape in scene.shapes() if shape.id() == "relay_wall")
    half = 1 if name in WALLS else 2
    assert list(np.array(wall.bbox().max - wall.bbox().min).ravel()) == [2 * half, 2 * half, 0]


def points_on(scene: mi.Scene, start: str, count: int = 4096) -> tuple:
    """Points and normals on the shapes whose ids start so."""
    sampler = numbers(3, count)
    chosen = [shape for shape in scene.shapes() if shape.id().startswith(start)]
    for shape in chosen:
        sample = shape.sample_position(0, sampler.next_2d())
        yield sample.p, sample.n


def sees(scene: mi.Scene, origin, points) -> np.ndarray:
    """Whether nothing is between a place and points."""
    si = dr.zeros(mi.Interaction3f, dr.width(points))
    si.p = mi.Point3f(origin)
    way = points - si.p
    ray = mi.Ray3f(si.p, way, 1 - 1e-4, 0, [])
    return ~np.array(scene.ray_test(ray))


@pytest.mark.parametrize("name", [*WALLS, *BOXES])
def test_device_sees_the_wall_and_nothing_hidden(name):
    scene = stands_alone(builder(name, **({"occluder": True} if name in WALLS else {})))
    for points, _ in points_on(scene, "hidden"):
        assert not sees(scene, DEVICES[name], points).any()
    (wall, _), *_ = points_on(scene, "relay_wall")
    visible = sees(scene, DEVICES[name], wall)
    if name in WALLS:
        assert visible.all()
    else:
        assert (visible == (np.array(wall.y) > 0)).mean() > 0.999  # the upper half


@pytest.mark.parametrize("name", WITH_WALL)
def test_wall_sees_every_hidden_shape(name):
    """From the wall's point that the device looks at, some part of each; and they face the wall."""
    scene = stands_alone(builder(name))
    spot = [0.0, 0.0, 0.01] if name in WALLS else [0.1, 0.5, -1.99]
    for points, normals in points_on(scene, "hidden"):
        facing = np.array(dr.dot(normals, mi.Point3f(spot) - points)) > 1e-3
        assert facing.any()
        # the shape itself is in the way of its far side; its near side is lit but for neighbors
        lifted = points + 1e-3 * normals
        share = (sees(scene, spot, lifted) & facing).sum() / facing.sum()
        assert share > 0.2


def test_occluder_shadows_little_between_wall_and_letter():
    scene = stands_alone(builder("nlos_z"))
    (wall, _), *_ = points_on(scene, "relay_wall")
    (letter, _), *_ = points_on(scene, "hidden")
    hidden = ~sees(scene, wall + 1e-4 * (letter - wall), letter)
    assert 0 < hidden.mean() < 0.02


@pytest.mark.parametrize("name", WALLS)
def test_window_starts_before_the_first_hidden_light(name):
    scene = stands_alone(builder(name))
    film = builder(name)["relay_wall"]["sensor"]["film"]
    nearest = min(float(dr.min(points.z)[0]) for points, _ in points_on(scene, "hidden"))
    assert 0.1 < 2 * nearest - film["start_opl"] < 0.2


def test_camera_scenes_render():
    """A point light at the camera in place of the projector: the wall is lit, nothing is NaN."""
    for name in CONFOCAL:
        scene = stands_alone(builder(name, **SMALL), lamp=True)
        steady, transient = (np.array(x) for x in mi.render(scene, spp=4))
        assert np.isfinite(transient).all()
        assert steady.shape == (12, 16, 3)
        rows = steady.mean(axis=(1, 2))
        assert rows[:6].min() > 0.02
        if name in BOXES:  # below is the box, which is almost black but retroreflects
            assert (steady[8:, :, 1:] < 1e-3).mean() > 0.5 or name == "wall_box_hi_nlos"
