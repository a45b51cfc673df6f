"""Captures are read by their labels: records, reconstructions, files and labeled arrays."""

import json

import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import Wall, capture_of, rectangle, small_capture
from helpers.support import refused

from tofrender import datasets, load_capture, make_capture, reconstruct, save_capture
from tofrender.sensors import sense

PARAMETERS = ("capture_mode", "start_opl", "bin_width_opl", "counts_first_and_last_legs")


def colored():
    """Return a capture with three different channels."""
    gray = small_capture()
    light = gray["transient"].values * np.float32([0.2, 1.0, 3.0])
    given = {name.removeprefix("capture_"): gray.attrs[name] for name in PARAMETERS}
    given["counts_first_and_last_legs"] = bool(given["counts_first_and_last_legs"])
    names = ["sensor_grid", "sensor_normals", "sensor_origin", "laser_origin"]
    given |= {name: gray[name].values for name in names}
    if given["mode"] != "confocal":
        given |= {name: gray[name].values for name in ("laser_grid", "laser_normals")}
    return make_capture(light, **given)


def data_set(capture):
    """Return a data set with two records of the same capture, as `load_dataset` returns it."""
    axes = {"y": "wall_y", "x": "wall_x", "opl": "capture_opl"}
    about = {"capture": {name: capture.attrs[name] for name in PARAMETERS} | {"spp": 4}}
    about |= {"scene": "s", "render_seed": 3}
    found = {}
    for name in capture.data_vars:
        is_laser = name in ("laser_grid", "laser_normals")
        if is_laser and capture.attrs["capture_mode"] == "confocal":
            continue
        values = capture[name].drop_vars("time", errors="ignore")
        values = values.rename({axis: axes[axis] for axis in axes if axis in values.dims})
        found["capture" if name == "transient" else f"capture_{name}"] = values
    found["capture_on_wall"] = xr.ones_like(found["capture_sensor_grid"][..., 0], bool)
    found["capture_on_wall"] = found["capture_on_wall"].drop_vars("xyz", errors="ignore")
    whole = xr.Dataset(found).drop_attrs()
    both = xr.concat([whole, whole], "record").assign_coords(record=[0, 1])
    return both.assign(made_with=("record", [json.dumps(about)] * 2))


def turned(data):
    """Return the same data in another order of axes and labels."""
    reverse = {axis: slice(None, None, -1) for axis in data.dims if axis not in ("record", "xyz")}
    return data.isel(reverse).transpose(*reversed(list(data.dims)))


def test_records_have_the_bins_that_their_coordinate_says():
    capture = colored()
    found = data_set(capture)
    whole = datasets.capture_of(found, 1)
    np.testing.assert_array_equal(whole["transient"], capture["transient"])
    late = datasets.capture_of(found.isel(capture_opl=slice(20, None)), 1)
    np.testing.assert_allclose(late["opl"], capture["opl"][20:])
    start = float(capture["opl"][20]) - capture.attrs["bin_width_opl"] / 2
    assert late.attrs["start_opl"] == pytest.approx(start)
    mixed = datasets.capture_of(turned(found), 1)
    xr.testing.assert_identical(mixed.drop_vars(["y", "x"]), whole.drop_vars(["y", "x"]))
    xr.testing.assert_identical(datasets.capture_of(found.isel(record=1), 1), whole)
    coarse = found.isel(capture_opl=slice(None, None, 2))
    refused("dataset: the bins are .* apart", datasets.capture_of, coarse, 1)


def test_reconstructions_take_captures_in_any_order(tmp_path):
    capture = colored()
    right = reconstruct(capture, "bp", progress=False)
    mixed = turned(capture).isel(xyz=[2, 0, 1])
    xr.testing.assert_identical(reconstruct(mixed, "bp", progress=False), right)
    channels = capture.isel(channel=[1, 2, 0])
    xr.testing.assert_identical(reconstruct(channels, "bp", progress=False), right)
    save_capture(mixed, tmp_path / "a.h5")
    xr.testing.assert_identical(load_capture(tmp_path / "a.h5"), capture)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.isel(opl=slice(None, None, 2)), "rebin"),
        (lambda d: d.coarsen(x=2).mean(), "axis x|variable"),
        (lambda d: d.isel(x=0), "axis x"),
        (lambda d: d.isel(xyz=[0, 1]), "xyz"),
        (lambda d: d["transient"], "pass the whole Dataset"),
        (lambda d: d.assign_attrs(capture_mode="both"), "capture_mode"),
    ],
)
def test_what_is_no_capture(change, said):
    with xr.set_options(keep_attrs=True):
        bad = change(colored())
    refused(said, reconstruct, bad, "bp")


def test_counts_of_exhaustive_captures_are_refused():
    capture = capture_of(rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1), Wall(4), "exhaustive")
    assert capture.attrs["capture_mode"] == "exhaustive"
    sensor = {"cycles": 50, "photons": {"photons_per_cycle": 0.5}, "spad": {}}
    for each in (capture, turned(capture)):
        refused("exhaustive captures are not supported", sense, each, sensor)


def test_labeled_arrays_are_found_by_their_axes():
    capture = colored()
    given = {name.removeprefix("capture_"): capture.attrs[name] for name in PARAMETERS}
    names = ["sensor_grid", "sensor_normals", "sensor_origin", "laser_origin"]
    if given["mode"] != "confocal":
        names += ["laser_grid", "laser_normals"]
    mixed = turned(capture)
    arrays = {name: mixed[name] for name in names}
    found = make_capture(mixed["transient"], **given, **arrays)
    xr.testing.assert_identical(found, capture)
    refused("axis y", make_capture, mixed["transient"].rename(y="row"), **given, **arrays)
    later = {"start_opl": given["start_opl"] + 4 * given["bin_width_opl"]}
    part = make_capture(mixed["transient"].isel(opl=slice(None, -4)), **given | later, **arrays)
    np.testing.assert_array_equal(part["transient"], capture["transient"][:, :, 4:])
    moved = mixed["transient"].isel(opl=slice(None, -4))
    refused("transient: the bins in the coordinate opl", make_capture, moved, **given, **arrays)
    arrays["sensor_grid"] = mixed["sensor_grid"].assign_coords(x=mixed["x"].values + 1)
    refused("sensor_grid: the axis x", make_capture, mixed["transient"], **given, **arrays)
