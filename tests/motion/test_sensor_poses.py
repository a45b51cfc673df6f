"""Renders from many poses of a sensor against scenes whose sensor is placed there."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import diffuse, plane, point_light, rotate, translate, unit
from helpers.scenes import refusal
from helpers.support import camera, film, scene

import tofrender
from tofrender import Motion
from tofrender.motion import render_poses, sensor_poses as module

QUIET = {"spp": 4, "seed": 5, "progress": False}
FIRST = translate(0.2, 0.4, 3.0) @ rotate((0, 1, 0), 170)
PLACES = [
    translate(0.3, -0.2, 2.0) @ rotate(unit((0.1, 1, 0.2)), 165),
    translate(-0.4, 0.3, 2.5) @ rotate(unit((-0.2, 1, 0.1)), 190),
]
POSES = np.array([np.array(each.matrix, np.float64) for each in PLACES])


def described(place, **more) -> dict:
    """A tilted square and a ball before a wall, with a lamp at the sensor and one at rest."""
    at = np.array(place.matrix, np.float64) @ [0.1, 0.0, 0.0, 1.0]
    parts = {
        "back": plane(translate(0, 0, -2), 3.0, bsdf=diffuse(0.5)),
        "ball": {"type": "sphere", "center": [0.2, 0.1, 0.0], "radius": 0.4, "bsdf": diffuse(0.8)},
        "lamp": point_light((1, 2, 3), 4.0),
        "laser": point_light(at[:3].tolist(), 6.0),
    }
    view = camera((0, 0, 3), (0, 0, 0), film(6, 4, bins=20, start=1.0, bin_width=0.7), fov=50)
    view |= {"to_world": place, "id": "eye"} | more
    return scene(parts, view, max_depth=3)


def test_each_pose_is_the_render_of_a_scene_built_so():
    found = render_poses(described(FIRST), POSES, attached=["laser"], **QUIET)
    assert found["transient"].dims == ("pose", "y", "x", "opl", "channel")
    np.testing.assert_array_equal(found["to_world"], POSES)
    for k, place in enumerate(PLACES):
        alone = tofrender.render(tofrender.load_scene(described(place), optimize=False), **QUIET)
        scale = float(alone["steady"].max())
        np.testing.assert_allclose(found["steady"][k], alone["steady"], atol=1e-3 * scale)
        pixels = ("y", "x")
        seen, expected = found["transient"][k].sum(pixels), alone["transient"].sum(pixels)
        np.testing.assert_allclose(seen, expected, atol=1e-3 * float(expected.max()))
    assert abs(found["steady"][0] - found["steady"][1]).max() > 0.1 * scale


def test_a_lamp_that_is_not_attached_stays():
    moved = render_poses(described(FIRST), POSES, attached=["laser"], **QUIET)
    stays = render_poses(described(FIRST), POSES, **QUIET)
    assert abs(moved["steady"] - stays["steady"]).max() > 0.05 * moved["steady"].max()
    assert moved.attrs["fingerprint"] != stays.attrs["fingerprint"]


def test_a_loaded_scene_is_left_as_it_was():
    loaded = tofrender.load_scene(described(FIRST), optimize=False)
    before = tofrender.render(loaded, **QUIET)
    render_poses(loaded, POSES[:1], attached=["laser"], **QUIET)
    after = tofrender.render(loaded, **QUIET)
    assert np.array_equal(before["transient"], after["transient"])


@pytest.mark.parametrize("crop", [{}, {"crop_width": 3, "crop_offset_x": 2, "crop_height": 2}])
def test_tangents_are_those_of_rays(crop):
    """A wall across the axis at the distance 1: points of hits are tangents."""
    view = camera((0, 0, 0), (0, 0, 1), film(6, 4, bins=2, start=0.0, bin_width=9.0), fov=50)
    view["film"] |= crop
    wall = {"wall": plane(translate(0, 0, 1) @ rotate((0, 1, 0), 180), 9.0)}
    pose = np.array(PLACES[0].matrix, np.float64)
    found = render_poses(scene(wall | {"lamp": point_light((0, 0, 0), 1.0)}, view), [pose], **QUIET)
    half = np.tan(np.radians(25))
    x = half * (1 - 2 * (found["x"].values + 0.5) / 6)
    y = half * 4 / 6 * (1 - 2 * (found["y"].values + 0.5) / 4)
    np.testing.assert_allclose(found["tan_x"], x, atol=1e-6)
    np.testing.assert_allclose(found["tan_y"], y, atol=1e-6)


SCALED = POSES * np.array([2.0, 1, 1, 1])
MIRRORED = POSES * np.array([-1.0, 1, 1, 1])


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (SCALED, "rigid"),
        (MIRRORED, "rigid"),
        (POSES[0], "poses"),
        (POSES[:0], "poses"),
        (POSES * np.nan, "finite"),
        ("poses", "poses"),
        (np.zeros((1, 4, 4)), "rigid"),
    ],
)
def test_wrong_poses_are_refused(poses, words):
    assert words in refusal(render_poses, described(FIRST), poses, **QUIET)


def test_what_is_not_supported_is_refused():
    scene = described(FIRST)
    assert "attached" in refusal(render_poses, scene, POSES, attached=["lase"], **QUIET)
    assert "list" in refusal(render_poses, scene, POSES, attached="laser", **QUIET)
    assert "auto" in refusal(render_poses, scene, POSES, window="auto", **QUIET)
    assert "denoise" in refusal(render_poses, scene, POSES, denoise=True, kind=TypeError, **QUIET)
    moving = tofrender.load_scene(scene, optimize=False)
    tofrender.moving(moving, {"ball": Motion(velocity=(0, 0, 1))})
    assert "at rest" in refusal(render_poses, moving, POSES, **QUIET)
    steady = tofrender.cornell_box_steady_state(width=4, height=4)
    assert "window" in refusal(render_poses, steady, POSES, **QUIET)


def test_a_render_that_is_stopped_returns_finished_poses(monkeypatch):
    real = module.render_item
    calls = []

    def stopped(job, item, **options):
        result = real(job, item, **options)
        calls.append(item)
        if len(calls) == 2:
            result.done = 0
        return result

    monkeypatch.setattr(module, "render_item", stopped)
    with pytest.warns(UserWarning, match="interrupted after 1 of 2 poses"):
        found = render_poses(described(FIRST), POSES, **QUIET)
    assert found.sizes["pose"] == 1
    assert found.attrs["complete"] == 0


def test_light_outside_the_window_is_warned_of():
    with pytest.warns(UserWarning, match="outside the window"):
        render_poses(described(FIRST), POSES[:1], window=(0.0, 3.0), bins=8, **QUIET)


def test_the_sensor_need_not_have_an_id():
    view = described(FIRST)
    unnamed = {name: part for name, part in view.items() if part is not None}
    for part in unnamed.values():
        if isinstance(part, dict):
            part.pop("id", None)
    found = render_poses(unnamed, POSES[:1], **QUIET)
    named = render_poses(described(FIRST), POSES[:1], **QUIET)
    np.testing.assert_array_equal(found["transient"], named["transient"])
    assert isinstance(tofrender.load_scene(unnamed), mi.Scene)
