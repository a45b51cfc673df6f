"""Units, names and time: every Dataset of the package, in memory and from files, is labeled."""

import functools
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import Wall, capture_of, rectangle

import tofrender
from tofrender import SPEED_OF_LIGHT
from tofrender.rendering import labels

SCENE = "cornell_box"


@functools.cache
def rendered(errors: bool = False) -> xr.Dataset:
    spp = 16 if errors else 4
    size, axis = (5, 4), {"bins": 12, "start_opl": 3.5, "bin_width": 1.0}
    return tofrender.render(SCENE, size=size, spp=spp, errors=errors, max_depth=3, **axis)


@functools.cache
def captured() -> xr.Dataset:
    return capture_of(rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1), Wall(4), bins=24, width=0.05)


def reconstructed() -> xr.Dataset:
    return tofrender.reconstruct(captured(), "bp", progress=False)


def from_stack(path: Path, **options) -> xr.Dataset:
    return tofrender.load_exr_stack(tofrender.save_exr_stack(rendered(), path, **options))


def small_box() -> dict:
    return tofrender.cornell_box(width=5, height=4, temporal_bins=12, bin_width_opl=1.0)


OF_PYRAMID = {"spp": 1, "size": (4, 4), "bins": 5, "window": (3, 13), "progress": False}
VOLUMES = {
    "reconstruction": lambda _: reconstructed(),
    "depth": lambda _: tofrender.depth_map(reconstructed()).to_dataset(),
    "projection": lambda _: tofrender.max_projection(reconstructed()).to_dataset(name="intensity"),
}
KINDS = VOLUMES | {
    "render": lambda _: rendered(),
    "with errors": lambda _: rendered(errors=True),
    "unwarped": lambda _: tofrender.unwarp_camera(rendered(), np.ones((4, 5))),
    "capture": lambda _: captured(),
    "rendered capture": lambda _: tofrender.capture("nlos_plane", grid=(2, 2), spp=1),
    "merged": lambda _: tofrender.merge([rendered(), rendered().assign_attrs(seed=1)]),
    "npz": lambda path: tofrender.load_npz(tofrender.save_npz(rendered(), path / "a.npz")),
    "frames": lambda path: from_stack(path / "a"),
    "one file": lambda path: from_stack(path / "a.exr", layout="multipart"),
    "zarr": lambda path: tofrender.save_zarr(rendered(), path / "a.zarr"),
    "streamed": lambda path: tofrender.render(small_box(), spp=1, out=path / "a.zarr"),
    "HDF5": lambda path: tofrender.load_capture(tofrender.save_capture(captured(), path / "a.h5")),
    "pyramid": lambda _: tofrender.strategy_pyramid(SCENE, max_depth=2, **OF_PYRAMID),
}


@pytest.mark.parametrize("kind", KINDS)
def test_everything_has_a_name_and_a_unit_and_time_is_a_coordinate(tmp_path, kind):
    dataset = KINDS[kind](tmp_path)
    for name, variable in dataset.variables.items():
        assert variable.attrs.get("long_name"), name
        assert variable.attrs.get("units"), name
    if kind in VOLUMES:
        return
    expected = dataset["opl"].values / SPEED_OF_LIGHT * 1e9
    np.testing.assert_allclose(dataset["time"], expected, rtol=1e-14)
    light = dataset["transient"]
    there = light.sel(time=expected[3] + 0.1 * (expected[1] - expected[0]), method="nearest")
    np.testing.assert_array_equal(there, light.isel(opl=3))
    half = 0.5 * (expected[1] - expected[0])
    within = light.sel(time=slice(expected[1] + half, expected[4] - half))
    np.testing.assert_array_equal(within, light.isel(opl=slice(2, 4)))
    at = light.sel(opl=dataset["opl"].values[3], method="nearest")
    np.testing.assert_array_equal(at, there)


def test_parts_of_time_join_again():
    whole = rendered()
    parts = [whole.isel(opl=slice(0, 5)), whole.isel(opl=slice(5, None))]
    along = xr.concat([part["transient"] for part in parts], "opl")
    xr.testing.assert_identical(along, whole["transient"])
    assert list(along.xindexes) == list(whole["transient"].xindexes)
    rows = [whole.isel(y=slice(0, 1)), whole.isel(y=slice(1, None))]
    xr.testing.assert_identical(xr.concat(rows, "y"), whole)
    stacked = xr.concat([whole["transient"], whole["transient"]], "seed")
    assert stacked.sel(time=20.0, method="nearest").dims == ("seed", "y", "x", "channel")


def test_arithmetic_goes_on():
    one = rendered()
    twice = one["transient"] + rendered(errors=True)["transient"]
    assert "time" in twice.xindexes
    plain = xr.DataArray(np.arange(12.0), {"opl": one["opl"].values}, "opl")
    assert (one["transient"] * plain).sizes == one["transient"].sizes
    coarse = one["transient"].coarsen(opl=2).sum()
    assert coarse.sizes["opl"] == 6
    middle = one["time"][::2] + (one["time"][1] - one["time"][0]) / 2
    np.testing.assert_allclose(coarse["time"], middle)


def test_times_of_other_lengths_are_refused(tmp_path):
    moved = rendered().assign_coords(opl=rendered()["opl"] + 1)
    for use in (
        lambda: tofrender.save_npz(moved.assign_attrs(start_opl=4.5), tmp_path / "a.npz"),
        lambda: tofrender.transient_to_phasor(moved, 2e7),
        lambda: tofrender.summary_figure(moved),
    ):
        with pytest.raises(ValueError, match=r"coordinate time.* opl / c in ns"):
            use()
    assert not list(tmp_path.iterdir())
    mended = moved.drop_vars("time").assign_attrs(start_opl=4.5)
    tofrender.save_npz(mended, tmp_path / "a.npz")
    back = tofrender.load_npz(tmp_path / "a.npz")
    np.testing.assert_allclose(back["time"], back["opl"] / SPEED_OF_LIGHT * 1e9)


def test_a_dataset_from_before_there_was_time(tmp_path):
    old = rendered().drop_vars("time")
    tofrender.save_exr_stack(old, tmp_path / "a")
    xr.testing.assert_identical(tofrender.load_exr_stack(tmp_path / "a"), rendered())
    again = tofrender.render(
        SCENE, size=(5, 4), spp=8, max_depth=3, bins=12, start_opl=3.5, bin_width=1.0, resume=old
    )
    assert "time" in again.xindexes


def test_xarray_labels_its_plots():
    with matplotlib.rc_context({"backend": "Agg"}):
        light = rendered()["transient"].sel(channel="G", drop=True)
        figure, axes = plt.subplots(1, 3)
        light.isel(x=2, y=2).plot(ax=axes[0], x="time")
        light.isel(opl=4).plot(ax=axes[1], add_colorbar=False)
        light.isel(x=2, y=2).plot(ax=axes[2])
        found = [
            (" ".join(f"{each.get_xlabel()}".split()), " ".join(f"{each.get_ylabel()}".split()))
            for each in axes
        ]
        plt.close(figure)
    assert found == [
        ("time [ns]", "radiance per bin [W m^-2 sr^-1]"),
        ("column [pixel]", "row [pixel]"),
        ("optical path length [m]", "radiance per bin [W m^-2 sr^-1]"),
    ]


def test_what_no_one_knows_has_no_label():
    assert labels.labels_of("something", {}) == {}
    name, unit = "radiance per meter", {"units": "W m^-3 sr^-1"}
    assert labels.labels_of("transient", unit | {"quantity": name}) == unit | {"long_name": name}
