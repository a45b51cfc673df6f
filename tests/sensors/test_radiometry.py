"""Expected photons against a manual calculation, and parameters that are refused."""

import dask
import numpy as np
import pytest
from helpers.made_dataset import make_dataset
from helpers.parts import diffuse, plane, point_light
from helpers.support import camera, film, refused, scene

import tofrender
from tofrender.sensors import expected_photons

OPTICS = {
    **{"lamp_power_w": 2.0, "pulse_energy_j": 1e-9, "wavelength_m": 850e-9, "f_number": 1.4},
    **{"pixel_pitch_m": 10e-6, "fill_factor": 0.3, "transmission": 0.8},
    "detection_efficiency": 0.25,
}


def test_from_the_lamps_watts_to_photons_on_a_lambertian_wall():
    """The lamp has 1 W/sr, 12.57 W in total. A wall at 2 m, seen head-on, reflects a half.

    L = 0.5 / pi / 4 = 0.0397887 W m^-2 sr^-1. A pulse of 20 nJ sends 6.3326e-11 J m^-2 sr^-1 to the
    lens. pi / (4 1.4^2) = 0.40071 gives 2.5375e-11 J m^-2 on the pixel, and 7.6126e-22 J on its
    30 um^2. These are 3.2575e-3 photons of 850 nm (2.33699e-19 J), and 6.515e-4 detections.
    """
    floor = plane(bsdf=diffuse(0.5))
    sensor = camera((0, 0, 2), (0, 0, 0), film(3, 3, start=3.5, bins=20), fov=1.0)
    parts = {"floor": floor, "lamp": point_light((0, 0, 2), 1.0)}
    dataset = tofrender.render(scene(parts, sensor, max_depth=2), spp=64, progress=False)
    optics = OPTICS | {"lamp_power_w": 4 * np.pi, "pulse_energy_j": 20e-9}
    rates = expected_photons(dataset, **optics)
    assert rates["rate"].dims == ("y", "x", "bin")
    assert rates["rate"].sum("bin").values == pytest.approx(6.515e-4, rel=1e-3)
    assert rates["opl"].values[rates["rate"].argmax("bin").values] == pytest.approx(4.0, abs=0.06)
    assert rates["background"].values == pytest.approx(0.0)
    assert {"f_number": 1.4, "bin_width_opl": 0.1, "start_opl": 3.5}.items() <= rates.attrs.items()


def test_ambient_light_and_dark_counts():
    """Both arrive at all times, per bin of 2 cm or 66.7 ps, and independent of the signal."""
    dataset = make_dataset()
    dark = expected_photons(dataset, **OPTICS)["rate"]
    light = expected_photons(dataset, **OPTICS, ambient_radiance=10.0, dark_count_hz=1e6)
    bin_s = 0.02 / 299792458
    area = 1e-10 * 0.3 * np.pi / (4 * 1.4**2) * 0.8 * 0.25
    exact = bin_s * (10.0 * area * 850e-9 / (6.62607015e-34 * 299792458) + 1e6)
    assert (light["rate"] - dark).values == pytest.approx(exact, rel=1e-6)
    assert light["background"].values == pytest.approx(exact)


def test_variants_of_the_parameters():
    dataset = make_dataset(height=5, width=7, film_width=7, film_height=5)
    rates = expected_photons(dataset, **OPTICS)["rate"]
    half = expected_photons(dataset, **OPTICS | {"detection_efficiency": 0.125})["rate"]
    assert half.values == pytest.approx(rates.values / 2)
    power = {"pulse_energy_j": None, "mean_power_w": 1e-3, "repetition_rate_hz": 1e6}
    assert expected_photons(dataset, **OPTICS | power)["rate"].values == pytest.approx(rates.values)
    fallen = expected_photons(dataset, **OPTICS, focal_length_m=50e-6)["rate"] / rates
    assert fallen[2, 3].values == pytest.approx(1.0)
    assert fallen[0, 0].values == pytest.approx(np.cos(np.arctan(np.hypot(2, 3) / 5)) ** 4)
    red = expected_photons(dataset.sel(channel=["R"]), **OPTICS)["rate"]
    assert red.values / rates.values == pytest.approx(
        dataset["transient"].sel(channel="R").values / dataset["transient"].mean("channel").values,
        rel=1e-4,
    )
    short = expected_photons(dataset, photons_per_cycle=0.3, background_per_cycle=0.2)
    assert short["rate"].sum("bin").mean().item() == pytest.approx(0.5)
    assert short["background"].values == pytest.approx(0.2 / 5)
    stokes = dataset.expand_dims(stokes=["S0", "S1", "S2", "S3"])
    assert expected_photons(stokes, **OPTICS)["rate"].values == pytest.approx(rates.values)


def test_lazy_films_stay_lazy():
    dataset = make_dataset()
    for given in (OPTICS, {"photons_per_cycle": 0.3}):
        lazy = expected_photons(dataset.chunk({"y": 2, "opl": 3}), **given)
        assert dask.is_dask_collection(lazy["rate"].data)
        assert lazy["rate"].values == pytest.approx(
            expected_photons(dataset, **given)["rate"].values
        )


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"f_number": None}, "f_number = None:"),
        ({"pulse_energy_j": None}, "pulse_energy_j = None:"),
        ({"mean_power_w": 1.0}, "pulse_energy_j = 1e-09:"),
        ({"photons_per_cycle": 1.0}, "lamp_power_w = 2.0:"),
        ({"background_per_cycle": 1.0}, "background_per_cycle = 1.0:"),
        ({"detection_efficiency": 1.2}, "detection_efficiency = 1.2:"),
        ({"ambient_radiance": -1.0}, "ambient_radiance = -1.0:"),
        ({"wavelength_m": float("nan")}, "wavelength_m = nan:"),
        (
            {"pulse_energy_j": None, "mean_power_w": 1.0, "repetition_rate_hz": 4e9},
            "repetition_rate_hz = 4000000000.0:",
        ),
    ],
)
def test_bad_parameters(changes, text):
    refused(text, expected_photons, make_dataset(), **OPTICS | changes)


def test_bad_datasets():
    refused(
        "expected a Dataset of render, found ndarray",
        expected_photons,
        np.ones((2, 2)),
        photons_per_cycle=1,
    )
    dark = make_dataset() * 0
    dark.attrs = make_dataset().attrs
    refused("photons_per_cycle = 1:", expected_photons, dark, photons_per_cycle=1)
    gated = make_dataset(quantity="radiance per meter")
    refused("quantity = 'radiance per meter'", expected_photons, gated, photons_per_cycle=1)
