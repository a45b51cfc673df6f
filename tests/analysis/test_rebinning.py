"""Datasets with other bins, also after xarray has coarsened, cut or summed them."""

import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import small_capture
from helpers.made_dataset import START, WIDTH, make_dataset
from helpers.refusals import refused

from tofrender import io, load_zarr, rebin, save_zarr
from tofrender.nlos.captures import check_capture


@pytest.fixture(autouse=True)
def _keep_attributes():
    """Keep attributes, as newer versions of xarray do by default."""
    with xr.set_options(keep_attrs=True):
        yield


def made(energy_outside_window=0.0, **options):
    """Return a film with equal amounts of light inside and outside the window."""
    dataset = make_dataset(
        height=4, width=6, bins=12, energy_outside_window=energy_outside_window, **options
    )
    scale = 1 - energy_outside_window
    if dataset.attrs["quantity"] == "radiance per meter":
        scale /= WIDTH
    dataset["steady"] /= np.float32(scale)
    return dataset


def test_bins_add_up():
    dataset = made(energy_outside_window=0.25)
    coarse = rebin(dataset, 4)
    by_three = dataset["transient"].values.astype(float).reshape(4, 6, 4, 3, 3).sum(3)
    np.testing.assert_allclose(coarse["transient"], by_three, rtol=1e-6)
    np.testing.assert_allclose(coarse["opl"], START + WIDTH * np.array([1.5, 4.5, 7.5, 10.5]))
    assert coarse.attrs["bin_width_opl"] == pytest.approx(3 * WIDTH)
    assert coarse.attrs["energy_outside_window"] == pytest.approx(0.25)
    assert coarse["transient"].dtype == np.float32
    np.testing.assert_array_equal(rebin(dataset, 12)["transient"], dataset["transient"])


def test_cut_bins_are_shared():
    dataset = made(energy_outside_window=0.25)
    values = dataset["transient"].values.astype(float)
    cut = rebin(dataset, 2, (START + 1.5 * WIDTH, START + 6.5 * WIDTH))
    first = values[:, :, 1] / 2 + values[:, :, 2:4].sum(2)
    np.testing.assert_allclose(cut["transient"][:, :, 0], first, rtol=1e-5)
    kept = float(cut["transient"].sum()) / values.sum()
    assert cut.attrs["energy_outside_window"] == pytest.approx(1 - 0.75 * kept, rel=1e-5)


def test_densities_are_averaged():
    dataset = made(quantity="radiance per meter", units="W m^-3 sr^-1", energy_outside_window=0.5)
    coarse = rebin(dataset, 6)
    means = dataset["transient"].values.reshape(4, 6, 6, 2, 3).mean(3)
    np.testing.assert_allclose(coarse["transient"], means, rtol=1e-6)
    assert coarse.attrs["energy_outside_window"] == pytest.approx(0.5, rel=1e-6)


