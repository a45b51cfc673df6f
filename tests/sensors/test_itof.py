"""iToF cameras against formulas: mean and variance, harmonics, saturation, unwrapping."""

from fractions import Fraction

import numpy as np
import pytest
import xarray as xr
from helpers.support import agree, refused
from scipy.special import erfc

from tofrender.sensors import Itof
from tofrender.sensors.taps import demodulate, multipath_phase_error, phase_deviation
from tofrender.signals.units import SPEED_OF_LIGHT

WIDTH = 0.05
F = 20e6


def scene(phase_opl, signal, background=0.0, pixels=(1, 1), bins=400, width=WIDTH):
    """Return rates of one return near a path length, with background; electrons in one cycle."""
    rates = np.full((*pixels, bins), background / bins)
    rates[:, :, int(phase_opl / width)] += signal
    arrays = {"rate": (("y", "x", "bin"), rates)}
    arrays["background"] = ("y", "x"), np.full(pixels, background / bins)
    opl = (int(phase_opl / width) + 0.5) * width
    centers = {"opl": ("bin", (np.arange(bins) + 0.5) * width)}
    return xr.Dataset(arrays, centers, {"start_opl": 0.0, "bin_width_opl": width}), opl


@pytest.mark.parametrize("taps", [3, 4, 5, 8])
def test_means_of_taps(taps):
    """m_k = S/N (1 + M cos(phi - 2 pi k/N)) + B/N, over any window of ambient light."""
    rates, opl = scene(7.3, 6000.0, 2000.0)
    camera = Itof(frequencies_hz=F, taps=taps, contrast=0.7)
    found = camera.expected(rates)
    phi = 2 * np.pi * F * opl / SPEED_OF_LIGHT
    exact = 6000 / taps * (1 + 0.7 * np.cos(phi - 2 * np.pi * np.arange(taps) / taps)) + 2000 / taps
    assert found["taps"].values[0, :, 0, 0] == pytest.approx(exact)
    depth = camera.depth(found)
    assert depth["phase"].item() == pytest.approx(np.angle(np.exp(1j * phi)))
    assert depth["amplitude"].item() == pytest.approx(6000)
    assert depth["depth"].item() == pytest.approx(opl / 2)


@pytest.mark.statistical
@pytest.mark.parametrize(("taps", "sigma"), [(4, 0.0317659), (5, 0.0321649), (8, 0.0333333)])
def test_noise_of_the_phase(taps, sigma):
    """Var phi = 2 (S + B + N sigma_r^2) / (S M)^2: S 6000, B 2000, M .7, sigma_r 15."""
    rates, opl = scene(7.3, 6000.0, 2000.0, pixels=(100, 100))
    camera = Itof(frequencies_hz=F, taps=taps, contrast=0.7, read_noise=15.0)
    to_phase = 4 * np.pi * F / SPEED_OF_LIGHT
    bound = np.sqrt(2 * (6000 + 2000 + taps * 15**2)) / (6000 * 0.7)
    assert bound == pytest.approx(sigma, abs=5e-8)
    assert phase_deviation(6000, 2000, 0.7, taps, 15.0) == pytest.approx(bound)
    depth = camera.depth(camera.frames(rates, 1, seed=taps))["depth"].values.ravel()
    assert agree(depth, np.array(opl / 2))
    square = (depth - opl / 2) ** 2 * to_phase**2
    assert agree(square, np.array(sigma**2), rounding=5e-3)  # The arc's second order
    assert not agree(square, np.array(1.2 * sigma**2), rounding=5e-3)  # Power


@pytest.mark.parametrize("phi", [0.3, 1.1, 2.9])
def test_harmonics_wiggle(phi):
    """Four taps: arg(1 + a_3 exp(-4i phi) + a_5 exp(4i phi)), a_h = 1 / h^2 of rectangles."""
    harmonics = [1 / h**2 if h % 2 else 0.0 for h in range(2, 6)]
    rates, opl = scene(phi / (2 * np.pi * F) * SPEED_OF_LIGHT, 1.0, bins=4000, width=0.005)
    camera = Itof(frequencies_hz=F, contrast=0.7, harmonics=harmonics)
    phi = 2 * np.pi * F * opl / SPEED_OF_LIGHT
    phase = camera.depth(camera.expected(rates))["phase"].item()
    error = np.angle(np.exp(1j * (phase - phi)))
    exact = np.angle(1 + np.exp(-4j * phi) / 9 + np.exp(4j * phi) / 25)
    assert error == pytest.approx(exact, abs=1e-9)
    eight = Itof(frequencies_hz=F, taps=8, contrast=0.7, harmonics=harmonics)
    assert eight.depth(eight.expected(rates))["phase"].item() == pytest.approx(phi)


