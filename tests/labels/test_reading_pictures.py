"""Figures, explorers, comparisons and files take labeled data in any order, and keep crops."""

import json

import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import small_capture
from helpers.made_dataset import make_dataset
from helpers.support import refused

import tofrender
from tofrender import io, nlos, sensors, vis
from tofrender.apps.compare.picture_set import PictureSet, load
from tofrender.apps.explorer.data import explorer_data, facts
from tofrender.apps.explorer.page_contents import contents_of
from tofrender.cli.app import main
from tofrender.cli.report import load_result
from tofrender.io.netcdf import load_measurement, save_measurement

PHOTONS = {"photons_per_cycle": 0.5}


@pytest.fixture(autouse=True)
def _keep_attributes():
    """As newer versions of xarray do by default."""
    with xr.set_options(keep_attrs=True):
        yield


def film(x0=6, y0=2):
    """Return a cropped film of 6 x 4 pixels and 12 bins, with different light everywhere."""
    return make_dataset(4, 6, 12, x0=x0, y0=y0, film_width=15, film_height=9)


def polarized():
    """Return such a film of Stokes vectors."""
    scale = xr.DataArray([1, 0.5, -0.25, 0.125], {"stokes": ["S0", "S1", "S2", "S3"]}, "stokes")
    made = film()
    light = (made["transient"] * scale).astype(np.float32)
    steady = (made["steady"] * scale).astype(np.float32)
    made["transient"] = light.transpose("y", "x", "opl", "stokes", "channel")
    made["steady"] = steady.transpose("y", "x", "stokes", "channel")
    return made


def turned(data):
    """Return the same data in another order of axes and labels."""
    kept = ("xyz", "frame", "laser_x", "laser_y", "frequency", "tap", "delay_opl")
    reverse = {axis: slice(None, None, -1) for axis in data.dims if axis not in kept}
    return data.isel(reverse).transpose(*reversed(list(data.dims)))


def drawn(figure):
    """Return all numbers and titles of a figure."""
    found = [figure.get_suptitle()]
    for axes in figure.axes:
        found += [axes.get_title(), *(each.get_text() for each in axes.texts)]
        found += [np.asarray(image.get_array()) for image in axes.images]
        found += [image.get_extent() for image in axes.images]
        found += [np.asarray(line.get_data()) for line in axes.lines]
    return found


def assert_same(one, other):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def animated(data):
    """Return the first picture of an animation."""
    animation = vis.visualize_transient(data)
    animation._draw_was_started = True  # It would warn that nothing has played it
    return animation._fig


FIGURES = {
    "summary": vis.summary_figure,
    "arrival": vis.light_in_flight,
    "peak": lambda d: vis.light_in_flight(d, style="peak"),
    "pixel": lambda d: vis.plot_pixel_transient(d, 8, 3),
    "animation": animated,
}


@pytest.mark.parametrize("name", FIGURES)
def test_figures_take_films_in_any_order(name):
    data = film()
    right = drawn(FIGURES[name](data))
    assert_same(drawn(FIGURES[name](turned(data))), right)
    assert_same(drawn(FIGURES[name](turned(polarized()).isel(stokes=[1, 3]))), right)
    part = data.isel(opl=slice(5, None), x=slice(1, 5), y=slice(1, 3))
    assert_same(drawn(FIGURES[name](turned(part))), drawn(FIGURES[name](part)))
    refused("rebin", FIGURES[name], data.coarsen(opl=2).sum())
    refused("the axis x skips pixels", FIGURES[name], data.isel(x=[0, 1, 3]))
    refused("additional axis frame", FIGURES[name], data.expand_dims(frame=2))


def test_labeled_arrays_of_light_are_shown_in_order():
    light = film()["transient"]
    axis = {"start_opl": 3.5, "bin_width_opl": 0.02}
    right = drawn(vis.light_in_flight(light.values, **axis))
    assert_same(drawn(vis.light_in_flight(turned(light), **axis)), right)


