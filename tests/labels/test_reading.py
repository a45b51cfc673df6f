"""The reader of labeled data: order of axes and labels, time bins, refusals in one line."""

import numpy as np
import pytest
import xarray as xr

from tofrender.labels import COUNTS, FILM, bins_of, intensity, read, require_consecutive

START, WIDTH = 1.5, 0.25


def film(stokes: bool = False) -> xr.Dataset:
    """Return a film of 3 x 4 pixels and 5 bins whose values are all different."""
    axes = {"y": np.arange(2, 5), "x": np.arange(7, 11)}
    shape = (3, 4, 5, 3)
    dims = ("y", "x", "opl", "channel")
    if stokes:
        shape = (3, 4, 5, 4, 3)
        dims = ("y", "x", "opl", "stokes", "channel")
        axes["stokes"] = np.array(["S0", "S1", "S2", "S3"])
    light = np.random.default_rng(1).random(shape, dtype=np.float32)
    variables = {
        "transient": (dims, light),
        "steady": (tuple(axis for axis in dims if axis != "opl"), light.sum(axis=2)),
    }
    axes["opl"] = START + WIDTH * (np.arange(5) + 0.5)
    axes["channel"] = np.array(["R", "G", "B"])
    attrs = {"start_opl": START, "bin_width_opl": WIDTH, "quantity": "radiance per bin"}
    return xr.Dataset(variables, axes, attrs)


def test_data_in_order_are_returned_as_they_are():
    data = film()
    assert read(data, FILM, "dataset") is data


@pytest.mark.parametrize("stokes", [False, True])
def test_each_order_of_axes_and_labels_is_the_same(stokes):
    data = film(stokes)
    mixed = data.isel(x=[2, 0, 3, 1], y=slice(None, None, -1), opl=slice(None, None, -1))
    mixed = mixed.isel(channel=[1, 2, 0]).transpose("channel", "opl", ...)
    if stokes:
        mixed = mixed.isel(stokes=[3, 1, 0, 2])
    xr.testing.assert_identical(read(mixed, FILM, "dataset"), data)


def test_parts_keep_their_bins_and_pixels():
    part = film().isel(opl=slice(2, 4), x=slice(1, 3), channel=[2])
    found = read(part, FILM, "dataset")
    assert found.attrs["start_opl"] == START + 2 * WIDTH
    assert found["transient"].shape == (3, 2, 2, 1)
    assert bins_of(found, "dataset").edges_opl.tolist() == [2.0, 2.25, 2.5]


def test_one_bin_has_the_stated_width():
    bins = bins_of(film().isel(opl=[3]), "dataset")
    assert (bins.start_opl, bins.stop_opl, bins.count) == (2.25, 2.5, 1)


def test_intensity_is_found_by_its_name():
    data = film(stokes=True)
    turned = data.isel(stokes=[2, 0])
    xr.testing.assert_identical(intensity(turned, "d"), data.sel(stokes="S0", drop=True))
    with pytest.raises(ValueError, match="S0"):
        intensity(data.isel(stokes=[1, 2]), "d")


REFUSED = {
    "coarsened bins": (lambda d: d.isel(opl=slice(4)).coarsen(opl=2).sum(), "rebin"),
    "a single coarsened bin": (lambda d: d.isel(opl=[2, 3]).coarsen(opl=2).sum(), "rebin"),
    "every second bin": (lambda d: d.isel(opl=slice(None, None, 2)), "rebin"),
    "bins with a gap": (lambda d: d.isel(opl=[0, 1, 3]), "not consecutive"),
    "coarsened pixels": (lambda d: d.coarsen(x=2).mean(), "axis x"),
    "one column without its axis": (lambda d: d.isel(x=0), r"isel\(x=\[0\]\)"),
    "one bin without its axis": (lambda d: d.isel(opl=0), "axis opl"),
    "a sum over channels": (lambda d: d.sum("channel"), "axis channel"),
    "frames": (lambda d: d.expand_dims(frame=2), r"isel\(frame=0"),
    "the same column twice": (lambda d: d.isel(x=[1, 1]), "along the axis x"),
    "no steady image": (lambda d: d.drop_vars("steady"), "steady is missing"),
    "another variable": (lambda d: d.assign(more=1.0), "drop_vars"),
    "no centers of bins": (lambda d: d.drop_vars("opl"), "opl"),
    "one variable": (lambda d: d["transient"], "DataArray"),
    "an array": (lambda d: d["transient"].values, "ndarray"),
    "one bin without attributes": (lambda d: d.isel(opl=[0]).drop_attrs(), "bin_width_opl"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_defined_is_refused_in_one_line(name):
    change, reason = REFUSED[name]
    with pytest.raises(ValueError, match=reason) as refusal:
        read(change(film()), FILM, "dataset")
    assert "\n" not in str(refusal.value)
    assert str(refusal.value).startswith("dataset: ")


def test_pixels_with_gaps_are_refused_on_request():
    data = read(film().isel(y=[0, 2]), FILM, "dataset")
    with pytest.raises(ValueError, match="axis y"):
        require_consecutive(data, "dataset")


def test_counts_have_bins_along_another_axis():
    counts = xr.Dataset(
        {"counts": (("bin", "y", "x"), np.arange(24).reshape(4, 3, 2))},
        {"y": [2, 1, 0], "x": [0, 1], "opl": ("bin", 1.0 + 0.5 * (np.arange(4) + 0.5))},
        {"start_opl": 1.0, "bin_width_opl": 0.5},
    )
    found = read(counts.isel(bin=slice(1, None)), COUNTS, "counts")
    assert found["counts"].dims == ("y", "x", "bin")
    assert found["y"].values.tolist() == [0, 1, 2]
    assert found.attrs["start_opl"] == 1.5
    assert found["counts"].sel(y=2, x=1).values.tolist() == [7, 13, 19]
