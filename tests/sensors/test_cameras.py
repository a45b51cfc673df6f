"""Gated and streak cameras against sums of bins, and their noise by mean and variance."""

import numpy as np
import pytest
from helpers.support import agree, refused
from scipy.stats import norm

from tofrender.sensors import GatedCamera, StreakCamera
from tofrender.signals.units import SPEED_OF_LIGHT

WIDTH = 0.1
BIN_S = WIDTH / SPEED_OF_LIGHT
RATES = np.random.default_rng(1).random((5, 7, 40))


def images(camera, rates=RATES, cycles=1):
    return camera.expected(rates, cycles, bin_width_opl=WIDTH)["images"].values


def test_gates_sum_bins():
    """Sharp gates sum bins, also fractions of bins. Consecutive gates receive all light."""
    delays = np.arange(10) * 4 * WIDTH
    sharp = images(GatedCamera(delays_opl=delays, width_s=4 * BIN_S))
    exact = RATES.reshape(5, 7, 10, 4).sum(axis=3)
    assert np.moveaxis(sharp, 0, 2) == pytest.approx(exact, rel=1e-6)
    part = images(GatedCamera(delays_opl=[3.25 * WIDTH], width_s=BIN_S))[0]
    assert part == pytest.approx(0.75 * RATES[..., 3] + 0.25 * RATES[..., 4], rel=1e-6)
    row = np.arange(-30, 80) * WIDTH
    soft = images(GatedCamera(delays_opl=row, width_s=BIN_S, edge_s=3 * BIN_S))
    assert soft.sum(axis=0) == pytest.approx(RATES.sum(axis=2), rel=1e-6)


def test_edges_and_extinction():
    """One photon at one path length samples the profile, averaged over its bin."""
    rates = np.zeros((1, 1, 40))
    rates[0, 0, 20] = 1.0
    delays = np.linspace(0.5, 3.5, 31)
    camera = GatedCamera(delays_opl=delays, width_s=5 * BIN_S, edge_s=2 * BIN_S, extinction=0.01)
    t = 2.0 + (np.arange(1000)[:, None] + 0.5) / 1000 * WIDTH - delays
    s = 2 * WIDTH
    profile = (norm.cdf(t / s) - norm.cdf((t - 5 * WIDTH) / s)).mean(axis=0)
    assert images(camera, rates)[:, 0, 0] == pytest.approx(0.01 + 0.99 * profile, abs=1e-6)


@pytest.mark.statistical
@pytest.mark.parametrize("factor", [1.0, 1.6])
def test_excess_noise(factor):
    """The mean is m, the variance is F m + read noise squared. Long exposures reach the mean."""
    rates = np.full((100, 100, 1), 0.5)
    noise = {"excess_noise": factor, "read_noise": 3.0}
    camera = GatedCamera(delays_opl=[0.0], width_s=BIN_S, **noise)
    screen = StreakCamera(sweep_opl=WIDTH, **noise)
    for each in (camera, screen):
        found = each.frames(rates, 50, seed=2, bin_width_opl=WIDTH)["images"].values.ravel()
        assert agree(found, np.array(25.0))
        square = (found - found.mean()) ** 2 * len(found) / (len(found) - 1)
        assert agree(square, np.array(25 * factor + 9))
        assert not agree(square, np.array(25.0 if factor == 1 else 25 * factor**2))  # Power
        many = each.frames(rates, 2**31 - 1, bin_width_opl=WIDTH)["images"].values
        assert many == pytest.approx(0.5 * (2**31 - 1), rel=1e-3)


def test_sweep_and_slit():
    screen = images(StreakCamera(sweep_opl=2.5 * WIDTH), cycles=3)
    assert screen.shape == (5, 16, 7)
    first = RATES[..., 0] + RATES[..., 1] + 0.5 * RATES[..., 2]
    assert screen[:, 0] == pytest.approx(3 * first)
    assert screen.sum(axis=1) == pytest.approx(3 * RATES.sum(axis=2))
    wide = images(StreakCamera(sweep_opl=WIDTH, slit_rows=3))
    assert wide[2] == pytest.approx(RATES[1:4].sum(axis=0).T)
    assert wide[0] == pytest.approx(RATES[:2].sum(axis=0).T)


def test_point_spread_keeps_light_and_adds_variances():
    rates = np.zeros((1, 61, 161))
    rates[0, 30, 80] = 1.0
    blur = StreakCamera(sweep_opl=WIDTH, slit_width=9, spread_sweep=4.0, spread_slit=2.0)
    screen = images(blur, rates)[0]
    assert screen.sum() == pytest.approx(1.0, rel=1e-6)
    t, x = np.arange(161) - 80, np.arange(61) - 30
    assert screen.sum(axis=1) @ t**2 == pytest.approx(16 + (81 - 1) / 12, rel=1e-3)
    assert screen.sum(axis=0) @ x**2 == pytest.approx(4, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "given", "text"),
    [
        (GatedCamera, {"width_s": 0}, "width_s = 0"),
        (GatedCamera, {"width_s": 1e-9, "delays_opl": []}, "delays_opl with shape"),
        (GatedCamera, {"width_s": 1e-9, "delays_opl": [np.nan]}, "delays_opl: 1 of 1 values"),
        (GatedCamera, {"width_s": 1e-9, "excess_noise": 0.5}, "excess_noise = 0.5"),
        (StreakCamera, {"sweep_opl": 0.1, "slit_rows": 2}, "slit_rows = 2:"),
        (StreakCamera, {"sweep_opl": 0.1, "read_noise": -1}, "read_noise = -1"),
    ],
)
def test_bad_parameters(kind, given, text):
    refused(text, kind, **({"delays_opl": [0.0]} if kind is GatedCamera else {}) | given)


def test_a_sweep_longer_than_the_window():
    refused("sweep_opl = 9.0:", images, StreakCamera(sweep_opl=9.0))