def test_two_returns():
    """arg(1 + r exp(i delta)): r .35, delta 1.9 gives .357422."""
    period = SPEED_OF_LIGHT / F
    rates = np.zeros((1, 1, 20000))
    width = period / 20000
    rates[0, 0, 5000] = 1.0
    rates[0, 0, 5000 + round(1.9 / (2 * np.pi) * 20000)] = 0.35
    camera = Itof(frequencies_hz=F)
    frames = camera.expected(rates, bin_width_opl=width)
    phase = camera.depth(frames)["phase"].item() - 2 * np.pi * 5000.5 / 20000
    assert phase == pytest.approx(0.357422, abs=1e-4)
    assert phase == pytest.approx(multipath_phase_error(0.35, 1.9), abs=1e-4)


# The angle of these taps is -1e-17, so that the angle plus 2 pi rounds to 2 pi.
NEARLY_A_TURN = np.array([1e17, 0.0, 0.0, 1.0])


def test_phases_of_demodulate_are_below_a_turn():
    _, phase = demodulate(NEARLY_A_TURN, 0.5)
    assert 0 <= phase < 2 * np.pi
    _, phases = demodulate(np.stack([NEARLY_A_TURN, [1, 2, 3, 2], [1, 0, 1, 2]], axis=1), 0.5)
    assert phases == pytest.approx([0, np.pi, 3 * np.pi / 2])


@pytest.mark.parametrize("difference", [np.pi, -np.pi, 3 * np.pi])
def test_a_second_return_in_antiphase(difference):
    """The error is in (-pi, pi]: 0 if the second return is weaker, and pi if it is stronger."""
    assert multipath_phase_error(2, difference) == pytest.approx(np.pi)
    assert multipath_phase_error(0.5, difference) == pytest.approx(0)


@pytest.mark.parametrize("turn", [0.1, 0.45, 0.5, 0.55, 0.9])
def test_phases_of_frames_are_from_minus_pi_to_pi(turn):
    """The phase is in (-pi, pi], and the depth c (phase mod 2 pi) / (4 pi f) in [0, c / 2f)."""
    camera = Itof(frequencies_hz=F)
    angles = 2 * np.pi * (turn - np.arange(4) / 4)
    taps = (1 + 0.5 * np.cos(angles)).reshape(1, 4, 1, 1)
    frames = xr.Dataset({"taps": (("frequency", "tap", "y", "x"), taps)}, {"frequency": [F]})
    found = camera.depth(frames)
    expected = 2 * np.pi * (turn if turn <= 0.5 else turn - 1)
    assert abs(found["phase"].item()) == pytest.approx(abs(expected))
    if turn != 0.5:
        assert found["phase"].item() == pytest.approx(expected)
    assert found["depth"].item() == pytest.approx(turn * SPEED_OF_LIGHT / (2 * F))
    opposite = frames.assign(taps=frames["taps"].copy(data=[[[[1.0]], [[2.0]], [[3.0]], [[2.0]]]]))
    assert camera.depth(opposite)["phase"].item() == np.pi
    near = frames.assign(taps=frames["taps"].copy(data=NEARLY_A_TURN.reshape(1, 4, 1, 1)))
    assert 0 <= camera.depth(near)["depth"].item() < SPEED_OF_LIGHT / (2 * F)


