"""Phasors and rebinned films of parts, and of other orders of axes and labels."""

import numpy as np
import pytest
import xarray as xr
from helpers.hidden_scenes import small_capture
from helpers.made_dataset import make_dataset
from helpers.support import refused

import tofrender
from tofrender import rebin, transient_to_phasor
from tofrender.sensors import expected_photons

OPTICS = {
    **{"lamp_power_w": 2.0, "pulse_energy_j": 1e-9, "wavelength_m": 850e-9, "f_number": 1.4},
    **{"pixel_pitch_m": 10e-6, "focal_length_m": 5e-5},
}


@pytest.fixture(autouse=True)
def _keep_attributes():
    """As newer versions of xarray do by default."""
    with xr.set_options(keep_attrs=True):
        yield


def film(outside=0.0, stokes=False):
    """Return a cropped film of 6 x 4 pixels and 12 bins, with light outside of its window."""
    made = make_dataset(4, 6, 12, x0=6, y0=2, film_width=15, film_height=9)
    made["steady"] /= np.float32(1 - outside)
    if stokes:
        scale = xr.DataArray(
            np.float32([1, 0.5, -0.25, 0.125]), {"stokes": ["S0", "S1", "S2", "S3"]}, "stokes"
        )
        dims = ("y", "x", "opl", "stokes", "channel")
        made["transient"] = (made["transient"] * scale).transpose(*dims)
        made["steady"] = (made["steady"] * scale).transpose("y", "x", "stokes", "channel")
    return made.assign_attrs(energy_outside_window=outside)


def turned(data):
    """Return the same data in another order of axes and labels."""
    mixed = data.isel(x=[3, 0, 5, 1, 2, 4], y=slice(None, None, -1), opl=slice(None, None, -1))
    mixed = mixed.isel(channel=[1, 2, 0])
    if "stokes" in mixed.dims:
        mixed = mixed.isel(stokes=[3, 1, 0, 2])
    return mixed.transpose(*reversed(list(mixed.dims)))


@pytest.mark.parametrize("stokes", [False, True])
def test_films_in_any_order(stokes):
    data = film(stokes=stokes)
    xr.testing.assert_identical(rebin(turned(data), 4), rebin(data, 4))
    right = transient_to_phasor(data, 20e6)
    for one, other in zip(transient_to_phasor(turned(data), 20e6), right, strict=True):
        np.testing.assert_array_equal(one, other)


def test_only_s0_is_light():
    data = film(outside=0.2, stokes=True)
    assert rebin(data.isel(stokes=[2, 0]), 4).attrs["energy_outside_window"] == pytest.approx(0.2)
    refused("S0", rebin, data.isel(stokes=[1, 2]), 4)


@pytest.mark.parametrize("pixels", [{"x": slice(2, 4)}, {"y": [1], "channel": [2]}])
def test_energy_outside_is_that_of_the_chosen_pixels(pixels):
    data = film(outside=0.2)
    data["steady"][{"x": slice(3, None)}] *= 3
    data.attrs["energy_outside_window"] = 0.5  # That of all pixels, which is stale after a choice
    part = data.isel(pixels)
    right = 1 - float(part["transient"].sum()) / float(part["steady"].sum())
    assert rebin(part, 12).attrs["energy_outside_window"] == pytest.approx(right, abs=1e-5)
    with pytest.warns(UserWarning, match=f"{100 * right:.1f} % of the energy"):
        transient_to_phasor(part, 20e6)


@pytest.mark.parametrize("quantity", ["radiance", "radiance per meter"])
def test_a_part_of_the_window_lacks_the_rest(quantity):
    data = film()
    whole = float(data["transient"].sum())
    part = data.isel(opl=slice(5, 11))
    right = 1 - float(part["transient"].sum()) / whole
    if quantity == "radiance per meter":
        part = part.assign(transient=part["transient"] / np.float32(0.02))
        part = part.assign_attrs(quantity=quantity)
    assert right > 0.3
    coarse = rebin(part, 3)
    assert coarse.attrs["energy_outside_window"] == pytest.approx(right, rel=1e-5)
    assert coarse.attrs["start_opl"] == pytest.approx(data.attrs["start_opl"] + 5 * 0.02)
    with pytest.warns(UserWarning, match=f"{100 * right:.1f} % of the energy"):
        transient_to_phasor(part, 20e6)