def test_light_in_flight_without_a_steady_image():
    data = film()
    right = drawn(vis.light_in_flight(data["transient"].values, 3.5, 0.02))
    found = drawn(vis.light_in_flight(data.drop_vars("steady")))
    for a, b in zip(found, right, strict=True):
        if not isinstance(a, tuple):  # The extent is that of the crop
            np.testing.assert_allclose(a, b) if isinstance(a, np.ndarray) else None


def test_the_energy_that_a_part_lacks_is_in_the_title():
    data = film()
    part = data.isel(opl=slice(5, 8))
    lost = 1 - float(part["transient"].sum()) / float(data["steady"].sum())
    assert lost > 0.5
    title = vis.summary_figure(part).get_suptitle()
    assert f"{100 * lost:.1f} % of the energy outside" in title
    facts = dict(contents_of(part).header["facts"])
    assert float(facts["Light outside of the bins [fraction]"]) == pytest.approx(lost, rel=1e-3)


def test_pictures_of_a_part(tmp_path):
    part = film().isel(opl=slice(5, 9))
    for name, data in (("a", part), ("b", turned(part))):
        io.save_png_frames(data, tmp_path / name, progress=False)
        io.save_video(data, tmp_path / f"{name}.gif", progress=False)
    assert len(list((tmp_path / "a").iterdir())) == 4
    for one in (tmp_path / "a").iterdir():
        assert one.read_bytes() == (tmp_path / "b" / one.name).read_bytes()
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_maps_of_velocities_are_where_their_pixels_are():
    rate = film()["steady"].isel(channel=0, drop=True).rename("rate") - 0.05
    figure = vis.velocity_map(rate)
    assert [*figure.axes[0].images[0].get_extent()] == [5.5, 11.5, 5.5, 1.5]
    right = drawn(figure)
    assert_same(drawn(vis.velocity_map(turned(rate))), right)
    refused("skips pixels", vis.velocity_map, rate.isel(x=[0, 1, 3]))
    refused("axis y", vis.velocity_map, rate.isel(y=0))


def test_stokes_components_are_found_by_their_names():
    light = polarized()["steady"]
    mixed = light.isel(stokes=[3, 1, 0, 2])
    for degree in (tofrender.degree_of_polarization, tofrender.angle_of_linear_polarization):
        xr.testing.assert_identical(degree(mixed), degree(light))
    other = turned(mixed)
    np.testing.assert_array_equal(vis.polarization_picture(other), vis.polarization_picture(light))
    assert_same(drawn(vis.polarization_figure(other)), drawn(vis.polarization_figure(light)))
    four = light.isel(stokes=[0, 1, 2, 2])
    for call in (tofrender.degree_of_polarization, vis.polarization_picture):
        refused("stokes", call, four)


def pyramid():
    """Return a result of `strategy_pyramid` with different light everywhere."""
    rng = np.random.default_rng(5)
    light = rng.random((2, 2, 3, 4, 6, 3)).astype(np.float32)
    dims = ("weighting", "strategy", "y", "x", "opl", "channel")
    steady = (tuple(axis for axis in dims if axis != "opl"), light.sum(axis=4))
    axes = {"weighting": ["mis", "none"], "strategy": ["0,2", "1,1"], "channel": ["R", "G", "B"]}
    axes |= {"s": ("strategy", [0, 1]), "t": ("strategy", [2, 1]), "opl": 3.05 + 0.1 * np.arange(6)}
    axes |= {"y": np.arange(3), "x": np.arange(4)}
    attrs = {"start_opl": 3.0, "bin_width_opl": 0.1, "units": "W m^-2 sr^-1", "scene": "s"}
    return xr.Dataset({"transient": (dims, light), "steady": steady}, axes, attrs)


