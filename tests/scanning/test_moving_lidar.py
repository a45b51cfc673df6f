"""A lidar with shots that see a moving scene at their times."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.scenes import load

from tofrender import Motion, moving
from tofrender.scanning import lidar, point_cloud, scan_pattern, true_points

RATE = 1e3
PATTERN = scan_pattern(shots=(12, 12), fov_deg=(20, 14), rate_hz=RATE)
LATE = PATTERN.assign(time=PATTERN["time"] + 0.2)  # The scan begins at 0.2 s
QUIET = {"progress": False, "max_range": 20.0, "spp": 4, "divergence_rad": 0.0}


def scene(half: float = 60.0, **motions: Motion) -> mi.Scene:
    """Return a square 5 m in front of a sensor at the origin that looks along z."""
    square = mi.ScalarTransform4f().translate([0, 0, 5]).rotate([0, 1, 0], 180).scale(half)
    described = {"type": "scene", "sensor": {"type": "perspective"}}
    return moving(load(described | {"square": {"type": "rectangle", "to_world": square}}), motions)


@pytest.mark.essential
def test_each_shot_sees_a_receding_wall_at_its_time():
    """The error is half of the motion during a pose. Echoes agree with the true distances."""
    speed, pose = 4.0, 4e-3
    shots = lidar(scene(square=Motion((0, 0, speed))), LATE, pose_time_s=pose, **QUIET)
    depth = shots["true_range"].values * shots["direction"].values[:, 2]
    error = depth - (5 + speed * LATE["time"].values)
    assert np.abs(error).max() <= speed * pose / 2 + 1e-5
    assert np.abs(error).max() > speed * pose / 4
    cloud = point_cloud(shots, seed=1)
    assert cloud.sizes["point"] > 0.9 * len(depth)
    assert np.abs(cloud["range"] - cloud["true_range"]).median() < 0.01


def test_a_box_that_goes_sideways_is_sheared():
    """The lidar scans row by row. Therefore each row sees the square at a later position."""
    speed, pose, half = 4.0, 2e-3, 0.3
    square = scene(half, square=Motion((speed, 0, 0)))
    truth = true_points(lidar(square, PATTERN, pose_time_s=pose, **QUIET))
    x, row = truth["x"].values, truth["shot"].values // 12
    middles = np.array([[x[row == k].mean(), k] for k in np.unique(row)])
    shift = np.polyfit(middles[:, 1], middles[:, 0], 1)[0]
    assert shift == pytest.approx(speed * 12 / RATE, rel=0.25)
    assert np.abs(x - speed * truth["time"].values).max() < half + speed * pose / 2
    assert np.abs(x).max() > 1.7 * half


def test_a_moving_sensor_has_an_origin_for_each_shot():
    velocity = np.array([1.0, 0, 2.0])
    shots = lidar(scene(sensor=Motion(tuple(velocity))), LATE, pose_time_s=2e-3, **QUIET)
    assert shots["origin"].dims == ("shot", "axis")
    expected = LATE["time"].values[:, None] * velocity
    np.testing.assert_allclose(shots["origin"], expected, atol=2.0 * 1e-3 + 1e-6)
    truth = true_points(shots)
    np.testing.assert_allclose(truth["z"], 5, atol=1e-4)
    depth = shots["true_range"].values[0] * shots["direction"].values[0, 2]
    assert depth == pytest.approx(5 - expected[0, 2], abs=3e-3)
    assert lidar(scene(), PATTERN, **QUIET)["origin"].dims == ("axis",)


def test_poses_share_kernels():
    """A scan with 48 poses compiles the same kernels as a scan with one pose."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        lidar(scene(sensor=Motion((1.1, 0, 0))), PATTERN, pose_time_s=3e-3, **QUIET)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert len(kernels) > 48
    assert sum(not each["cache_hit"] for each in kernels) < 24
