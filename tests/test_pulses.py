"""Pulses: density, cumulative energy and samples say the same, at every edge."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import oracles
import pytest

from tofrender.pulses import GaussianPulse, SampledPulse, convolve

PULSES = {
    "gaussian": GaussianPulse(0.03),
    "wide": GaussianPulse(12.0),
    "narrow": GaussianPulse(1e-4),
    "sampled": SampledPulse([1.0, 0.0, 3.0, 2.0, 0.0], -0.2, 0.125),
    "one bin": SampledPulse([4.0], 1.0, 0.5),
    "convolved": convolve(GaussianPulse(0.03), SampledPulse([1.0, 2.0], 0.0, 0.1)),
}


def grid(pulse, n: int = 4001) -> np.ndarray:
    low, high = pulse.support
    return np.linspace(low - 0.1 * (high - low), high + 0.1 * (high - low), n)


def called(function, t) -> np.ndarray:
    return np.array(function(mi.Float(t)), dtype=np.float64)


@pytest.mark.parametrize("name", PULSES)
def test_density_integrates_to_one_and_to_the_cdf(name):
    pulse = PULSES[name]
    t = grid(pulse)
    density, cdf = called(pulse.eval, t), called(pulse.cdf, t)
    middle = called(pulse.eval, 0.5 * (t[1:] + t[:-1]))
    assert density.min() >= 0
    assert np.sum(middle * np.diff(t)) == pytest.approx(1, abs=2e-3)
    assert np.cumsum(middle * np.diff(t)) == pytest.approx(cdf[1:], abs=2e-3)
    assert np.diff(cdf).min() >= -1e-7
    assert cdf[0] == pytest.approx(0, abs=1e-6)
    assert cdf[-1] == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("name", PULSES)
def test_samples_follow_the_cdf(name):
    """sample is the inverse of cdf: cdf(sample(xi)) = xi, with weight 1."""
    pulse = PULSES[name]
    xi = (np.arange(2048) + 0.5) / 2048
    t, weight = pulse.sample(mi.Float(xi))
    assert np.array(dr.zeros(mi.Float, 2048) + weight) == pytest.approx(np.ones(2048))
    assert np.array(pulse.cdf(t)) == pytest.approx(xi, abs=2e-5)


@pytest.mark.parametrize("name", PULSES)
def test_samples_are_finite_at_both_ends(name):
    """A 24-bit random number is 0 now and then."""
    pulse = PULSES[name]
    xi = [0.0, 2.0**-32, 2.0**-24, 0.5, 1 - 2.0**-24, 1.0]
    t = np.array(pulse.sample(mi.Float(xi))[0])
    low, high = pulse.support
    margin = 0.2 * (high - low)
    assert np.isfinite(t).all()
    assert (t >= low - margin).all()
    assert (t <= high + margin).all()
    assert np.all(np.diff(t) >= 0)


def test_gaussian_values():
    pulse, t = GaussianPulse(0.03), np.linspace(-0.15, 0.15, 101)
    density = np.exp(-0.5 * (t / 0.03) ** 2) / (0.03 * math.sqrt(2 * math.pi))
    assert pulse.normalization == pytest.approx(1 / (0.03 * math.sqrt(2 * math.pi)))
    assert called(pulse.eval, t) == pytest.approx(density, rel=1e-4, abs=1e-6)
    assert called(pulse.cdf, t) == pytest.approx(oracles.gaussian_cdf(t, 0.03), abs=2e-7)


@pytest.mark.statistical
def test_gaussian_moments_of_samples():
    """By the exact stratified numbers: mean 0, variance s², fourth moment 3 s⁴."""
    xi = (np.arange(1 << 16) + 0.5) / (1 << 16)
    t = np.array(GaussianPulse(0.5).sample(mi.Float(xi))[0], dtype=np.float64) / 0.5
    assert t.mean() == pytest.approx(0, abs=1e-4)
    assert (t**2).mean() == pytest.approx(1, abs=1e-3)
    assert (t**4).mean() == pytest.approx(3, abs=0.02)


def test_numbers_are_taken_too():
    for pulse in PULSES.values():
        middle = 0.5 * sum(pulse.support)
        assert float(dr.slice(mi.Float(pulse.cdf(middle)))) >= 0


def test_convolution_of_gaussians_adds_variances():
    assert convolve(GaussianPulse(0.3), GaussianPulse(0.4)).width_opl == pytest.approx(0.5)


def test_convolution_of_bins():
    """Two boxes of widths 1 and 2 make a trapezium."""
    made = convolve(SampledPulse([1.0], 0.0, 1.0), SampledPulse([1.0], 0.5, 2.0))
    t = np.linspace(0.4, 3.6, 33)
    area = np.interp(t, [0.5, 1.5, 2.5, 3.5], [0, 0.25, 0.75, 1])
    ramp = np.where(t < 1.5, 0.25 * np.clip(t - 0.5, 0, 1) ** 2, area)
    ramp = np.where(t > 2.5, 1 - 0.25 * np.clip(3.5 - t, 0, 1) ** 2, ramp)
    assert called(made.cdf, t) == pytest.approx(ramp, abs=2e-3)


@pytest.mark.parametrize("width", [0, -0.1, math.nan, math.inf, "0.1", None, True])
def test_bad_width(width):
    with pytest.raises(ValueError, match=r"width_opl = .*: must be a finite number") as error:
        GaussianPulse(width)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("values", "start", "width", "message"),
    [
        ([], 0, 1, "shape"),
        ([[1.0]], 0, 1, "shape"),
        ([0.0, 0.0], 0, 1, "all are 0"),
        ([1.0, -1.0], 0, 1, "-1"),
        ([1.0, math.nan], 0, 1, "nan"),
        ([1.0], 0, 0, "bin_width_opl = 0"),
        ([1.0], math.inf, 1, "start_opl = inf"),
    ],
)
def test_bad_samples(values, start, width, message):
    with pytest.raises(ValueError, match=message) as error:
        SampledPulse(values, start, width)
    assert "\n" not in str(error.value)