def test_pyramids_in_any_order():
    data = pyramid()
    mixed = data.isel(y=slice(None, None, -1), opl=slice(None, None, -1), channel=[2, 0, 1])
    mixed = mixed.transpose(*reversed(list(mixed.dims)))
    for options in ({}, {"opl": 3.44}, {"weighting": "none", "opl": 3.12}):
        right = drawn(vis.pyramid_figure(data, **options))
        assert_same(drawn(vis.pyramid_figure(mixed, **options)), right)
    late = data.isel(opl=slice(3, None))
    refused("from|bins, 3.3 m to 3.6 m", vis.pyramid_figure, late, opl=3.12)
    refused("do not skip bins", vis.pyramid_figure, data.isel(opl=slice(None, None, 2)), opl=3.4)


SENSORS = {
    "counts": {"spad": {}},
    "larger pixels": {"spad": {"macro_pixel": (2, 3)}},
    "taps": {"itof": {"frequencies_hz": [20e6, 50e6]}},
    "gates": {"gated": {"delays_opl": [3.5, 3.6, 3.7], "width_s": 1e-9}},
    "streak": {"streak": {"sweep_opl": 0.04}},
}


def measured(name):
    """Return what a sensor measures of a film that is cropped at the pixel (6, 2)."""
    return sensors.sense(film(), {"cycles": 300, "photons": PHOTONS} | SENSORS[name], seed=2)


@pytest.mark.parametrize("name", SENSORS)
def test_measurements_are_shown_where_their_pixels_are(name):
    data = measured(name)
    figure = vis.measurement_figure(data)
    assert [*figure.axes[0].images[0].get_extent()] == [5.5, 11.5, 5.5, 1.5]
    x, y = json.loads(
        figure.axes[-1 if name == "taps" else 4]
        .get_legend()
        .get_title()
        .get_text()
        .removeprefix("pixel ")
        .replace("(", "[")
        .replace(")", "]")
    )
    assert x in data["x"]
    assert y in data["y"]
    assert_same(drawn(vis.measurement_figure(turned(data))), drawn(figure))


@pytest.mark.parametrize("name", SENSORS)
def test_explorers_of_measurements_keep_the_crop(name):
    data = measured(name)
    header = contents_of(data).header
    assert header["grid"]["first"] == ((2, 1) if name == "larger pixels" else (6, 2))
    other = contents_of(turned(data))
    assert other.header == header
    assert other.data == contents_of(data).data


def frames():
    """Return two frames of a cropped film."""
    parts = [film() * k for k in (1, 2)]
    return xr.concat(parts, xr.DataArray([0.0, 0.5], dims="frame", name="frame"))


EXPLORED = {
    "film": film,
    "Stokes vectors": polarized,
    "frames": frames,
    "pyramid": lambda: pyramid().isel(weighting=slice(None)),
    "capture": lambda: small_capture().isel(x=slice(3), y=slice(2), opl=slice(8)),
}


@pytest.mark.parametrize("name", EXPLORED)
def test_explorers_take_data_in_any_order(name):
    data = EXPLORED[name]()
    right = contents_of(data)
    kept = ("xyz", "frame", "weighting", "strategy", "laser_x", "laser_y")
    mixed = data.isel({axis: slice(None, None, -1) for axis in data.dims if axis not in kept})
    mixed = mixed.transpose(*reversed(list(mixed.dims)))
    found = contents_of(mixed)
    assert found.header == right.header
    assert found.data == right.data


def test_explorers_state_the_energy_outside_the_chosen_bins():
    outside = "Light outside of the bins [fraction]"
    for data in (film(), frames()):
        data = data.assign_attrs(energy_outside_window=0.0)
        part = data.isel(opl=slice(4, 8))
        light = part["transient"].sum(("y", "x", "opl", "channel"))
        wanted = float((1 - light / data["steady"].sum(("y", "x", "channel"))).max())
        shown = dict(facts(part, explorer_data(part)))[outside]
        assert float(shown) == pytest.approx(wanted, rel=1e-3)
        assert float(dict(facts(data, explorer_data(data)))[outside]) == pytest.approx(0, abs=1e-3)


