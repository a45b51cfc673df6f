"""The moving scenes: velocities of their parts, and rates of change that follow from them."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.scenes import load, pixel_rays

import tofrender
from tofrender.scenes import BUILT_IN
from tofrender.scenes.motion import motions_of, posed

SIZE = 12
MOVING = {
    "fan": {f"blade-{k}" for k in range(5)} | {"hub"},
    "corridor": {"body", "head", "left-leg", "right-leg", "left-arm", "right-arm"},
    "moving_mirror": {"mirror"},
}


@pytest.mark.parametrize("name", MOVING)
def test_parts_that_move(name):
    assert motions_of(load(BUILT_IN[name]())).keys() == MOVING[name]
    still = {"fan": ("angular_speed",), "corridor": ("speed", "swing"), "moving_mirror": ("speed",)}
    assert not motions_of(load(BUILT_IN[name](**dict.fromkeys(still[name], 0))))


def surfaces(scene: mi.Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Ids of the shapes at the pixels' centers, points, distances and velocities there."""
    rays = pixel_rays(scene, SIZE, SIZE)
    si = scene.ray_intersect(rays)
    index = np.array(dr.reinterpret_array(mi.UInt32, si.shape))
    known = {int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]): s for s in scene.shapes()}
    ids = np.array([known[k].id() if k in known else "" for k in index])
    points, motions = np.array(si.p).T, motions_of(scene)
    velocities = np.zeros_like(points)
    for each, motion in motions.items():
        at = ids == each
        at_origin, spin = motion.affine()
        velocities[at] = at_origin + np.cross(spin, points[at])
    return ids, points, np.array(rays.d).T, velocities


@pytest.mark.parametrize("name", ["fan", "corridor"])
def test_poses_move_at_the_velocities(name):
    """Distances of what pixels see change by v·n / d·n, with n the normal."""
    scene, dt = load(BUILT_IN[name](width=SIZE, height=SIZE)), 1e-3
    ids, _, d, velocities = surfaces(scene)
    n = np.array(scene.ray_intersect(pixel_rays(scene, SIZE, SIZE)).n).T
    found, shapes = [], []
    for time in (-dt, dt):
        with posed(scene, time):
            found.append(np.array(scene.ray_intersect(pixel_rays(scene, SIZE, SIZE)).t))
            shapes.append(surfaces(scene)[0])
    valid = (ids != "") & (shapes[0] == ids) & (shapes[1] == ids)
    rate = (velocities * n).sum(1) / (d * n).sum(1)
    assert (np.abs(rate[valid]) > 0.5).sum() > 5
    error = (found[1] - found[0]) / (2 * dt) - rate
    assert (np.abs(error[valid]) < 0.02 + 0.03 * np.abs(rate[valid])).all()


@pytest.mark.parametrize("name", ["fan", "corridor"])
def test_direct_light_has_twice_the_radial_velocity(name):
    """Camera and flash are one point. Where a pixel sees one shape, within its width."""
    fov = 2.0  # degrees, so that velocities hardly vary over a pixel
    described = BUILT_IN[name](width=SIZE, height=SIZE, max_depth=2)
    described["sensor"]["fov"] = fov
    target = [0.2, 0.25, 0.0] if name == "fan" else [0.1, 0.5, 0.0]
    eye = described["flash"]["position"]
    described["sensor"]["to_world"] = mi.ScalarTransform4f().look_at(eye, target, [0, 1, 0])
    scene = load(described)
    light = tofrender.range_rate(
        scene, spp=64, rate_bins=400, rates=(-40, 40), window=(0, 40), bins=1, progress=False
    )
    rates = light["radiance"].sum(("opl", "channel"))
    mean = (rates * light["rate"]).sum("rate") / rates.sum("rate")
    ids, _, d, velocities = surfaces(scene)
    expected = 2 * (velocities * d).sum(1).reshape(SIZE, SIZE)
    picture = ids.reshape(SIZE, SIZE)
    inner = np.zeros((SIZE, SIZE), bool)
    inner[1:-1, 1:-1] = [
        [len(set(picture[y - 1 : y + 2, x - 1 : x + 2].ravel())) == 1 for x in range(1, SIZE - 1)]
        for y in range(1, SIZE - 1)
    ]
    moves = inner & np.isin(picture, list(MOVING[name]))
    assert moves.sum() > 10
    assert np.abs(expected[moves]).max() > 1
    np.testing.assert_allclose(mean.values[inner], expected[inner], atol=0.12)


def test_the_mirror_is_seen_by_paths_that_grow():
    """By twice its speed in the middle; in the glass, which reflects earlier, by none."""
    described = BUILT_IN["moving_mirror"](width=4, height=4, speed=3.0)
    described["sensor"]["fov"] = 1.0
    light = tofrender.range_rate(
        load(described), spp=256, rate_bins=81, rates=(-20.25, 20.25), progress=False
    )
    found = light["radiance"].sum(("y", "x", "opl", "channel")).values
    total, rates = found.sum(), light["rate"].values
    both = np.isin(np.round(rates, 2), (0.0, 6.0))
    assert found[both].sum() > 0.9 * total
    assert found[np.isclose(rates, 6)] > 3 * found[np.isclose(rates, 0)] > 0
    again = found[np.isclose(rates, 12)]  # Between glass and mirror once more
    assert 0.02 * total < again < 0.1 * total
