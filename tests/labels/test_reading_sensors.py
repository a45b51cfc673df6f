"""Sensors take labeled data in any order of axes, and refuse what is not defined."""

import numpy as np
import pytest
import xarray as xr
from helpers.support import refused

import tofrender
from tofrender import GaussianPulse
from tofrender.sensors import (
    GatedCamera,
    Itof,
    Spad,
    StreakCamera,
    coates,
    echoes,
    estimate_depth,
    expected_photons,
)

START, WIDTH = 3.37, 0.173
PULSE = GaussianPulse(0.2)
CAMERA = Itof(frequencies_hz=(20e6, 50e6), contrast=0.7)


@pytest.fixture(autouse=True)
def _keep_attributes():
    """As newer versions of xarray do by default."""
    with xr.set_options(keep_attrs=True):
        yield


def film():
    """Return a film of 5 x 4 pixels and 40 bins, cropped, with different light everywhere."""
    rng = np.random.default_rng(4)
    light = rng.random((4, 5, 40, 3), dtype=np.float32)
    axes = {
        "y": np.arange(3, 7),
        "x": np.arange(2, 7),
        "opl": START + WIDTH * (np.arange(40) + 0.5),
        "channel": ["R", "G", "B"],
    }
    attrs = {
        "start_opl": START,
        "bin_width_opl": WIDTH,
        "quantity": "radiance per bin",
        "energy_outside_window": 0.0,
        "film_width": 9,
        "film_height": 8,
    }
    dims = ("y", "x", "opl", "channel")
    arrays = {"transient": (dims, light), "steady": (("y", "x", "channel"), light.sum(axis=2))}
    return xr.Dataset(arrays, axes, attrs)


def rates(background=4.0):
    """Return rates with a return in a bin of each pixel, and a background."""
    scene = film()
    scene["transient"] *= 0.01
    scene["transient"][{"opl": 30}] += np.linspace(5, 9, 20, dtype=np.float32).reshape(4, 5, 1)
    return expected_photons(scene, photons_per_cycle=1.0, background_per_cycle=background)


def turned(data):
    """Return the same data in another order of axes and labels."""
    mixed = data.isel(x=[3, 0, 4, 1, 2], y=slice(None, None, -1))
    bins = next((axis for axis in ("bin", "opl") if axis in data.dims), None)
    if bins is not None:
        mixed = mixed.isel({bins: slice(None, None, -1)})
    return mixed.transpose(*reversed(list(mixed.dims)))


DEVICES = {
    "spad": lambda d: Spad(mode="multi_hit", dead_time_s=2e-9).histogram(d, 50, 3),
    "mean counts": lambda d: Spad().expected(d, 50),
    "photons": lambda d: Spad().photons(d, 50, 3),
    "itof": lambda d: CAMERA.frames(d, 50, 3),
    "gates": lambda d: GatedCamera(delays_opl=[4.0], width_s=9e-9).frames(d, 50, 3),
    "streak": lambda d: StreakCamera(sweep_opl=0.4, spread_slit=1.0).frames(d, 50, 3),
}


@pytest.mark.parametrize("name", DEVICES)
def test_devices_take_rates_in_any_order(name):
    given = rates()
    xr.testing.assert_identical(DEVICES[name](turned(given)), DEVICES[name](given))
    part = given.isel(bin=slice(12, 36))
    xr.testing.assert_identical(DEVICES[name](turned(part)), DEVICES[name](part))


def test_parts_of_rates_start_where_they_are():
    camera = Itof(frequencies_hz=20e6, contrast=0.7)
    whole = camera.depth(camera.expected(rates(), 10))["depth"]
    part = camera.depth(camera.expected(rates().isel(bin=slice(12, None)), 10))["depth"]
    np.testing.assert_allclose(whole, part, atol=0.05)


def test_rates_in_wider_bins_are_refused():
    coarse = rates().coarsen(bin=2).sum()
    for call in DEVICES.values():
        refused("rates: the bins are .* use tofrender.rebin instead", call, coarse)
        refused("bin_width_opl", call, coarse.drop_attrs())


def test_sums_of_counts_do_not_overflow():
    bright = rates()
    bright["rate"][{"bin": 0}] += 5.0
    one = Spad().histogram(bright, 60_000, 1)
    both = one + Spad().histogram(bright, 60_000, 2)
    assert both["counts"].max() > 65_535
    assert both["counts"].sum("bin").min() > 119_900
    assert both["cycles"].item() == 120_000