def test_explorers_of_volumes_need_even_voxels():
    axes = {"z": 0.5 + 0.1 * np.arange(5), "y": 0.2 * np.arange(6), "x": 0.3 * np.arange(4)}
    light = np.random.default_rng(4).random((5, 6, 4), dtype=np.float32)
    volume = xr.Dataset({"intensity": (tuple(axes), light)}, axes)
    assert explorer_data(volume).header["geometry"]["x"] == pytest.approx((-0.15, 0.3))
    for axis in axes:
        refused(f"coordinate {axis}", explorer_data, volume.isel({axis: [0, 1, 3]}))


def test_stokes_layers_have_their_names():
    found = contents_of(polarized().isel(stokes=[3, 0])).header
    assert [each["name"] for each in found["stokes"]] == ["S3"]
    refused("S0", contents_of, polarized().isel(stokes=[1, 2]))


def test_orders_have_the_pixels_of_the_data():
    data = film()
    order = data.assign(transient=0.5 * data["transient"])
    right = contents_of(data, orders={"first": order})
    assert contents_of(data, orders={"first": turned(order)}).data == right.data
    other = order.assign_coords(x=order["x"] + 1)
    refused("the axis x has the labels", contents_of, data, orders={"first": other})
    late = order.isel(opl=slice(None, None, -1)).isel(opl=slice(0, 6))
    refused("the axis opl has the labels", contents_of, data, orders={"first": late})


def test_crops_of_equal_size_are_not_compared(tmp_path):
    one, same, other = (
        load(io.save_npz(each, tmp_path / f"{name}.npz"), load_result)
        for name, each in (("one", film()), ("same", film()), ("other", film(x0=3)))
    )
    assert PictureSet(one, same).clock is not None
    refused("other.npz begins at the pixel .3, 2., and one.npz at .6, 2.", PictureSet, one, other)


def test_pictures_of_gates_and_phasors_keep_the_crop(tmp_path):
    io.save_exr_stack(film(), tmp_path / "render", progress=False)
    folder = tmp_path / "phasors"
    assert main(["phasor", str(tmp_path / "render"), "--freq", "2e7", "--out", str(folder)]) == 0
    found = load_result(folder)
    assert found["x"].values.tolist() == [*range(6, 12)]
    assert found["y"].values.tolist() == [*range(2, 6)]
    assert contents_of(found).header["grid"]["first"] == (6, 2)

    folder = tmp_path / "gate"
    folder.mkdir()
    attrs = {"opl": 4.2, "pulse_width_opl": 0.05, "units": "W m^-3 sr^-1", "spp": 8}
    image = film()["steady"].values
    io.save_exr_layers(folder / "gate.exr", {"": image}, attrs, first_pixel=(6, 2))
    found = load_result(folder)
    assert (int(found["x"][0]), int(found["y"][0])) == (6, 2)
    np.testing.assert_array_equal(found["transient"][:, :, 0], image)
    assert contents_of(found).header["grid"]["first"] == (6, 2)


def test_times_and_lengths_have_their_own_units():
    data = film()
    assert tofrender.opl_to_ns(data["opl"]).attrs["units"] == "ns"
    assert tofrender.ns_to_opl(data["time"]).attrs["units"] == "m"
    assert data["opl"].attrs["units"] == "m"


SAVERS = {
    "npz": (io.save_npz, io.load_npz, ".npz"),
    "exr": (io.save_exr_stack, io.load_exr_stack, ""),
    "zarr": (tofrender.save_zarr, tofrender.load_zarr, ".zarr"),
}
PARTS = {
    "one bin": {"opl": [7]},
    "one pixel": {"x": [4], "y": [1]},
    "a crop in time": {"opl": slice(3, 9), "x": slice(1, 4)},
}


