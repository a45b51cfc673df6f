"""FMCW lidar: frequencies of beats with their signs, resolution, speckle, shot noise, refusals."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from helpers.support import agree, refused
from scipy.signal import get_window

import tofrender
from tofrender import Fmcw
from tofrender.motion.choices import WINDOWS
from tofrender.signals.units import SPEED_OF_LIGHT

LIDAR = Fmcw(bandwidth_hz=1e9, chirp_s=1e-5, wavelength_m=1.55e-6)
OPL = 4.0 + 0.1 * np.arange(60)
RATES = 0.05 * np.arange(-60, 61)


def film(cells: dict[tuple[int, int], float], pixels=(1, 1)) -> xr.Dataset:
    """Light in some cells, by their numbers along path length and rate."""
    light = np.zeros((*pixels, OPL.size, RATES.size, 1))
    for cell, radiance in cells.items():
        light[:, :, *cell, 0] = radiance
    dims = ("y", "x", "opl", "rate", "channel")
    return xr.Dataset({"radiance": (dims, light)}, {"opl": OPL, "rate": RATES, "channel": ["L"]})


@pytest.mark.parametrize("rate", [100, 20])  # Receding, approaching
def test_beats_have_the_frequencies_and_signs_of_the_formula(rate):
    spectra = LIDAR.spectra(film({(30, rate): 2.0}))
    slope = LIDAR.bandwidth_hz / LIDAR.chirp_s
    for name, sign in (("up", 1), ("down", -1)):
        beat = slope * OPL[30] / SPEED_OF_LIGHT + sign * RATES[rate] / LIDAR.wavelength_m
        center = (spectra[name] * spectra["beat"]).sum() / spectra[name].sum()
        assert center.item() == pytest.approx(beat, abs=0.02 / LIDAR.chirp_s)
        assert spectra[name].sum().item() == pytest.approx(2.0, rel=1e-4)
    found = LIDAR.estimates(spectra)
    assert found["opl"].item() == pytest.approx(OPL[30], abs=0.015 * LIDAR.resolution[0])
    assert found["rate"].item() == pytest.approx(RATES[rate], abs=0.015 * LIDAR.resolution[1])
    assert np.sign(found["rate"].item()) == np.sign(RATES[rate])


def test_a_rate_above_the_length_has_a_negative_beat():
    fast = Fmcw(bandwidth_hz=1e8, chirp_s=1e-5, wavelength_m=1.55e-6)
    found = fast.spectra(film({(0, 120): 1.0}))
    assert found["beat"][found["down"].argmax("beat")].item() < 0
    assert fast.estimates(found)["rate"].item() == pytest.approx(3.0, abs=0.01)


def test_no_light_has_no_estimate():
    assert np.isnan(LIDAR.estimates(LIDAR.spectra(film({})))["opl"].item())


def test_resolution_is_c_over_b_and_lambda_over_t():
    assert LIDAR.resolution == pytest.approx((0.299792458, 0.155))
    for window in WINDOWS:
        lidar = replace(LIDAR, window=window)
        resolved = []
        for cells in (3, 12):  # 0.3 m is one bin of the spectrum, 1.2 m are four
            up = lidar.spectra(film({(20, 60): 1.0, (20 + cells, 60): 1.0}))["up"].values.ravel()
            first, second = (round(OPL[20 + k] / 0.299792458) + up.size // 2 for k in (0, cells))
            resolved.append(up[first : second + 1].min() < 0.5 * up.max())
        assert resolved == [False, True], window


@pytest.mark.parametrize("window", WINDOWS)
def test_expectation_of_speckle_is_that_of_exact_sums(window):
    """Expected power is that of each cell by itself, at its exact frequency."""
    cells = {(20, 80): 1.0, (23, 61): 0.5, (41, 33): 2.0}
    lidar = replace(LIDAR, window=window)
    found = lidar.spectra(film(cells))
    count = found.sizes["beat"]
    weights = get_window(WINDOWS[window], count)
    beat, time = found["beat"].values, np.arange(count) / count * LIDAR.chirp_s
    exact = np.zeros(count)
    for (i, j), power in cells.items():
        own = OPL[i] / 0.299792458 + RATES[j] / 0.155
        waves = np.exp(2j * np.pi * np.outer(own / LIDAR.chirp_s - beat, time))
        exact += power / count * abs(waves @ weights) ** 2 / (weights**2).sum()
    assert found["up"].values.ravel() == pytest.approx(exact, abs=0.02 * exact.max())


@pytest.mark.statistical
@pytest.mark.parametrize("photons", [None, 40.0])
@pytest.mark.parametrize("looks", [1, 4])
def test_speckle_is_exponential_and_falls_with_looks(looks, photons):
    """Power over its mean has the variance 1/K and, of one look, moments k!; noise adds to it."""
    cells = {(i, j): 1.0 for i in range(15, 30) for j in range(40, 80, 5)}
    mean = replace(LIDAR, photons=photons).spectra(film(cells))
    lidar = replace(LIDAR, photons=photons, looks=looks)
    found = lidar.spectra(film(cells, (60, 50)), seed=3)
    for name in ("up", "down"):
        at = mean[name].values.ravel().argmax()
        power = found[name].values[..., at].ravel().astype(float) / mean[name].values.ravel()[at]
        assert agree(power, np.array(1.0), rounding=5e-3)
        assert agree((power - 1) ** 2, np.array(1 / looks), rounding=1e-2)
        assert not agree((power - 1) ** 2, np.array(1.25 / looks), rounding=1e-2)  # Power
        if looks == 1:
            assert agree(power**3, np.array(6.0), rounding=2e-2)
    again = lidar.spectra(film(cells, (60, 50)), seed=3)
    assert again.equals(found)
    assert not lidar.spectra(film(cells, (60, 50)), seed=4).equals(found)


def test_up_and_down_chirps_of_a_look_share_amplitudes():
    found = replace(LIDAR, looks=1).spectra(film({(30, 90): 1.0}, (40, 40)))
    heights = [found[name].max("beat").values.ravel() for name in ("up", "down")]
    assert np.corrcoef(heights)[0, 1] > 0.99
    assert np.std(heights[0]) > 0.5 * np.mean(heights[0])


@pytest.mark.statistical
def test_shot_noise_has_mean_power_1_and_photons_are_counted():
    dark, lit = film({}), film({(30, 60): 5.0}, (2, 1))
    lit["radiance"].values[0] *= 3
    noisy = replace(LIDAR, photons=100.0, looks=2000, excess_noise=2.0)
    assert agree(noisy.spectra(dark)["up"].values.reshape(-1, 1).astype(float), np.array([2.0]))
    found = replace(LIDAR, photons=100.0).spectra(lit)
    noise = found.sizes["beat"]
    assert found["up"].sum("beat").values.ravel() == pytest.approx([150 + noise, 50 + noise])
    assert found["up"].attrs["units"] == "photons"


def test_a_moving_box_is_found_where_it_is():
    scene = tofrender.load_scene("cornell_box_flash", width=9, height=9, optimize=False)
    tofrender.moving(scene, {"large-box": tofrender.Motion(velocity=(0, 0, -2.0))})
    axes = {"bins": 100, "window": (3.5, 25), "rates": (-8, 8), "rate_bins": 121}
    light = tofrender.range_rate(scene, spp=64, **axes, progress=False)
    found = LIDAR.estimates(LIDAR.spectra(light))
    truth = tofrender.true_depth(scene)
    moves = found["rate"].values > 1.0
    assert 2 < moves.sum() < 30
    off = abs(found["opl"].values / 2 - truth)[moves]  # Centers of pixels may see another surface
    assert np.median(off) < 0.05
    assert np.median(found["rate"].values[moves]) / 2 == pytest.approx(2.0, abs=0.1)


def test_what_does_not_suit_the_film_is_refused():
    light = film({(30, 60): 1.0})
    for change, text in (
        ({"bandwidth_hz": 1e10}, "film with bins of opl 0.1 wide: must be at most as wide"),
        ({"chirp_s": 1e-3}, "film with bins of rate 0.05 wide: must be at most as wide"),
        ({"sample_rate_hz": 2e6}, "sample_rate_hz = 2000000.0:"),
    ):
        refused(text, replace(LIDAR, **change).spectra, light)
    refused("bandwidth_hz = .*: must be a finite number", replace, LIDAR, bandwidth_hz=[1e9, 2e9])
    refused("excess_noise = 2.0:", replace, LIDAR, excess_noise=2.0)
    refused("film: the coordinate rate is missing", LIDAR.spectra, light.drop_vars("rate"))
    refused("film: the bins are not consecutive", LIDAR.spectra, light.isel(rate=[0, 1, 5]))
    refused("film: the axis rate has one entry", LIDAR.spectra, light.isel(rate=[0]))
    refused("film = .*: must be finite", LIDAR.spectra, film({(3, 3): np.nan}))
    other = replace(LIDAR, chirp_s=2e-5)
    spectra = LIDAR.spectra(light)
    refused("spectra = .*: must be a Dataset of this", other.estimates, spectra)
    half = spectra.isel(beat=slice(spectra.sizes["beat"] // 2, None))
    refused("spectra = .*, with all beats", LIDAR.estimates, half)
    refused("spectra: .*axis y", LIDAR.estimates, spectra.isel(y=0))
    turned = spectra.isel(beat=slice(None, None, -1)).transpose("beat", "x", "y")
    xr.testing.assert_identical(LIDAR.estimates(turned), LIDAR.estimates(spectra))