def test_unwarped_films_are_not_in_camera_time():
    unwarped = tofrender.unwarp_camera(film(), np.full((4, 6), 0.4))
    refused("Pass the render before unwarp_camera", transient_to_phasor, unwarped, 20e6)


def test_pixels_are_averaged():
    data = film(outside=0.2)
    coarse = rebin(data, 4, pixels=(2, 2))
    light = data["transient"].values.reshape(2, 2, 2, 3, 4, 3, 3).sum(axis=5).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse["transient"], light, rtol=1e-5)
    steady = data["steady"].values.reshape(2, 2, 2, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse["steady"], steady, rtol=1e-5)
    assert coarse["x"].values.tolist() == [2, 3]
    assert coarse["y"].values.tolist() == [1, 2]
    assert (coarse.attrs["film_width"], coarse.attrs["film_height"]) == (5, 4.5)
    assert coarse.attrs["energy_outside_window"] == pytest.approx(0.2)
    xr.testing.assert_allclose(rebin(turned(data), pixels=(2, 2)), rebin(data, pixels=(2, 2)))


def test_the_center_of_coarse_pixels_stays_where_it_is():
    """The falloff of a lens at a coarse pixel is that at the middle of the pixels that it covers.

    The film is 15 pixels wide and 9 high; coarse pixels cover 3 x 2 of them.
    """
    even = xr.ones_like(film()).assign_attrs(film().attrs)
    coarse = rebin(even, pixels=(2, 2))
    optics = OPTICS | {"pixel_pitch_m": 1.0}
    found = expected_photons(coarse, **optics | {"focal_length_m": 2.0})["rate"][..., 0]
    x = (np.array([7.0, 10.0]) - 7.0) / 3
    y = (np.array([2.5, 4.5]) - 4.0) / 2
    exact = 1 / (1 + (x / 2) ** 2 + (y[:, None] / 2) ** 2) ** 2
    np.testing.assert_allclose(found / found[0, 0], exact / exact[0, 0], rtol=1e-6)


def test_what_rebin_refuses():
    data = film()
    refused("pixels = .* divide the film of 6 x 4", rebin, data, pixels=(4, 2))
    refused("starts within one of these pixels", rebin, data.isel(x=slice(1, 5)), pixels=(2, 4))
    refused("the axis x skips pixels", rebin, data.isel(x=[0, 2]), pixels=(1, 2))
    refused("bins = None: must be given, or pixels", rebin, data)
    refused("window = .*: must be None without bins", rebin, data, None, (3.5, 3.6), pixels=(3, 2))
    refused("each pixel of a capture is a point", rebin, small_capture(), pixels=(2, 2))
    for change in (
        lambda d: d.coarsen(opl=3).sum(),
        lambda d: d.coarsen(opl=3).mean(),
        lambda d: d.isel(opl=slice(None, None, 2)),
        lambda d: d.isel(opl=[0, 1, 5]),
        lambda d: d.coarsen(x=2).mean(),
        lambda d: d.isel(x=0),
        lambda d: d.expand_dims(frame=2),
    ):
        refused("dataset: the", rebin, change(data), 1)
        refused("transient_data: the", transient_to_phasor, change(data), 20e6)


def test_captures_are_rebinned_in_any_order():
    capture = small_capture()
    mixed = capture.isel(x=slice(None, None, -1), opl=slice(None, None, -1), xyz=[2, 0, 1])
    mixed = mixed.transpose(*reversed(list(mixed.dims)))
    xr.testing.assert_identical(rebin(mixed, 8), rebin(capture, 8))