@pytest.mark.parametrize("kind", SAVERS)
def test_parts_and_any_order_can_be_saved(tmp_path, kind):
    save, load_file, suffix = SAVERS[kind]
    for name, part in PARTS.items():
        data = film().isel(part)
        path = tmp_path / f"{name}{suffix}"
        save(turned(data), path)
        found = load_file(path).load()
        xr.testing.assert_equal(found, data)
        assert found.attrs["start_opl"] == pytest.approx(float(data["opl"][0]) - 0.01)
        lost = 1 - float(data["transient"].sum()) / float(data["steady"].sum())
        assert found.attrs["energy_outside_window"] == pytest.approx(lost, abs=1e-3)
    coarse = tofrender.rebin(film(y0=4), pixels=(1, 1))
    path = tmp_path / f"coarse{suffix}"
    save(coarse, path)
    found = load_file(path).load()
    xr.testing.assert_equal(found, coarse)


@pytest.mark.parametrize("kind", SAVERS)
def test_stokes_vectors_in_any_order_can_be_saved(tmp_path, kind):
    save, load_file, suffix = SAVERS[kind]
    data = polarized()
    first = data.transpose("stokes", "channel", ...)
    for name, each in (("first", first), ("turned", turned(data))):
        path = tmp_path / f"{name}{suffix}"
        save(each, path)
        found = load_file(path).load()
        xr.testing.assert_equal(found, data)
    refused("pass all of S0, S1, S2 and S3|Pass all", save, data.isel(stokes=[0, 1]), "no" + suffix)


def test_a_single_color_as_exr(tmp_path):
    green = film().isel(channel=[1])
    found = io.load_exr_stack(io.save_exr_stack(green, tmp_path / "green"))
    xr.testing.assert_equal(found, green)
    refused(
        "EXR files have one channel, or R, G and B",
        io.save_exr_stack,
        film().isel(channel=[0, 2]),
        tmp_path / "two",
    )


def test_captures_and_their_counts_as_netcdf(tmp_path):
    """SciPy's writer replaces its own attribute `mode` by an attribute of a Dataset."""
    capture = small_capture()
    counts = sensors.sense(capture, {"cycles": 50, "photons": PHOTONS, "spad": {}})
    for number, data in enumerate((capture, counts)):
        path = tmp_path / f"{number}.nc"
        data.to_netcdf(path, engine="scipy")
        xr.testing.assert_equal(xr.load_dataset(path), data)
    save_measurement(counts, tmp_path / "a.nc")
    loaded = nlos.reconstruct(load_measurement(tmp_path / "a.nc"), "bp", progress=False)
    xr.testing.assert_equal(loaded, nlos.reconstruct(counts, "bp", progress=False))
    bad = counts.assign_attrs(mode="confocal")
    refused("attribute mode .* Rename", save_measurement, bad, tmp_path / "b.nc")
    assert not (tmp_path / "b.nc").exists()


def test_fields_of_view_are_real_numbers(tmp_path, capsys):
    out = ["--out", str(tmp_path / "a.ply"), "--shots", "2x2", "--pattern", "no.csv"]
    assert main(["lidar", "cornell_box", "--fov", "40x22.5", *out]) != 0
    assert "--pattern = no.csv" in capsys.readouterr().err  # The field of view is accepted
    assert main(["lidar", "cornell_box", "--fov", "40x181", *out]) == 2
    assert "--fov = '40x181': must be width x height in degrees" in capsys.readouterr().err


def test_a_dark_border_has_no_depth_and_does_not_widen_the_range():
    data = measured("counts").copy(deep=True)
    data["counts"][...] *= 1000
    border = data["counts"].isel(x=0)
    border[...] = 0
    border[{"bin": -1}] = 1  # One count of background light, late
    figure = vis.measurement_figure(data)
    image = figure.axes[2].images[0]
    shown = np.ma.filled(image.get_array().astype(float), np.nan)
    assert np.isnan(shown[:, 0]).all()
    assert image.get_clim()[1] < float(data["opl"][-1])
    assert "bright pixel" in figure.legends[0].get_texts()[0].get_text()
    assert all(figure.axes[k].get_ylabel() for k in range(5))  # Also the color bars