def test_sums_of_exposures_stay_saturated():
    camera = Itof(frequencies_hz=(20e6, 50e6), contrast=0.7, full_well=40_000.0)
    dim = camera.frames(rates(), 10, 1)
    lit = dim.copy(deep=True)
    lit["saturated"][2, 3] = True
    exposures = xr.concat([dim, lit], "exposure", data_vars="all").sum("exposure")
    assert exposures["saturated"].dtype.kind == "i"
    depth = camera.depth(exposures)["depth"]
    assert np.isnan(depth).sum() == 1
    assert np.isnan(depth.sel(y=5, x=5))


def test_frames_are_found_by_their_labels():
    frames = CAMERA.frames(rates(), 50, 3)
    mixed = turned(frames).isel(tap=[2, 0, 3, 1], frequency=[1, 0])
    xr.testing.assert_identical(CAMERA.depth(mixed), CAMERA.depth(frames))
    square = frames.isel(x=slice(4))  # A square picture, whose axes could be confused
    found = CAMERA.depth(square.transpose("frequency", "tap", "x", "y"))
    xr.testing.assert_identical(found, CAMERA.depth(square))
    refused("frames: .* this camera's frequencies", CAMERA.depth, frames.isel(tap=[0, 1, 2]))
    refused("isel", CAMERA.depth, frames.isel(frequency=0))


@pytest.mark.parametrize("estimate", [estimate_depth, echoes])
def test_counts_are_read_by_their_labels(estimate):
    counts = Spad().histogram(rates(0.2), 3000, 1)
    found = estimate(counts, PULSE)
    for same in (turned(counts), counts["counts"], turned(counts)["counts"]):
        again = estimate(same, PULSE)
        for name in found.variables:
            np.testing.assert_allclose(again[name], found[name], rtol=1e-9)
    refused("rebin", estimate, counts.coarsen(bin=2).sum(), PULSE)
    refused("consecutive", estimate, counts["counts"].isel(bin=[0, 1, 3]), PULSE)


def test_counts_of_a_record_have_the_bins_of_their_sensor():
    """The attributes of a record are those of its film."""
    counts = Spad().histogram(rates(0.2), 3000, 1)
    right = estimate_depth(counts, PULSE)["depth"].values
    values = counts["counts"]
    places = {"sensor_y": values["y"].values, "sensor_x": values["x"].values}
    places["sensor_bin"] = values["opl"].values
    record = xr.DataArray(values.values, places, ("sensor_y", "sensor_x", "sensor_bin"))
    record = xr.Dataset({"counts": record}, attrs={"start_opl": 3.0, "bin_width_opl": WIDTH / 3})
    np.testing.assert_allclose(estimate_depth(record, PULSE)["depth"], right)
    renamed = record.rename(counts="sensor_counts").transpose("sensor_bin", ...)
    np.testing.assert_allclose(estimate_depth(renamed, PULSE)["depth"], right)


def test_a_background_is_found_by_its_labels():
    counts = Spad().histogram(rates(0.2), 3000, 1)
    level = rates(0.2)["background"] * 3000 * np.linspace(0.5, 2, 20).reshape(4, 5)
    found = echoes(counts, PULSE, background=level)
    xr.testing.assert_identical(echoes(counts, PULSE, background=turned(level)), found)
    refused("background: the axis x", echoes, counts, PULSE, background=level.isel(x=slice(4)))
    mixed = counts.isel(y=[2, 0, 3, 1]).transpose("bin", "x", "y")
    rows = level.isel(y=[2, 0, 3, 1]).values
    xr.testing.assert_identical(echoes(mixed, PULSE, background=rows), found)


def test_coates_goes_along_rising_path_lengths():
    counts = Spad().histogram(rates(0.2), 3000, 1)["counts"]
    right = coates(counts, 3000)
    back = coates(counts.isel(bin=slice(None, None, -1)), 3000)
    xr.testing.assert_identical(back.isel(bin=slice(None, None, -1)), right)
    refused("consecutive", coates, counts.isel(bin=[0, 1, 3]), 3000)


def test_films_without_the_cameras_segment_are_refused():
    unwarped = tofrender.unwarp_camera(film(), np.full((4, 5), 1.7))
    refused("before unwarp_camera", expected_photons, unwarped, photons_per_cycle=1.0)


