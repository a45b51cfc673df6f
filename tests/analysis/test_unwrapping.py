"""Depth beyond the range of one frequency: exact, with noise, at the ends of the range."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from tofrender.analysis import transient_to_phasor, unambiguous_range, unwrap

C = 299_792_458.0


def phases_of(depth, frequencies):
    """Wrapped phases in (-pi, pi] of one path there and back."""
    return np.stack([np.angle(np.exp(4j * np.pi * f * depth / C)) for f in frequencies])


def chances(frequencies, count: int, least: float, seed: int):
    """Phases that fit no depth, amplitudes, and ranges and weights of the frequencies."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(-np.pi, np.pi, (len(frequencies), count))
    amplitudes = 10 ** rng.uniform(least, 0, phases.shape)
    ranges = C / 2 / np.array(frequencies)[:, None]
    weights = (amplitudes / ranges) ** 2 / ((amplitudes / ranges) ** 2).sum(axis=0)
    return phases, amplitudes, ranges, weights


@pytest.mark.parametrize(
    ("frequencies", "hertz"),
    [
        (20e6, 20e6),
        ((20e6, 50e6), 10e6),
        ((20e6, 50e6, 100e6), 10e6),
        ((30e6, 40e6), 10e6),
        ((1e8 / 3, 50e6), 5e7 / 3),
        ((80.32e6, 16.064e6, 120.48e6), 8.032e6),
    ],
)
def test_unambiguous_range(frequencies, hertz):
    assert unambiguous_range(frequencies) == pytest.approx(C / (2 * hertz))


@pytest.mark.parametrize("frequencies", [(20e6, 50e6), (50e6, 20e6), (20e6, 50e6, 100e6)])
def test_unwrap_is_right_beyond_one_range(frequencies):
    depth = np.linspace(0, unambiguous_range(frequencies), 501, endpoint=False).reshape(3, 167)
    found, residual = unwrap(phases_of(depth, frequencies), frequencies)
    assert found == pytest.approx(depth, abs=1e-9)
    assert residual == pytest.approx(np.zeros(depth.shape), abs=1e-9)


@pytest.mark.parametrize("frequencies", [(20e6, 50e6), (20e6, 50e6, 100e6)])
def test_unwrap_with_noise(frequencies):
    """Phase noise s gives depth noise s c / (4 pi f), and less from several frequencies."""
    rng = np.random.default_rng(4)
    depth, noise = rng.uniform(0.5, 14.4, (40, 50)), 0.05
    phases = phases_of(depth, frequencies)
    found, residual = unwrap(phases + rng.normal(0, noise, phases.shape), frequencies)
    k = 4 * np.pi * np.array(frequencies) / C
    expected = noise / np.sqrt((k**2).sum())
    assert np.abs(found - depth).max() < 6 * expected
    assert np.std(found - depth) == pytest.approx(expected, rel=0.1)
    scatter = noise * np.sqrt((len(k) - 1) / (k**2).sum())
    assert np.sqrt((residual**2).mean()) == pytest.approx(scatter, rel=0.1)


@pytest.mark.parametrize("frequencies", [(20e6, 50e6), (20e6, 30e6, 40e6), (90e6, 80e6, 100e6)])
def test_unwrap_finds_the_best_of_all_wrap_counts(frequencies):
    """Of all combinations, for phases that fit no depth at all and amplitudes from 0.01 to 1."""
    phases, amplitudes, ranges, weights = chances(frequencies, 400, -2, seed=0)
    limit = unambiguous_range(frequencies)
    best, least = np.full(400, np.nan), np.full(400, np.inf)
    for wraps in product(*(range(-2, int(limit / r) + 2) for r in ranges[:, 0])):
        each = (phases / (2 * np.pi) + np.array(wraps)[:, None]) * ranges
        mean = (weights * each).sum(axis=0)
        cost = (weights * (each - mean) ** 2).sum(axis=0)
        better = (mean >= 0) & (mean <= limit) & (cost < least)
        best[better], least[better] = mean[better], cost[better]
    depth, residual = unwrap(phases, frequencies, amplitudes=amplitudes)
    assert depth == pytest.approx(best, abs=1e-6)
    assert residual == pytest.approx(np.sqrt(least), abs=1e-6)


def test_unwrap_is_unknown_without_light():
    frequencies = (20e6, 50e6)
    phases = phases_of(np.array([11.0, 11.0, 11.0, np.nan]), frequencies)
    amplitudes = np.array([[1.0, 0.0, 0.0, 1.0], [0.5, 0.0, 1.0, 1.0]])
    depth, residual = unwrap(phases, frequencies, amplitudes=amplitudes)
    assert depth == pytest.approx([11.0, np.nan, np.nan, np.nan], nan_ok=True)
    assert np.isnan(residual).tolist() == [False, True, True, True]


