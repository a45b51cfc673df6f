"""Shots of a lidar are read by their labels, and clouds know the jitter of their detector."""

import numpy as np
import pytest
import xarray as xr
from helpers.support import refused
from scipy.stats import norm

from tofrender import GaussianPulse, SampledPulse
from tofrender.scanning import lidar, point_cloud, scan_pattern, true_points
from tofrender.sensors import Response, Spad
from tofrender.sensors.response import blurred, distribution
from tofrender.signals.units import SPEED_OF_LIGHT

START, WIDTH, SIGMA = 1.5, 0.03, 0.06
SHOTS, BINS = 12, 300
RANGES = np.linspace(1.6, 2.8, SHOTS)


def waveforms(moving=False):
    """Return shots at different ranges, in different directions, from a place in the world."""
    edges = START + np.arange(BINS + 1) * WIDTH
    cdf = norm.cdf(edges, 2 * RANGES[:, None], SIGMA)
    azimuth = np.linspace(-0.3, 0.5, SHOTS)
    origin = np.array([1.0, 2.0, 3.0])
    if moving:
        origin = origin + np.linspace(0, 1, SHOTS)[:, None] * [0.5, 0, 0.25]
    arrays = {
        "rate": (("shot", "bin"), 40 * np.diff(cdf) + 1e-3),
        "background": ("shot", np.full(SHOTS, 1e-3)),
        "true_range": ("shot", RANGES),
        "time": ("shot", np.arange(SHOTS) * 1e-5),
        "direction": (
            ("shot", "axis"),
            np.stack([np.sin(azimuth), 0.1 + 0 * azimuth, np.cos(azimuth)], axis=1),
        ),
        "origin": (("shot", "axis") if moving else "axis", origin),
    }
    places = {"opl": ("bin", edges[:-1] + WIDTH / 2), "axis": [*"xyz"]}
    attrs = {"start_opl": START, "bin_width_opl": WIDTH, "pulse_width_opl": SIGMA}
    return xr.Dataset(arrays, places, attrs)


def turned(data):
    """Return the same data in another order of axes and labels."""
    mixed = data.isel(axis=[2, 0, 1], bin=slice(None, None, -1))
    return mixed.transpose(*reversed(list(mixed.dims)))


@pytest.mark.parametrize("moving", [False, True])
def test_axes_of_shots_are_found_by_their_labels(moving):
    given = waveforms(moving)
    points = true_points(given)
    expected = given["origin"] + given["direction"] * given["true_range"]
    for axis in "xyz":
        np.testing.assert_allclose(points[axis], expected.sel(axis=axis))
    xr.testing.assert_identical(true_points(turned(given)), points)
    xr.testing.assert_identical(point_cloud(turned(given)), point_cloud(given))


def test_a_part_of_the_window_starts_where_it_is():
    late = point_cloud(waveforms().isel(bin=slice(20, None)))
    np.testing.assert_allclose(late["range"], RANGES[late["shot"].values], atol=0.03)
    assert late.sizes["point"] == SHOTS


def test_shots_keep_their_labels():
    given = waveforms().assign_coords(shot=np.arange(SHOTS) + 100)
    assert true_points(given.isel(shot=[7, 2]))["shot"].values.tolist() == [102, 107]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.isel(shot=0), "axis shot"),
        (lambda d: d.isel(axis=[0, 1]), "axis axis contains x, y only"),
        (lambda d: d.isel(bin=slice(None, None, 2)), "rebin"),
        (lambda d: d.drop_vars("background"), "background is missing"),
        (lambda d: d.expand_dims(scan=2), "axis scan"),
        (lambda d: d["rate"], "pass the whole Dataset"),
    ],
)
def test_what_is_no_waveform(change, said):
    for function in (point_cloud, true_points):
        refused(f"waveforms: .*{said}", function, change(waveforms()))


LATE = SampledPulse([1.0, 3.0, 2.0, 0.5], start_opl=0.05, bin_width_opl=0.1)
JITTERS = {
    "response": Response(150e-12, tail_s=400e-12),
    "pulse": GaussianPulse(0.05),
    "measured": LATE,
}


@pytest.mark.parametrize("name", JITTERS)
def test_ranges_do_not_depend_on_the_jitter_of_the_detector(name):
    """Without a response, a late detector measured 6 to 57 cm too far."""
    detector = Spad(mode="multi_hit", jitter=JITTERS[name])
    found = point_cloud(waveforms(), pulses=500, detector=detector, max_returns=1)
    assert found.sizes["point"] == SHOTS
    np.testing.assert_allclose(found["range"], RANGES, atol=0.006)


@pytest.mark.parametrize("name", JITTERS)
def test_blurred_responses_are_convolutions(name):
    """Means and variances of independent delays add up."""
    parts = distribution("jitter", JITTERS[name])
    whole = distribution("jitter", blurred(JITTERS[name], 0.08))
    assert whole.mean() == pytest.approx(parts.mean(), abs=1e-6)
    assert whole.var() == pytest.approx(parts.var() + 0.08**2, rel=2e-3)
    if name == "measured":
        edges = LATE.start_opl + LATE.bin_width_opl * np.arange(5)
        masses = LATE.density * LATE.bin_width_opl
        u = (np.arange(4000) + 0.5) / 4000
        centers = edges[:-1, None] + u * LATE.bin_width_opl
        for opl in (0.0, 0.2, 0.45):
            exact = masses @ norm.cdf(opl, centers, 0.08).mean(axis=1)
            assert whole.cdf(opl) == pytest.approx(exact, abs=2e-3)
    assert blurred(Response(1e-10, 2e-10), SPEED_OF_LIGHT * 1e-10).tail_s == 2e-10


def test_earlier_shots_are_a_pattern():
    options = {"spp": 2, "max_depth": 2, "max_range": 8.0, "progress": False}
    pattern = scan_pattern(shots=(3, 2), fov_deg=(20, 10))
    first = lidar("cornell_box", pattern, **options)
    again = lidar("cornell_box", first.isel(bin=slice(40, None)), bin_width_opl=0.03, **options)
    xr.testing.assert_identical(again, first)
    turned_about = pattern.isel(shot=slice(None, None, -1))
    back = lidar("cornell_box", turned_about, **options)
    np.testing.assert_allclose(back["true_range"], first["true_range"][::-1], rtol=1e-6)
    named = pattern.assign(ring=("shot", ["a", "b"] * 3))
    assert lidar("cornell_box", named, **options)["ring"].values.tolist() == ["a", "b"] * 3


def test_what_is_no_pattern():
    pattern = scan_pattern(shots=(3, 2))
    for change, said in (
        (lambda d: d.isel(shot=0), "axis shot"),
        (lambda d: d.drop_vars("time"), "time is missing"),
        (lambda d: d.isel(shot=slice(0, 0)), "axis shot is empty"),
        (lambda d: d.assign(azimuth=("shot", np.full(6, np.nan))), "not finite"),
        (lambda d: d.assign(azimuth=("shot", ["a"] * 6)), "real numbers"),
    ):
        refused(f"^pattern.*{said}", lidar, "cornell_box", change(pattern), progress=False)
