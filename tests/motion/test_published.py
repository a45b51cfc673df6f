"""The scene that Kim et al. publish with "Doppler Time-of-Flight Rendering" (2023), qualitatively.

Camera and lamp are at one point, the tall box recedes at 10 m/s and the small one comes nearer.
Numbers are those of their description; signs and ratios those of their picture of 30 MHz, 1.5 ms,
one cycle, without an offset of phases.
"""

import mitsuba as mi
import numpy as np
import pytest
from helpers.scenes import load

import tofrender
from tofrender import Motion

SIZE = 64
BOXES = {
    "small": ([0.0852, 0.2895, 0, 0.3286], [0, 0, -0.3, 0.3], [-0.285, 0.0865, 0, 0.3746]),
    "tall": ([0.2868, 0.0982, 0, -0.3354], [0, 0, -0.6, 0.6], [-0.0998, 0.2823, 0, -0.2914]),
}
WALLS = {  # Color, and where the wall's square [-1, 1]^2 is turned and moved to
    "floor": ([0.725, 0.71, 0.68], [0, 0, 0], [1, 0, 0], -90),
    "ceiling": ([0.725, 0.71, 0.68], [0, 2, 0], [1, 0, 0], 90),
    "back": ([0.725, 0.71, 0.68], [0, 1, -1], [1, 0, 0], 0),
    "right": ([0.14, 0.45, 0.091], [1, 1, 0], [0, 1, 0], -90),
    "left": ([0.63, 0.065, 0.05], [-1, 1, 0], [0, 1, 0], 90),
}


def shape(kind, color, to_world):
    diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}}
    return {"type": kind, "to_world": to_world, "bsdf": {"type": "twosided", "one": diffuse}}


@pytest.fixture(scope="module")
def heterodyne():
    transform, white = mi.ScalarTransform4f, WALLS["floor"][0]
    eye = transform().look_at([0, 1, 6.8], [0, 1, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "integrator": {"type": "transient_path", "max_depth": 3},
        "sensor": {"type": "perspective", "fov": 19.5, "to_world": eye, "film": film},
        "lamp": {"type": "point", "position": [0, 1, 6.8], "intensity": 100.0},
    }
    for name, (color, at, axis, degrees) in WALLS.items():
        pose = transform().translate(at).rotate(axis, degrees)
        scene[name] = shape("rectangle", color, pose)
    for name, rows in BOXES.items():
        scene[name] = shape("cube", white, transform(np.array([*rows, [0, 0, 0, 1]])))
    moved = {"small": Motion((0, 0, 10.0)), "tall": Motion((0, 0, -10.0))}
    scene = tofrender.moving(load(scene), moved)
    measured = tofrender.doppler(scene, spp=64, progress=False)
    return measured["heterodyne"].sel(part="I").mean("channel").values


def test_faces_of_the_boxes(heterodyne):
    """The tall box is dark, the small one slightly bright; light that met neither is exactly 0."""
    tall, small = heterodyne[30:48, 19:30], heterodyne[48:58, 35:47]
    assert np.median(np.abs(heterodyne[10:22, 20:45])) == 0
    assert (tall < 0).all()
    assert np.median(small) > 0
    assert -9 < np.median(tall) / np.median(small) < -4


def test_edges_of_the_boxes(heterodyne):
    """Edges that uncover or cover the wall while the boxes move are the strongest signals."""
    face = abs(np.median(heterodyne[30:48, 19:30]))
    left_of_tall, right_of_small = heterodyne[34:54, 16:19], heterodyne[46:60, 46:51]
    below_small = heterodyne[60:63, 34:46]
    assert np.median(left_of_tall.min(axis=1)) < -1.5 * face
    assert np.median(right_of_small.max(axis=1)) > 2 * face
    assert np.median(below_small.max(axis=0)) > 2 * face