def test_unwrap_takes_the_smaller_of_two_depths_that_fit_equally():
    """Ranges of R/2 and R/5: 20 MHz says R/20 more than 50 MHz, which is R/20 less elsewhere."""
    R = unambiguous_range([20e6, 50e6])
    near = 1.0
    far = near + 3 * R / 5  # 50 MHz has the same phase there; 20 MHz is short of it by R/20
    said = np.array([near + R / 20, near]), np.array([far - R / 20, far])
    phases = np.stack([phases_of(said[0][:1], [20e6])[0], phases_of(said[0][1:], [50e6])[0]])
    again = np.stack([phases_of(said[1][:1], [20e6])[0], phases_of(said[1][1:], [50e6])[0]])
    assert again == pytest.approx(phases)
    depth, residual = unwrap(phases, (20e6, 50e6))
    assert depth.item() == pytest.approx((4 * said[0][0] + 25 * said[0][1]) / 29)
    assert residual.item() == pytest.approx(R / 20 * 10 / 29)


def test_unwrap_of_converted_phasors():
    data = np.zeros((2, 3, 500, 3), np.float32)
    data[:, :, 449] = 0.3
    _, _, amplitude, phase, depth = transient_to_phasor(data, (20e6, 50e6), 0.0, 0.04)
    true = 449.5 * 0.04 / 2
    assert (np.abs(depth - true) > 1).all()
    found, _ = unwrap(phase, (20e6, 50e6), amplitudes=amplitude)
    assert found == pytest.approx(np.full((2, 3, 3), true), abs=1e-9)


@pytest.mark.parametrize("hair", [1e-9, 1e-5, 1e-3, 0.02])
@pytest.mark.parametrize("limit", [3.0, 7.0, 12.0])
def test_phases_a_hair_beyond_an_end_give_that_end(limit, hair):
    """Noise moves a depth of 0 below 0, where no depth may be; it is 0 all the same."""
    frequencies = (20e6, 50e6)
    before = phases_of(np.array([0.0]), frequencies) - hair
    after = phases_of(np.array([limit]), frequencies) + hair
    for phases, end in ((before, 0.0), (after, limit)):
        depth, residual = unwrap(phases, frequencies, limit)
        assert depth.item() == pytest.approx(end, abs=1e-9)
        # Both phases are off by the hair, which 20 MHz takes for more of a way; weights go by f^2
        off = hair * C / (4 * np.pi) * np.sqrt(2 / (20e6**2 + 50e6**2))
        assert residual.item() == pytest.approx(off, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("frequencies", [(20e6, 50e6), (20e6, 50e6, 100e6), (80e6, 50e6)])
def test_unwrap_with_noise_at_the_ends(frequencies):
    rng = np.random.default_rng(11)
    noise, limit = 0.01, 0.47 * unambiguous_range(frequencies)
    depth = np.concatenate([rng.uniform(0, 0.01, 4000), limit - rng.uniform(0, 0.01, 4000)])
    phases = phases_of(depth, frequencies)
    found, _ = unwrap(phases + rng.normal(0, noise, phases.shape), frequencies, limit)
    k = 4 * np.pi * np.array(frequencies) / C
    assert np.abs(found - depth).max() < 6 * noise / np.sqrt((k**2).sum())
    assert found.min() == 0.0
    assert found.max() == limit


@pytest.mark.parametrize("limit", [1.0, 4.0, 7.0])
@pytest.mark.parametrize("frequencies", [(20e6, 50e6), (20e6, 30e6, 40e6)])
def test_unwrap_is_the_likeliest_depth_of_the_range(frequencies, limit):
    """Of all depths from 0 to the limit, a millimetre apart, for phases that fit none at all."""
    phases, amplitudes, ranges, weights = chances(frequencies, 300, -1, seed=2)
    said = phases / (2 * np.pi) * ranges
    depths = np.linspace(0, limit, round(1000 * limit) + 1)[:, None, None]
    off = depths - said - np.rint((depths - said) / ranges) * ranges
    costs = (weights * off**2).sum(axis=1)
    depth, residual = unwrap(phases, frequencies, limit, amplitudes=amplitudes)
    assert residual**2 == pytest.approx(costs.min(axis=0), abs=3e-7)  # (1 mm / 2)^2
    best = np.abs(depth - depths[costs.argmin(axis=0), 0, 0])
    assert np.mean(best < 1e-3) > 0.99  # But where two depths are as likely


@pytest.mark.parametrize(
    ("match", "arguments", "options"),
    [
        ("two or more frequencies", (np.ones((1, 4)), [20e6]), {}),
        ("2 frequencies first", (np.ones((3, 4)), [20e6, 50e6]), {}),
        ("2 frequencies first", (1.0, [20e6, 50e6]), {}),
        ("at most 14.98", (np.ones((2, 4)), [20e6, 50e6], 15.1), {}),
        ("max_depth = 0", (np.ones((2, 4)), [20e6, 50e6], 0), {}),
        ("4096 ranges", (np.ones((2, 4)), [20e6, 20.0001e6]), {}),
        ("amplitudes", (np.ones((2, 4)), [20e6, 50e6]), {"amplitudes": np.ones((2, 3))}),
        ("amplitudes", (np.ones((2, 4)), [20e6, 50e6]), {"amplitudes": -np.ones((2, 4))}),
    ],
)
def test_unwrap_refuses(match, arguments, options):
    with pytest.raises(ValueError, match=rf"\A.*{match}.*\Z"):
        unwrap(*arguments, **options)