def test_rates_have_their_own_labels():
    found = expected_photons(film().assign(transient=film()["transient"]), photons_per_cycle=1.0)
    for name in ("rate", "background"):
        assert found[name].attrs["units"] == "1"
        assert "photons" in found[name].attrs["long_name"]
    screen = StreakCamera(sweep_opl=0.4).expected(rates())
    assert screen.attrs["bin_width_opl"] == 0.4


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.isel(opl=slice(None, None, 2)), "rebin"),
        (lambda d: d.coarsen(x=2, boundary="trim").mean(), "axis x"),
        (lambda d: d.isel(x=0), "axis x"),
        (lambda d: d.isel(x=slice(0, 0)), "axis x is empty"),
        (lambda d: d.expand_dims(frame=2), "axis frame"),
        (lambda d: d["transient"], "pass the whole Dataset"),
    ],
)
def test_films_that_photons_are_not_defined_for(change, said):
    refused(said, expected_photons, change(film()), photons_per_cycle=1.0)


def test_photons_of_films_in_any_order():
    optics = {"lamp_power_w": 2.0, "pulse_energy_j": 1e-9, "wavelength_m": 850e-9, "f_number": 1.4}
    optics |= {"pixel_pitch_m": 10e-6, "focal_length_m": 5e-5}
    right = expected_photons(film(), **optics)
    xr.testing.assert_identical(expected_photons(turned(film()), **optics), right)
    stokes = film().expand_dims(stokes=["S0", "S1", "S2", "S3"]).copy(deep=True)
    stokes["transient"].loc[{"stokes": ["S1", "S2", "S3"]}] = -7.0
    mixed = stokes.isel(stokes=[2, 0]).transpose("channel", ...)
    np.testing.assert_allclose(expected_photons(mixed, **optics)["rate"], right["rate"])


def test_phasors_have_their_frequencies_first():
    frames = CAMERA.frames(rates(), 50, 3)
    found = CAMERA.depth(frames)
    real = found["amplitude"] * np.cos(found["phase"])
    imaginary = found["amplitude"] * np.sin(found["phase"])
    right = tofrender.phasor_parts(real, imaginary, CAMERA.frequencies_hz)
    last = (each.transpose("y", "x", "frequency") for each in (real, imaginary))
    for one, other in zip(tofrender.phasor_parts(*last, CAMERA.frequencies_hz), right, strict=True):
        np.testing.assert_array_equal(one, other)
    records = [each.rename(frequency="record") for each in (real, imaginary)]
    refused("frequency", tofrender.phasor_parts, *records, CAMERA.frequencies_hz)


def test_both_parts_of_a_phasor_have_the_same_axes():
    frames = CAMERA.frames(rates(), 50, 3)
    found = CAMERA.depth(frames.isel(x=slice(4))).isel(frequency=0, drop=True)
    real = found["amplitude"] * np.cos(found["phase"])
    imaginary = found["amplitude"] * np.sin(found["phase"])
    right = tofrender.phasor_parts(real, imaginary, 20e6)
    mixed = tofrender.phasor_parts(real, imaginary.transpose("x", "y"), 20e6)
    np.testing.assert_array_equal(mixed, right)
    other = imaginary.isel(x=[1, 0, 2, 3])
    refused("labels along the axis x", tofrender.phasor_parts, real, other, 20e6)
    refused("Q has", tofrender.phasor_parts, real, imaginary.rename(x="row"), 20e6)


def test_the_optical_axis_must_be_known():
    """The middle of a crop is not the middle of the film."""
    optics = {"lamp_power_w": 2.0, "pulse_energy_j": 1e-9, "wavelength_m": 850e-9, "f_number": 1.4}
    optics |= {"pixel_pitch_m": 1e-4, "focal_length_m": 2e-3}
    unknown = film()
    del unknown.attrs["film_width"]
    refused("attribute film_width is missing", expected_photons, unknown, **optics)
    whole = expected_photons(film(), **optics)
    middle = float(whole["x"][2]), float(whole["y"][0])
    brightness = (1 + ((middle[0] - 4) ** 2 + (middle[1] - 3.5) ** 2) * 0.05**2) ** -2
    without = expected_photons(film(), **optics | {"focal_length_m": None})
    ratio = whole["rate"][0, 2] / without["rate"][0, 2]
    np.testing.assert_allclose(ratio, brightness, rtol=1e-12)
