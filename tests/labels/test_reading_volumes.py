"""Volumes, true depths and captures are read by their labels."""

import numpy as np
import pytest
import xarray as xr
from helpers.support import refused

from tofrender import depth_error, depth_map, hidden_depth, max_projection
from tofrender.nlos import make_capture

NX, NY, NZ = 5, 4, 6


def volume():
    """Return a square-free volume in the frame of a tilted wall."""
    rng = np.random.default_rng(2)
    z_axis = np.array([0.6, 0.0, 0.8])
    y_axis = np.array([0.0, 1.0, 0.0])
    variables = {
        "intensity": (("z", "y", "x"), rng.random((NZ, NY, NX), dtype=np.float32)),
        "frame_origin": ("xyz", np.array([0.1, 0.2, 0.3])),
        "frame_axes": (("axis", "xyz"), np.stack([np.cross(y_axis, z_axis), y_axis, z_axis])),
    }
    axes = {
        "z": 0.7 + 0.1 * np.arange(NZ),
        "y": -0.3 + 0.2 * np.arange(NY),
        "x": -0.4 + 0.2 * np.arange(NX),
        "xyz": [*"xyz"],
        "axis": [*"xyz"],
    }
    return xr.Dataset(variables, axes)


def turned(data):
    """Return the same data in another order of axes and labels."""
    data = data.isel({axis: slice(None, None, -1) for axis in data.dims})
    return data.transpose(*reversed(list(data.dims)))


def test_depths_in_any_order():
    data = volume()
    depth = depth_map(data)
    xr.testing.assert_identical(depth_map(turned(data)), depth)
    xr.testing.assert_identical(max_projection(turned(data)), max_projection(data))
    truth = depth + np.linspace(0, 0.4, NY * NX).reshape(NY, NX)
    right = depth_error(data, truth)
    assert right.mean == pytest.approx(0.2)
    assert depth_error(data, truth.values) == right
    assert depth_error(turned(data), truth) == right
    assert depth_error(data, truth.T[::-1]) == right
    assert depth_error(turned(data), truth.values[::-1, ::-1]) == right
    refused("truth: the axis y has other labels", depth_error, data, truth.isel(y=[0, 1]))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.isel(z=[0, 1, 4]), "in the coordinate z"),
        (lambda d: d.isel(x=0), "axis x"),
        (lambda d: d.drop_vars("z"), "coordinate z is missing"),
        (lambda d: d.expand_dims(frame=2), "axis frame"),
        (lambda d: d["intensity"], "pass the whole Dataset"),
        (lambda d: d.isel(y=slice(0, 0)), "axis y is empty"),
    ],
)
def test_what_is_no_volume(change, said):
    for function in (depth_map, max_projection):
        refused(f"^volume: .*{said}", function, change(volume()))


def test_hidden_depths_are_found_by_labels():
    """A plane is hidden before a wall that is not square."""
    y, x = np.meshgrid(np.linspace(-0.3, 0.3, 3), np.linspace(-0.6, 0.6, 4), indexing="ij")
    wall = np.stack([x, y, 0 * x], axis=-1)
    tilt = np.array([0.1, 0.2, 0.0]) * x[..., None] + [0, 0, 1]
    normals = tilt / np.linalg.norm(tilt, axis=-1, keepdims=True)
    capture = make_capture(
        np.ones((3, 4, 5), np.float32),
        mode="confocal",
        start_opl=1.0,
        bin_width_opl=0.1,
        sensor_grid=wall,
        sensor_normals=normals,
    )
    right = hidden_depth("nlos_plane", capture)
    assert np.isfinite(right).all()
    assert right.std() > 1e-3
    found = hidden_depth("nlos_plane", turned(capture).isel(xyz=[2, 0, 1]))
    xr.testing.assert_identical(found, right)
    voxels = volume().assign(frame_origin=("xyz", [0.0, 0, 0]))
    right = hidden_depth("nlos_plane", voxels)
    xr.testing.assert_identical(hidden_depth("nlos_plane", turned(voxels)), right)
    refused("where: the axis xyz", hidden_depth, "nlos_plane", capture.isel(xyz=[0, 1]))
    refused("where: expected a Dataset of rec.* or a cap", hidden_depth, "nlos_plane", wall)
