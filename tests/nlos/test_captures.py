"""Captures: creating and checking them, and subtracting the first and last legs."""

import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import Wall, capture_of, sphere, turned

from tofrender.nlos import check_capture, make_capture, without_first_and_last_legs

WALL = Wall(4)
GRID = WALL.grid()
BASE = {"mode": "confocal", "start_opl": 1.0, "bin_width_opl": 0.01}
BASE |= {"sensor_grid": GRID, "sensor_normals": WALL.normals(GRID)}
LASER = {"laser_grid": (0, 0, 0), "laser_normals": (0, 0, 1)}


def make(transient=None, **changes) -> xr.Dataset:
    return make_capture(np.ones((4, 4, 10)) if transient is None else transient, **BASE | changes)


def test_dimensions_of_each_mode():
    confocal = make()
    assert confocal["transient"].dims == ("y", "x", "opl", "channel")
    assert confocal["laser_grid"].dims == ("y", "x", "xyz")
    assert confocal["laser_grid"].values.tobytes() == confocal["sensor_grid"].values.tobytes()
    single = make(mode="single", **LASER)
    assert single["transient"].dims == ("y", "x", "opl", "channel")
    assert single["laser_grid"].shape == (1, 1, 3)
    lit = WALL.grid(2)
    more = {"laser_grid": lit, "laser_normals": WALL.normals(lit)}
    exhaustive = make(np.ones((2, 2, 4, 4, 10, 3)), mode="exhaustive", **more)
    assert exhaustive["transient"].dims == ("laser_y", "laser_x", "y", "x", "opl", "channel")
    assert exhaustive["channel"].values.tolist() == ["R", "G", "B"]
    check_capture(confocal.isel(x=slice(0, 3), y=[1, 3]))
    for capture in (confocal, single, exhaustive):
        assert all(v.dtype == np.float32 for v in capture.data_vars.values())
        np.testing.assert_allclose(capture["opl"][[0, -1]], [1.005, 1.095])
        assert np.isnan(capture["sensor_origin"]).all()


def test_what_a_caller_changes_later_stays_out():
    grid = GRID.astype(np.float32)
    capture = make(sensor_grid=grid)
    grid[:] = 7
    assert capture["sensor_grid"].values.max() < 1
    assert not np.shares_memory(capture["sensor_grid"].values, capture["laser_grid"].values)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"transient": np.ones((4, 4))}, r"transient with shape \(4, 4\): must be"),
        ({"transient": np.ones((4, 4, 10, 2))}, "with 1 or 3 channels"),
        ({"transient": np.ones((4, 4, 0))}, r"transient with shape \(4, 4, 0\)"),
        ({"transient": np.ones((4, 5, 10))}, r"sensor_grid with shape .* must be of size 5 .* x"),
        ({"sensor_grid": GRID[..., :2]}, "sensor_grid with shape .*xyz of size 3"),
        ({"sensor_grid": GRID * np.nan}, "sensor_grid: must contain finite numbers"),
        ({"sensor_normals": 2 * BASE["sensor_normals"]}, "sensor_normals: .*length 1"),
        ({"laser_grid": GRID}, "laser_grid = .*: must be None"),
        ({"mode": "single"}, "laser_grid of type NoneType: must contain"),
        ({"on_wall": False}, r"on_wall = False: must be bool \(rows, columns\)"),
        ({"mode": "single", **LASER, "laser_grid": GRID}, "laser_"),
        ({"counts_first_and_last_legs": True}, "sensor_origin, laser_origin: must be finite"),
        ({"attrs": {"list": [1]}}, r"attribute list = \[1\]: must be text"),
    ],
)
def test_bad_input_in_one_line(changes, message):
    with pytest.raises(ValueError, match=rf"\A.*{message}.*\Z"):
        make(**changes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["transient"], "capture: expected a capture, found a DataArray"),
        (lambda c: c.drop_vars("laser_grid"), "the variable laser_grid is missing"),
        (lambda c: c.assign(extra=1), "variable extra is not supported in a capture"),
        (lambda c: c.drop_attrs(), "attribute capture_mode = None"),
        (lambda c: c.drop_vars("opl"), "the coordinate opl along the axis opl is missing"),
        (lambda c: c.assign_attrs(bin_width_opl=0.3), "bins are 0.01 m apart, but 0.3 m wide"),
        (lambda c: c.assign_coords(row=("y", [1, 2, 3, 4])), "coordinate row along y"),
        (lambda c: c.isel(opl=slice(0, 0)), "the axis opl is empty"),
        (lambda c: c.assign_attrs(counts_first_and_last_legs=2), "must be 0, 1"),
        (lambda c: c.assign(laser_grid=c["laser_grid"] + 1), "laser_grid of a confocal capture"),
    ],
)
def test_check_refuses(change, message):
    with pytest.raises(ValueError, match=rf"\A.*{message}.*\Z"):
        check_capture(change(make()))


@pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
def test_without_legs_is_the_capture_that_does_not_count_them(mode):
    patches = sphere((0.2, -0.1, 1), 0.1, 60)
    options = {"bins": 300, "width": 0.01, "lasers": 2, "start": 0.8}
    with_legs, without = (
        capture_of(patches, turned(4), mode, legs=legs, **options) for legs in (True, False)
    )
    bare = without_first_and_last_legs(with_legs)
    assert without_first_and_last_legs(without) is without
    check_capture(bare)
    assert bare.attrs["counts_first_and_last_legs"] == 0
    light = [c["transient"].values.astype(np.float64) for c in (bare, without)]
    np.testing.assert_allclose(light[0].sum(), with_legs["transient"].values.sum(), rtol=1e-5)
    np.testing.assert_allclose(light[0].sum(axis=-2), light[1].sum(axis=-2), rtol=1e-3)
    means = [
        np.einsum("...tc,t->...c", each, capture["opl"].values) / each.sum(axis=-2)
        for each, capture in zip(light, (bare, without), strict=True)
    ]
    # The closed form is binned to a sixteenth of a bin.
    np.testing.assert_allclose(means[0], means[1], atol=0.01 / 12)
