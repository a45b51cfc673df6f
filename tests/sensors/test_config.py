"""Sensors from TOML files: presets follow their expectation, errors are one line."""

import json

import numpy as np
import pytest
import xarray as xr
from helpers.made_dataset import make_dataset
from helpers.refusals import refused
from helpers.support import ALPHA, COMPARISONS, smallest_allowed
from scipy import stats

import tofrender
from tofrender.sensors import Spad, expected_photons, sense
from tofrender.sensors.multi_zone import MULTI_ZONE_PRESETS
from tofrender.sensors.sensor_config import FOLDER, PRESETS, read_sensor

GOOD = {"cycles": 9, "photons": {"photons_per_cycle": 0.1}, "spad": {}}


@pytest.fixture(scope="module")
def box():
    options = {"spp": 16, "size": (64, 64), "window": "auto", "progress": False}
    return tofrender.render("cornell_box", **options)


def fits(measured: xr.Dataset, expected: xr.DataArray) -> bool:
    """Return whether sums of pixels scatter around their expectation as the model predicts."""
    model = read_sensor(json.loads(measured.attrs["sensor"]))["model"]
    variance = expected * getattr(model, "excess_noise", 1.0)
    if isinstance(model, Spad) and model.mode == "first_photon":
        variance = expected * (1 - expected.sum("bin") / measured["cycles"])
    variance = variance + getattr(model, "read_noise", 0.0) ** 2
    if getattr(model, "adc_bits", None):
        variance = variance + (model.full_well / ((1 << model.adc_bits) - 1)) ** 2 / 12
    given = measured[measured.attrs["quantity"]].astype(float)
    kept = ~measured["saturated"] if "saturated" in measured else True
    sums = [(each * kept).sum(set(each.dims) - {"y", "x"}) for each in (given, expected, variance)]
    normal = sums[2].values > 20  # Nearly
    found, mean, spread = (each.values[normal] for each in sums)
    z = (found - mean) / np.sqrt(spread)
    total = (found - mean).sum() / np.sqrt(spread.sum())
    p = [stats.chi2.sf((z**2).sum(), z.size), 2 * stats.norm.sf(abs(total))]
    return min(p) > smallest_allowed(smallest_allowed(ALPHA, COMPARISONS), 2)


@pytest.mark.essential
@pytest.mark.statistical
@pytest.mark.parametrize("name", PRESETS)
def test_presets_measure_what_they_expect(box, name):
    measured = sense(box, name, seed=1)
    assert sense(box, FOLDER / f"{name}.toml", seed=1).identical(measured)
    assert fits(measured, measured["expected"])
    assert not fits(measured, 1.03 * measured["expected"])  # Power
    assert "depth" not in measured or 0.5 < float(measured["depth"].median()) < 5


def test_presets_are_the_files():
    files = sorted(path.stem for path in FOLDER.glob("*.toml"))
    assert sorted((*PRESETS, *MULTI_ZONE_PRESETS)) == files


def test_pixels_are_means_of_the_films():
    data = make_dataset(4, 6, 5, film_width=6, film_height=4)
    optics = {"lamp_power_w": 1.0, "pulse_energy_j": 1e-12, "wavelength_m": 1e-6, "f_number": 2.0}
    optics |= {"pixel_pitch_m": 1e-3, "focal_length_m": 2e-3}
    found = sense(data, GOOD | {"photons": optics, "pixels": [3, 2], "spad": {"mode": "multi_hit"}})
    light = data["transient"].values.reshape(2, 2, 3, 2, 5, 3).mean(axis=(1, 3))
    small = make_dataset(2, 3, 5, film_width=3, film_height=2)
    small["transient"] = small["transient"].copy(data=light)
    rates = expected_photons(small, **optics)["rate"]
    assert np.allclose(found["expected"], 9 * rates, rtol=1e-5)
    assert found["x"].values.tolist() == [0, 1, 2]


def test_no_expectation_without_a_closed_form():
    measured = sense(make_dataset(2, 2, 5), GOOD | {"spad": {"macro_pixel": [2, 2]}})
    assert "expected" not in measured
    assert measured.sizes["y"] == 1


def test_numbers_of_numpy_and_crops():
    config = {"photons": {"photons_per_cycle": np.float32(0.5)}, "cycles": np.int64(100)}
    gated = {"delays_opl": np.arange(1.0, 3.0), "width_s": 1e-9}
    found = sense(make_dataset(2, 2, 50), config | {"gated": gated})
    assert json.loads(found.attrs["sensor"])["gated"]["delays_opl"] == [1.0, 2.0]
    film = make_dataset(4, 4, 5)
    cropped = film.assign_coords(x=film["x"] + 1)
    with refused(r"sensor.pixels = \[2, 2\]:"):
        sense(cropped, GOOD | {"pixels": [2, 2]})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"cycle": 3}, "sensor.cycle: is not known, did you mean cycles"),
        ({"cycles": 0}, "sensor.cycles = 0:"),
        ({"itof": {}}, "sensor = .*: must be a table with one of spad, itof"),
        ({"photons": 3}, "sensor.photons = 3:"),
        ({"photons": {"photon_per_cycle": 1}}, "sensor.photons.photon_per_cycle: is not known"),
        ({"photons": {"photons_per_cycle": -1}}, "photons_per_cycle = -1:"),
        ({"photons": {}}, "must be given"),
        (
            {"pixels": [4, 4]},
            r"sensor.pixels = \[4, 4\]:",
        ),
        ({"pixels": 4}, r"sensor.pixels = 4:"),
        ({"spad": {"mode": "both"}}, "sensor.spad.mode = 'both':"),
        ({"spad": {"deadtime": 1}}, "sensor.spad.deadtime: is not known"),
        ({"spad": {"jitter": {}}}, "sensor.spad.jitter.sigma_s: must be given"),
        ({"spad": {"jitter": {"sigma_s": 0}}}, "sensor.spad.jitter.sigma_s = 0:"),
        ({"spad": 1}, "sensor.spad = 1:"),
    ],
)
def test_bad_keys_are_one_line(change, said):
    with refused(said):
        sense(make_dataset(2, 2, 5), GOOD | change)
    for key in GOOD:
        with refused("must"):
            read_sensor({name: value for name, value in GOOD.items() if name != key})