@pytest.mark.statistical
def test_saturation_and_conversion():
    """Each tap saturates before the subtraction. Codes are rounded, also around 0."""
    rates, _ = scene(0.02, 4000.0, pixels=(2, 2))
    mean = Itof(frequencies_hz=F).expected(rates)["taps"].values[0, :, 0, 0]
    camera = Itof(frequencies_hz=F, full_well=1200.0)
    found = camera.frames(rates, 1, seed=1)
    assert mean[0] > 1400
    assert (found["taps"].values[0, 0] == 1200.0).all()
    assert (found["taps"].values[0, 1:] < 1200.0).all()
    assert found["saturated"].values.all()
    assert np.isnan(camera.depth(found)["depth"].values).all()
    ramp = Itof(frequencies_hz=F, full_well=1023.0, adc_bits=8, read_noise=9.0)
    empty = scene(0.02, 0.0, pixels=(64, 64))[0]
    taps = ramp.frames(empty, 1)["taps"].values
    steps = taps / (1023 / 255)
    assert steps == pytest.approx(np.rint(steps), abs=1e-6)
    assert agree(taps.ravel(), np.full((), 1e-9), rounding=0)
    long = Itof(frequencies_hz=F).frames(rates, 2**31 - 1)["taps"].values[0, :, 0, 0]
    assert long / (2**31 - 1) == pytest.approx(mean, rel=1e-4)


def test_one_saturated_frequency_makes_a_pixel_saturated():
    rates, _ = scene(1.0, 400_000.0, pixels=(2, 3))
    camera = Itof(frequencies_hz=[20e6, 70e6], full_well=147_700.0)
    found = camera.frames(rates, 1, seed=4)
    largest = found["taps"].values.max(axis=1)
    assert (largest[0] < 147_700.0).all()
    assert (largest[1] == 147_700.0).all()
    assert found["saturated"].values.all()
    assert np.isnan(camera.depth(found)["depth"].values).all()


def failure_rate(stds, frequencies):
    """Two periods, f_1 : f_2 = a : b, are found if |b e_1 - a e_2| < pi."""
    ratio = Fraction(frequencies[0] / frequencies[1]).limit_denominator(100)
    spread = np.hypot(ratio.denominator * stds[0], ratio.numerator * stds[1])
    return erfc(np.pi / np.sqrt(2) / spread)


@pytest.mark.statistical
@pytest.mark.parametrize("signal", [160.0, 230.0])
def test_unwrapping_fails_as_often_as_predicted(signal):
    """Frequencies of 50 and 60 MHz at 4 m: wrong periods, over the range c / 2 gcd."""
    frequencies = (50e6, 60e6)
    rates, opl = scene(8.0, signal, pixels=(200, 200), bins=500, width=0.02)
    camera = Itof(frequencies_hz=frequencies, contrast=0.5)
    depth = camera.depth(camera.frames(rates, 1, seed=3))["depth"].values
    std = np.sqrt(2 / signal) / 0.5
    wrong = (np.abs(depth - opl / 2) > 0.6).ravel().astype(float)
    rate = failure_rate((std, std), frequencies)
    assert 1e-3 < rate < 0.3
    assert agree(wrong, np.array(rate), rounding=0.05)  # Phases are normal to first order
    assert not agree(wrong, np.array(failure_rate((std, std), (40e6, 60e6))), rounding=0.05)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"taps": 2}, "taps = 2"),
        ({"contrast": 1.2}, "contrast = 1.2"),
        ({"contrast": 1.0, "harmonics": (0.0, 0.5)}, "harmonics = .* no light is negative"),
        ({"adc_bits": 8}, "full_well = None:"),
        ({"frequencies_hz": []}, r"frequencies_hz = \[\]"),
        ({"read_noise": np.nan}, "read_noise = nan"),
    ],
)
def test_bad_parameters(given, text):
    refused(text, Itof, **{"frequencies_hz": F} | given)


def test_bad_frames():
    rates, _ = scene(1.0, 1.0)
    frames = Itof(frequencies_hz=F).expected(rates)
    refused("frames", Itof(frequencies_hz=F, taps=5).depth, frames)
    refused("of this camera's frequencies", Itof(frequencies_hz=2.5 * F).depth, frames)
    odd = Itof(frequencies_hz=[20e6, 51.2345e6])  # Their phases repeat after 300 km
    assert odd.depth(odd.expected(rates))["depth"].values < 12e3
    refused("max_depth = 1.0:", Itof(frequencies_hz=F).depth, frames, 1.0)
    refused("must be below", Itof(frequencies_hz=4e9).expected, rates)
