"""Units, names and time: every Dataset of the package, in memory and from files, is labelled."""

from __future__ import annotations

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


def merged(folder: Path) -> xr.Dataset:
    return tofrender.merge([rendered(), rendered().assign_attrs(seed=1)])


def from_npz(folder: Path) -> xr.Dataset:
    return tofrender.load_npz(tofrender.save_npz(rendered(), folder / "a.npz"))


def from_frames(folder: Path) -> xr.Dataset:
    return tofrender.load_exr_stack(tofrender.save_exr_stack(rendered(), folder / "a"))


def from_one_file(folder: Path) -> xr.Dataset:
    made = tofrender.save_exr_stack(rendered(), folder / "a.exr", layout="multipart")
    return tofrender.load_exr_stack(made)


def from_zarr(folder: Path) -> xr.Dataset:
    return tofrender.save_zarr(rendered(), folder / "a.zarr")


def streamed(folder: Path) -> xr.Dataset:
    scene = tofrender.cornell_box(width=5, height=4, temporal_bins=12, bin_width_opl=1.0)
    return tofrender.render(scene, spp=1, out=folder / "a.zarr")


def from_hdf5(folder: Path) -> xr.Dataset:
    return tofrender.load_capture(tofrender.save_capture(captured(), folder / "a.h5"))


def pyramid(folder: Path) -> xr.Dataset:
    return tofrender.strategy_pyramid(
        SCENE, max_depth=2, spp=1, size=(4, 4), bins=5, window=(3, 13), progress=False
    )


KINDS = {
    "render": lambda folder: rendered(),
    "with errors": lambda folder: rendered(errors=True),
    "unwarped": lambda folder: tofrender.unwarp_camera(rendered(), np.ones((4, 5))),
    "capture": lambda folder: captured(),
    "rendered capture": lambda folder: tofrender.capture("nlos_plane", grid=(2, 2), spp=1),
    "reconstruction": lambda folder: tofrender.reconstruct(captured(), "bp", progress=False),
    "depth": lambda folder: tofrender.depth_map(KINDS["reconstruction"](folder)).to_dataset(),
    "projection": lambda folder: tofrender.max_projection(
        KINDS["reconstruction"](folder)
    ).to_dataset(name="intensity"),
    **{each.__name__: each for each in (merged, from_npz, from_frames, from_one_file)},
    **{each.__name__: each for each in (from_zarr, streamed, from_hdf5, pyramid)},
}


@pytest.mark.parametrize("kind", KINDS)
def test_everything_has_a_name_and_a_unit(tmp_path, kind):
    dataset = KINDS[kind](tmp_path)
    for name, variable in dataset.variables.items():
        assert variable.attrs.get("long_name"), name
        assert variable.attrs.get("units"), name


TIMED = [kind for kind in KINDS if kind not in ("reconstruction", "depth", "projection")]


@pytest.mark.parametrize("kind", TIMED)
def test_time_is_a_coordinate(tmp_path, kind):
    dataset = KINDS[kind](tmp_path)
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
    assert one["transient"].coarsen(opl=2).sum().sizes["opl"] == 6
    np.testing.assert_allclose(
        one["transient"].coarsen(opl=2).sum()["time"],
        one["time"][::2] + (one["time"][1] - one["time"][0]) / 2,
    )


def test_times_of_other_lengths_are_refused(tmp_path):
    moved = rendered().assign_coords(opl=rendered()["opl"] + 1)
    for use in (
        lambda: tofrender.save_npz(moved.assign_attrs(start_opl=4.5), tmp_path / "a.npz"),
        lambda: tofrender.transient_to_phasor(moved, 2e7),
        lambda: tofrender.summary_figure(moved),
    ):
        with pytest.raises(ValueError, match=r"coordinate time: must be opl / c in ns"):
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


def test_films_on_disk_stay_there(tmp_path):
    film = from_zarr(tmp_path)
    assert hasattr(film["transient"].data, "dask")
    part = film["transient"].sel(time=slice(15, 30))
    assert hasattr(part.data, "dask")
    at_once = xr.open_zarr(tmp_path / "a.zarr")
    assert "time" not in at_once
    assert at_once["transient"].attrs == film["transient"].attrs


def _line(text: str) -> str:
    return " ".join(text.split())


def test_xarray_labels_its_plots():
    with matplotlib.rc_context({"backend": "Agg"}):
        light = rendered()["transient"].sel(channel="G", drop=True)
        figure, axes = plt.subplots(1, 3)
        light.isel(x=2, y=2).plot(ax=axes[0], x="time")
        light.isel(opl=4).plot(ax=axes[1], add_colorbar=False)
        light.isel(x=2, y=2).plot(ax=axes[2])
        found = [tuple(map(_line, (each.get_xlabel(), each.get_ylabel()))) for each in axes]
        plt.close(figure)
    assert found == [
        ("time [ns]", "radiance per bin [W m^-2 sr^-1]"),
        ("column [pixel]", "row [pixel]"),
        ("optical path length [m]", "radiance per bin [W m^-2 sr^-1]"),
    ]


def test_what_no_one_knows_has_no_label():
    assert labels.labels_of("something", {}) == {}
    assert labels.labels_of(
        "transient", {"quantity": "radiance per metre", "units": "W m^-3 sr^-1"}
    ) == {"units": "W m^-3 sr^-1", "long_name": "radiance per metre"}