def test_errors_are_left_out_and_captures_keep_their_walls():
    dataset = made()
    errors = {f"{name}_error": dataset[name] for name in ("transient", "steady")}
    assert set(rebin(dataset.assign(errors), 6)) == {"transient", "steady"}
    capture = small_capture()
    coarse = rebin(capture, capture.sizes["opl"] // 2)
    check_capture(coarse)
    assert set(coarse) == set(capture)


def test_films_on_disk_stay_there(tmp_path):
    lazy = rebin(save_zarr(made(), tmp_path / "a.zarr"), 3, (START, START + 9 * WIDTH))
    assert hasattr(lazy["transient"].data, "dask")
    again = rebin(made(), 3, (START, START + 9 * WIDTH))
    np.testing.assert_array_equal(lazy["transient"].values, again["transient"].values)


def test_what_rebin_refuses():
    dataset = made()
    with refused("bins = 13: must be at most 12 in this window, whose bins are 0.02 m wide"):
        rebin(dataset, 13)
    with refused(r"window = \(3.0, 3.6\): must be within the bins, from 3.5 to 3.74 m"):
        rebin(dataset, 1, (3.0, 3.6))
    with refused("bins = 9: must be at most 2"):
        rebin(dataset, 9, (3.5, 3.54))


REDUCED = {
    "bins": lambda d: rebin(d, 3),
    "part of bins": lambda d: rebin(d.isel(opl=slice(3, 9)), 3),
    "one bin": lambda d: d.isel(opl=[5]),
    "time": lambda d: d.isel(opl=slice(2, 7)),
    "pixels": lambda d: rebin(d, pixels=(2, 2)),
    "one pixel": lambda d: rebin(d, pixels=(1, 1)),
    "channels with their axis": lambda d: d.sum("channel", keepdims=True),
    "one channel": lambda d: d.isel(channel=[1]),
    "all": lambda d: rebin(d, 4, pixels=(6, 2)).mean("channel", keepdims=True),
}


@pytest.mark.parametrize("layout", ["npz", "exr", "zarr"])
@pytest.mark.parametrize("how", REDUCED)
def test_reduced_datasets_are_saved(tmp_path, layout, how):
    dataset = REDUCED[how](made(film_width=6, film_height=4))
    path = tmp_path / f"a.{layout}"
    if layout == "npz":
        loaded = io.load_npz(io.save_npz(dataset, path))
    elif layout == "exr":
        loaded = io.load_exr_stack(io.save_exr_stack(dataset, path, layout="multipart"))
    else:
        save_zarr(dataset, path)
        loaded = load_zarr(path)
    for name in ("transient", "steady"):
        np.testing.assert_array_equal(loaded[name].values, dataset[name].values)
    if "channel" in dataset.coords:
        assert loaded["channel"].values.tolist() == dataset["channel"].values.tolist()
    np.testing.assert_array_equal(loaded["opl"], dataset["opl"])
    width = 4 * WIDTH if how == "bins" else WIDTH
    if loaded.sizes["opl"] > 1:
        width = float(np.diff(loaded["opl"]).mean())
    assert loaded.attrs["bin_width_opl"] == pytest.approx(width)
    assert loaded.attrs["start_opl"] == pytest.approx(float(loaded["opl"][0]) - width / 2)
    assert loaded["y"].values.tolist() == list(range(loaded.sizes["y"]))
    assert loaded.attrs["film_height"] == loaded.sizes["y"]
    if "bin" in how or how == "time":
        light, steady = (float(dataset[name].sum()) for name in ("transient", "steady"))
        assert loaded.attrs["energy_outside_window"] == pytest.approx(1 - light / steady, abs=1e-6)


def test_what_is_not_saved(tmp_path):
    dataset = made()
    for coarse in (dataset.coarsen(opl=3).mean(), dataset.coarsen(opl=3).sum()):
        with refused("0.06 m apart, but 0.02 m wide.* tofrender.rebin"):
            io.save_npz(coarse, tmp_path / "a.npz")
    for coarse in (dataset.coarsen(x=2, y=2).mean(), dataset.coarsen(x=2, y=2).sum()):
        with refused("labels along the axis [xy] must be integers.*tofrender.rebin"):
            io.save_npz(coarse, tmp_path / "a.npz")
    with refused("the bins are .* apart"):
        io.save_npz(dataset.isel(x=[1], y=[0], opl=slice(None, None, 2)), tmp_path / "a.npz")
    errors = dataset.assign({f"{name}_error": dataset[name] for name in ("transient", "steady")})
    cut = io.save_npz(errors.isel(opl=slice(2, 7)), tmp_path / "b.npz")
    assert "transient_error" in io.load_npz(cut)
    cut.unlink()
    with refused("R, B. EXR files have one channel"):
        io.save_exr_stack(dataset.isel(channel=[2, 0]), tmp_path / "a.exr", layout="multipart")
    assert not list(tmp_path.iterdir())
