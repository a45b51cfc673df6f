"""The true depth of hidden scenes, seen from walls anywhere."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import capture_of, rectangle, turned
from oracles.nlos import Rectangle

import tofrender
from tofrender.nlos import hidden_depth

AXES = ("z", "y", "x")


def volume(frame: np.ndarray, origin=(0.0, 0, 0), size: int = 41) -> xr.Dataset:
    """A volume's frame, over [-1, 1] x [-1, 1] of the wall."""
    at = np.linspace(-1, 1, size)
    variables = {
        "intensity": (AXES, np.zeros((1, size, size), np.float32)),
        "frame_origin": (("xyz",), np.asarray(origin, float)),
        "frame_axes": (("axis", "xyz"), np.asarray(frame, float)),
    }
    return xr.Dataset(variables, {"x": at, "y": at, "z": [1.0]})


@pytest.mark.parametrize("steps", [0, 70])
def test_a_sphere(steps):
    pose = mi.ScalarTransform4f().translate([1, -2, 3]).rotate([0.6, 0, 0.8], steps)
    matrix = np.array(pose.matrix)
    ball = {"type": "sphere", "center": [0.2, -0.1, 1.5], "radius": 0.4, "to_world": pose}
    wall = {"type": "rectangle", "to_world": pose}
    scene = mi.load_dict({"type": "scene", "relay_wall": wall, "hidden_ball": ball})
    where = volume(matrix[:3, :3].T, matrix[:3, 3])
    depth = hidden_depth(scene, where)
    assert depth.dims == ("y", "x")
    x, y = np.meshgrid(where["x"], where["y"])
    square = 0.4**2 - (x - 0.2) ** 2 - (y + 0.1) ** 2
    expected = np.where(square > 0, 1.5 - np.sqrt(np.maximum(square, 0)), np.nan)
    edge = abs(square) < 1e-3
    assert depth.values[~edge] == pytest.approx(expected[~edge], abs=1e-4, nan_ok=True)


def test_the_letter_through_its_occluder():
    where = volume(np.eye(3), size=401)
    depth = hidden_depth("nlos_z", where).values
    assert np.nanmin(depth) == pytest.approx(1, abs=1e-5)
    assert np.nanmax(depth) == pytest.approx(1, abs=1e-5)
    shape = tofrender.load_scene("nlos_z", optimize=False)
    letter = next(s for s in shape.shapes() if s.id() == "hidden_z")
    area = np.isfinite(depth).mean() * 2.005**2
    assert area == pytest.approx(letter.surface_area()[0], rel=0.02)
    plate = hidden_depth("nlos_z", where, hidden_shapes="occluder").values
    assert np.nanmax(plate) < 0.5


def test_what_is_hidden_can_be_said():
    plates = {"near": 1.0, "far": 2.0}
    described = {"type": "scene", "relay_wall": {"type": "rectangle"}}
    for name, z in plates.items():
        place = mi.ScalarTransform4f().translate([0, 0, z])
        described[name] = {"type": "rectangle", "to_world": place}
    scene = mi.load_dict(described, optimize=False)
    second = scene.shapes()[1]
    for names, z in (
        (None, 1),
        ("far", 2),
        (["far", "near"], 1),
        (second, plates.get(second.id(), math.nan)),
    ):
        depth = hidden_depth(scene, volume(np.eye(3), size=5), hidden_shapes=names).values[1:4, 1:4]
        assert depth == pytest.approx(np.full((3, 3), z), abs=1e-5, nan_ok=True)


def test_captures_have_their_own_points():
    wall = turned(8)
    capture = capture_of(rectangle((-0.5, 0.6), (-0.4, 0.8), 1.2, 0.2), wall, bins=4)
    places = [(-0.5, -0.4, 1.2), (0.6, -0.4, 1.2), (-0.5, 0.8, 1.2)]
    corner, across, along = wall.world(np.array(places))
    u, v = (across - corner) / 2, (along - corner) / 2
    scene = {"type": "scene", "hidden": Rectangle(corner + u + v, u, v).shape()}
    depth = hidden_depth(mi.load_dict(scene), capture).values
    x, y = np.moveaxis(wall.grid()[..., :2], -1, 0)
    inside = (x > -0.5) & (x < 0.6) & (y > -0.4) & (y < 0.8)
    assert depth == pytest.approx(np.where(inside, 1.2, np.nan), abs=1e-5, nan_ok=True)


@pytest.mark.parametrize(
    ("scene", "where", "options", "said"),
    [
        ("nlos_z", None, {}, r"where = NoneType: must be a result of reconstruct\(\) or capture"),
        ("nlos_z", xr.Dataset(), {}, "where = Dataset: must be a result of"),
        ("nlos_zz", "v", {}, "scene = 'nlos_zz': did you mean"),
        ("nlos_z", "v", {"hidden_shapes": "w"}, "hidden_shapes = 'w': the scene has no such"),
        ({"type": "scene"}, "v", {}, "scene: has no hidden shapes; hidden_shapes must name"),
    ],
)
def test_bad_input(scene, where, options, said):
    where = volume(np.eye(3), size=3) if where == "v" else where
    with pytest.raises(ValueError, match=rf"\A{said}.*\Z"):
        hidden_depth(scene, where, **options)
