"""Films of range rates, spectra and Doppler measurements are read by their labels."""

import numpy as np
import pytest
import xarray as xr
from helpers.support import refused

import tofrender
from tofrender import Fmcw, Motion, doppler_rate, range_rate

LIDAR = Fmcw(bandwidth_hz=1e9, chirp_s=1e-5, wavelength_m=1.55e-6, looks=2, photons=50.0)


@pytest.fixture(autouse=True)
def _keep_attributes():
    """As newer versions of xarray do by default."""
    with xr.set_options(keep_attrs=True):
        yield


def moving_box(size=(5, 4)):
    width, height = size
    described = tofrender.cornell_box(width=width, height=height, max_depth=2)
    return tofrender.moving(
        tofrender.load_scene(described, optimize=False),
        {"small-box": Motion(velocity=(0.5, 0, 4))},
    )


@pytest.fixture(scope="module")
def film():
    options = {"bins": 50, "window": (5, 15), "rate_bins": 12, "rates": (-0.9, 0.9)}
    found = range_rate(moving_box(), spp=2, progress=False, **options)
    return found.isel(x=slice(1, 4))


@pytest.fixture(scope="module")
def measured():
    return tofrender.doppler(moving_box(), spp=2, progress=False)


def turned(data):
    """Return the same data in another order of axes and labels."""
    data = data.isel({axis: slice(None, None, -1) for axis in data.dims})
    return data.transpose(*reversed(list(data.dims)))


@pytest.mark.filterwarnings("ignore:.*of the energy is outside the bins")
def test_spectra_and_estimates(film):
    spectra = LIDAR.spectra(film, seed=3)
    xr.testing.assert_identical(LIDAR.spectra(turned(film), seed=3), spectra)
    late = LIDAR.spectra(film.isel(opl=slice(10, None)))
    assert late["up"].sum() > 0
    part = film.isel(opl=slice(10, None))
    outside = 1 - float(part["radiance"].sum()) / float(part["steady"].sum())
    assert late.attrs["energy_outside_window"] == pytest.approx(outside, abs=1e-6)
    assert abs(outside - film.attrs["energy_outside_window"]) > 0.01
    estimates = LIDAR.estimates(spectra)
    xr.testing.assert_identical(LIDAR.estimates(turned(spectra)), estimates)
    for change, said in (
        (lambda d: d.isel(opl=slice(None, None, 2)), "the bins of opl are 0.4 apart"),
        (lambda d: d.coarsen(rate=2).sum(), "the bins of rate are 0.3 apart"),
        (lambda d: d.isel(x=0), "axis x"),
        (lambda d: d.sum("channel"), "axis channel"),
        (lambda d: d.coarsen(x=3).mean(), "axis x"),
        (lambda d: d["radiance"], "pass the whole Dataset"),
    ):
        refused(f"^film: .*{said}", LIDAR.spectra, change(film))
    refused("^spectra: .*axis y", LIDAR.estimates, spectra.isel(y=0))
    refused("with all beats", LIDAR.estimates, spectra.isel(beat=slice(None, None, 2)))


def test_rates_of_a_doppler_camera(measured):
    right = doppler_rate(measured)
    assert np.isfinite(right).any()
    xr.testing.assert_identical(doppler_rate(turned(measured)), right)
    columns = doppler_rate(measured.isel(x=[3, 1]))
    xr.testing.assert_identical(columns, right.isel(x=[1, 3]))
    refused("measured: the axis part contains Q only", doppler_rate, measured.isel(part=[1]))
    refused("measured: .*axis channel", doppler_rate, measured.sum("channel"))
    refused("measured: .*attribute waveform is missing", doppler_rate, measured.drop_attrs())
