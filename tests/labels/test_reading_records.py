"""Records of data sets and pictures of pyramids are read by their labels."""

import json

import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import small_capture
from helpers.made_dataset import make_dataset
from helpers.support import refused

import tofrender
from tofrender.datasets import capture_of, render_of
from tofrender.sensors import expected_photons

RECORDS = (3, 8)


def data_set(steady=True):
    """Return a data set of two renders, as `load_dataset` returns it."""
    renders = [make_dataset(4, 6, 12, x0=6, y0=2, seed=record) for record in RECORDS]
    whole = xr.concat([each.drop_attrs() for each in renders], "record")
    about = [
        json.dumps({"record": r, "render": dict(f.attrs)})
        for r, f in zip(RECORDS, renders, strict=True)
    ]
    whole = whole.assign_coords(record=list(RECORDS)).assign(made_with=("record", about))
    attrs = {name: renders[0].attrs[name] for name in ("start_opl", "bin_width_opl")}
    attrs |= {"quantity": "radiance per bin", "temporal_bins": 12}
    whole = whole.drop_vars("time").assign_attrs(attrs)
    return whole if steady else whole.drop_vars("steady")


def turned(data):
    """Return the same data in another order of axes and labels."""
    axes = [axis for axis in data.dims if axis != "record"]
    data = data.isel({axis: slice(None, None, -1) for axis in axes})
    return data.transpose(*reversed(list(data.dims)))


def test_the_render_of_a_record_in_any_order():
    whole = data_set()
    right = render_of(whole, 8)
    np.testing.assert_array_equal(right["transient"], whole["transient"][1])
    xr.testing.assert_identical(render_of(turned(whole), 8), right)
    xr.testing.assert_identical(render_of(whole.isel(record=1), 8), right)
    part = {"opl": slice(4, 9), "x": [2, 3], "channel": [1]}
    found = render_of(whole.isel(part), 8)
    np.testing.assert_array_equal(found["transient"], right["transient"].isel(part))
    start = float(right["opl"][4]) - right.attrs["bin_width_opl"] / 2
    assert found.attrs["start_opl"] == pytest.approx(start)
    light = float(found["transient"].sum()) / float(found["steady"].sum())
    assert found.attrs["energy_outside_window"] == pytest.approx(1 - light, abs=1e-6)


def test_records_that_are_refused():
    whole = data_set()
    for change, said in (
        (lambda d: d.isel(record=1, drop=True), "record is missing"),
        (lambda d: d.drop_vars("made_with"), "made_with is missing"),
        (lambda d: d.isel(record=[1, 1]), "record = 8: must be one"),
        (lambda d: d.isel(opl=slice(None, None, 2)), "rebin"),
        (lambda d: d.isel(x=0), "axis x"),
        (lambda d: d.expand_dims(frame=2), "axis frame"),
        (lambda d: d["transient"], "load_dataset"),
    ):
        refused(said, render_of, change(whole), 8)
    part = data_set(steady=False).isel(opl=slice(4, 9))
    refused("has 5 of 12 bins, and no steady pictures", render_of, part, 8)


def test_functions_of_light_accept_a_chosen_record():
    whole = data_set()
    right = render_of(whole, 8)
    one = whole.isel(record=1)
    for found, expected in zip(
        tofrender.transient_to_phasor(one, 20e6),
        tofrender.transient_to_phasor(right, 20e6),
        strict=True,
    ):
        np.testing.assert_array_equal(found, expected)
    rates = [expected_photons(each, photons_per_cycle=0.5)["rate"] for each in (one, right)]
    xr.testing.assert_equal(*rates)


def test_functions_of_light_accept_a_picture_of_a_pyramid():
    scene = tofrender.cornell_box(width=5, height=4, temporal_bins=20, bin_width_opl=0.5)
    pyramid = tofrender.strategy_pyramid(scene, max_depth=2, spp=2, progress=False)
    assert pyramid.attrs["quantity"] == "radiance per bin"
    light = pyramid["steady"].sum(("y", "x", "channel")).sel(weighting="none")
    number = int(np.argmax(light.values))
    one = pyramid.isel(weighting=1, strategy=number)
    found = tofrender.transient_to_phasor(one, 20e6)
    attrs = pyramid.attrs
    axis = attrs["start_opl"], attrs["bin_width_opl"]
    right = tofrender.transient_to_phasor(pyramid["transient"].values[1, number], 20e6, *axis)
    for mine, expected in zip(found, right, strict=True):
        np.testing.assert_array_equal(mine, expected)
    assert found[2].max() > 0


def test_a_part_of_the_wall_is_a_capture():
    capture = small_capture()
    names = ("capture_mode", "start_opl", "bin_width_opl", "counts_first_and_last_legs")
    about = {"capture": {name: capture.attrs[name] for name in names} | {"spp": 4}}
    about |= {"scene": "s", "render_seed": 3}
    axes = {"y": "wall_y", "x": "wall_x", "opl": "capture_opl"}
    stored = {}
    for name in ("transient", "sensor_grid", "sensor_normals", "sensor_origin", "laser_origin"):
        values = capture[name].drop_vars("time", errors="ignore")
        values = values.rename({axis: axes[axis] for axis in axes if axis in values.dims})
        stored["capture" if name == "transient" else f"capture_{name}"] = values
    whole = xr.concat([xr.Dataset(stored).drop_attrs()] * 2, "record").assign_coords(record=[0, 1])
    whole = whole.assign(made_with=("record", [json.dumps(about)] * 2))
    right = capture_of(whole, 1)
    np.testing.assert_array_equal(right["transient"], capture["transient"])
    part = capture_of(whole.isel(wall_x=[3, 1, 2]), 1)
    np.testing.assert_array_equal(part["sensor_grid"], capture["sensor_grid"][:, 1:])
    np.testing.assert_array_equal(part["transient"], capture["transient"][:, 1:])
    refused("axis opl", capture_of, whole.isel(capture_opl=3), 1)
    refused("axis x", capture_of, whole.isel(wall_x=0), 1)
    refused("sensor_grid is missing", capture_of, whole.drop_vars("capture_sensor_grid"), 1)
    refused("has no captures", capture_of, data_set(), 8)
