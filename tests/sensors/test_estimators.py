"""Estimators against their bounds: pile-up, depth, echoes and false alarms."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.support import agree, refused
from scipy.stats import norm

from tofrender.sensors import (
    Response,
    Spad,
    coates,
    coates_variance,
    depth_bound,
    echo_bounds,
    echoes,
    estimate_depth,
    pile_up,
)
from tofrender.sensors.jitter import kernel
from tofrender.sensors.pile_up_checks import check_pile_up
from tofrender.sensors.response import distribution
from tofrender.signals.pulses import SampledPulse
from tofrender.signals.units import SPEED_OF_LIGHT

WIDTH = 0.02
SIGMA = 3 * WIDTH
GAUSS = Response(SIGMA / SPEED_OF_LIGHT)
WIDE = Response(0.1)
LATE = Response(SIGMA / SPEED_OF_LIGHT, 2 * SIGMA / SPEED_OF_LIGHT)
BINS = 120


def histograms(response, signal, background, count=2000, seed=1, bins=BINS):
    """Counts (1, count, bin) of returns anywhere in a bin, and their path lengths [m]."""
    rng = np.random.default_rng(seed)
    position = (bins // 2 + rng.random(count)) * WIDTH
    masses = np.diff(
        distribution("response", response).cdf(np.arange(bins + 1) * WIDTH - position[:, None])
    )
    return rng.poisson(signal * masses + background)[None], position


@pytest.mark.statistical
def test_coates_undoes_pile_up():
    """Mean, variance (exp(rate) - 1) / (M exp(-sum before)) and no correlation of bins."""
    rates = np.array([0.05, 0.3, 1.2, 0.4, 0.1])
    cycles = 100_000
    film = np.broadcast_to(rates, (40, 50, 5))
    counts = Spad().histogram(film, cycles, 3, bin_width_opl=WIDTH)["counts"].values
    found = coates(counts, cycles).reshape(-1, 5)
    assert agree(found, rates, rounding=1e-3)  # Its bias is of the order of 1 / M
    variance = coates_variance(rates, cycles)
    assert agree((found - rates) ** 2, variance, rounding=1e-2)
    assert not agree((found - rates) ** 2, rates / cycles, rounding=1e-2)  # Power
    assert np.abs(np.corrcoef(found.T) - np.eye(5)).max() < 0.1
    assert np.isinf(coates([5, 5], 10)[1])


def test_bound_of_a_gaussian():
    """sigma / (2 sqrt S); bins lose w^2 / 12 sigma^2; much background: S^2 / (4 sqrt(pi) s^3 b)."""
    fine = WIDTH / 20
    assert depth_bound(100.0, 0.0, GAUSS, fine) == pytest.approx(SIGMA / 20, rel=1e-3)
    ratio = depth_bound(1.0, 0.0, GAUSS, WIDTH) / (SIGMA / 2)
    assert ratio**2 == pytest.approx(1 + WIDTH**2 / (12 * SIGMA**2), rel=1e-3)
    density = 1e6  # Counts per metre
    information = 100.0**2 / (4 * np.sqrt(np.pi) * SIGMA**3 * density)
    found = depth_bound(100.0, density * fine, GAUSS, fine)
    assert found == pytest.approx(0.5 / np.sqrt(information), rel=2e-3)
    assert np.isinf(depth_bound([0.0], 1.0, GAUSS, WIDTH)).all()
    e = np.arange(-15, 17) * WIDTH - WIDTH / 2
    p, slope = np.diff(norm.cdf(e / SIGMA)), np.diff(norm.pdf(e / SIGMA) / SIGMA)
    exact = 0.5 / np.sqrt((50.0 * slope) ** 2 @ (1 / (50.0 * p + 3.0)))
    assert depth_bound(50.0, 3.0, GAUSS, WIDTH) == pytest.approx(exact, rel=1e-4)


def rms(response, signal, background, method):
    counts, position = histograms(response, signal, background)
    found = estimate_depth(counts, response, method, bin_width_opl=WIDTH)
    error = found["depth"].values[0] - position / 2
    return error, found["depth_std"].values[0]


@pytest.mark.statistical
@pytest.mark.parametrize("response", [GAUSS, LATE], ids=["gauss", "late"])
@pytest.mark.parametrize(("signal", "background"), [(100, 0.0), (100, 0.5), (1000, 20.0)])
def test_likeliest_depth_reaches_the_bound(response, signal, background):
    error, std = rms(response, signal, background, "ml")
    bound = depth_bound(signal, background, response, WIDTH)
    assert 0.95 * bound < np.sqrt((error**2).mean()) < 1.1 * bound
    assert abs(error.mean()) < 4 * bound / np.sqrt(error.size) + 2e-3 * SIGMA
    assert np.median(std) == pytest.approx(bound, rel=0.1)


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("method", "response", "background", "limit"),
    [
        *[("log_matched", GAUSS, 0.0, 1.2), ("centroid", GAUSS, 0.0, 1.2)],
        *[("log_matched", GAUSS, 0.5, 1.2), ("matched", GAUSS, 0.5, 1.5)],
        *[("centroid", GAUSS, 0.5, 3.0), ("matched", GAUSS, 20.0, 1.2)],
    ],
)
def test_other_methods(method, response, background, limit):
    """They reach 1.2 times the bound where they are the likeliest, or nearly."""
    error, _ = rms(response, 300, background, method)
    assert np.sqrt((error**2).mean()) < limit * depth_bound(300, background, response, WIDTH)
    assert abs(error.mean()) < 5e-2 * SIGMA


def test_depth_from_a_sensor():
    """A whole chain: the wall at 1.23 m is found, in the Dataset's own axis."""
    rates = np.zeros((2, 3, 200))
    rates[..., 100:] = 1e-4
    jitter = Response(60e-12, 80e-12)
    rates[..., 123] = 0.3
    counts = Spad(jitter=jitter).histogram(rates, 5000, 1, bin_width_opl=WIDTH)
    found = estimate_depth(counts, jitter)
    assert found["depth"].values == pytest.approx(123.5 * WIDTH / 2, abs=2e-3)
    assert (found["depth_std"].values < 5e-4).all()
    later, both = slice(40, None), counts.isel(x=slice(2))
    parts = (counts.isel(bin=later), counts.transpose("bin", "x", "y"), both.coarsen(bin=2).sum())
    for part in parts:  # Bins are where their coordinate says
        again = estimate_depth(part, jitter)["depth"]
        assert again.values == pytest.approx(123.5 * WIDTH / 2, abs=4e-3)
    refused("opl = .*: must be the centres", estimate_depth, counts.isel(bin=[0, 1, 9]), jitter)


def test_a_responses_origin_is_no_matter():
    """Recorded at 1 m, it delays all counts by as much, and is no longer for that."""
    masses = np.diff(norm.cdf(np.arange(-50, 51) * WIDTH, scale=SIGMA))
    rng = np.random.default_rng(3)
    light = np.zeros(400)
    light[[150, 180]] = 300, 200
    rates = np.convolve(light, masses, "same") + 0.2
    counts = rng.poisson(rates, (5, 5, 400))
    for late in (0, 50):
        recorded = SampledPulse(masses / WIDTH, (late - 50) * WIDTH, WIDTH)
        seen = np.roll(counts, late, axis=-1)
        found = echoes(seen, recorded, bin_width_opl=WIDTH)
        assert found["number"].values.tolist() == [1, 2] * 25
        assert found["opl"].values[::2] == pytest.approx(np.full(25, 150.5 * WIDTH), abs=0.03)
        depth = estimate_depth(seen, recorded, "centroid", bin_width_opl=WIDTH)["depth"]
        assert abs(depth.values - 150.5 * WIDTH / 2).max() < 0.02


@pytest.mark.statistical
@pytest.mark.parametrize("opl", [0.05, BINS * WIDTH - 0.05])
def test_the_likeliest_depth_at_an_end_of_the_window(opl):
    rates = 300 * np.diff(norm.cdf(np.arange(BINS + 1) * WIDTH, opl, SIGMA)) + 0.2
    counts = np.random.default_rng(4).poisson(rates, (1, 400, BINS))
    found = estimate_depth(counts, GAUSS, bin_width_opl=WIDTH)["depth"].values.ravel()
    assert agree(found, np.array(opl / 2), rounding=0.01)
    dark = estimate_depth(np.zeros((1, 1, BINS)), GAUSS, bin_width_opl=WIDTH)
    assert np.isnan(dark["depth"].item())
    assert np.isinf(dark["depth_std"].item())


@pytest.mark.statistical
def test_echoes():
    """Two returns: position, intensity and width, of mean S and variance S + b n."""
    rng = np.random.default_rng(2)
    lags = np.arange(300)[:, None] + [0, 1]
    masses = [np.diff(norm.cdf((lags - at) / 3)).T[0] for at in (80.5, 200.5)]
    counts = rng.poisson(200 * masses[0] + 60 * masses[1] + 0.2, (40, 50, 300))
    found = echoes(counts, GAUSS, bin_width_opl=WIDTH)
    assert found.sizes["echo"] == pytest.approx(2 * 2000, abs=10)
    kinds = [found.sel(echo=np.abs(found["opl"] - opl) < 0.2) for opl in (1.61, 4.01)]
    size = kernel(distribution("response", GAUSS), WIDTH, 1e-3).size
    for each, opl, signal in zip(kinds, (1.61, 4.01), (200, 60), strict=True):
        assert each.sizes["echo"] > 1990
        intensity = each["intensity"].values
        assert agree(intensity, np.array(float(signal)), rounding=1e-2)
        square = (intensity - intensity.mean()) ** 2
        assert agree(square, np.array(signal + 0.2 * size), rounding=3e-2)
        assert agree(each["opl"].values, np.array(opl), rounding=1e-3)
        assert np.median(each["width"]) == pytest.approx(SIGMA, rel=0.1)
    assert (found["number"].values <= 3).all()


def test_bounds_that_bins_cannot_tell_are_infinite():
    found = echo_bounds(100.0, 0.0, Response(WIDTH / 50 / SPEED_OF_LIGHT), WIDTH)
    assert all(np.isinf(each) for each in found.values())


@pytest.mark.parametrize("response", [GAUSS, LATE])
def test_bounds_of_echoes(response):
    """Against a Fisher matrix by finite differences; b = 0: s/2 sqrt S, sqrt S, s/sqrt(2 S)."""
    shape, b, h = distribution("response", response), 0.7, 1e-4
    edges = (np.arange(-80, 82) - 0.5) * WIDTH

    def means(t, s, a):
        middle = shape.mean()
        return s * np.diff(shape.cdf((edges - t - middle) / (1 + a) + middle)) + b

    steps = np.diag([WIDTH, 50.0, 1.0]) * h
    at = np.array([0.0, 50.0, 0.0])
    slopes = [(means(*(at + d)) - means(*(at - d))) / (2 * d.sum()) for d in steps]
    exact = np.sqrt(np.diag(np.linalg.inv(np.array(slopes) / means(*at) @ np.array(slopes).T)))
    found = echo_bounds([50.0, 0.0], b, response, WIDTH)
    expected = exact * (0.5, 1, shape.std())
    assert [bound[0] for bound in found.values()] == pytest.approx(expected, rel=1e-3)
    assert all(np.isinf(bound[1]) for bound in found.values())
    clear = echo_bounds(100.0, 0.0, GAUSS, WIDTH / 20).values()
    assert list(clear) == pytest.approx([SIGMA / 20, 10, SIGMA / np.sqrt(200)], rel=2e-3)


@pytest.mark.statistical
@pytest.mark.parametrize("background", [0.0, 0.02])
def test_echoes_reach_their_bounds(background):
    """Errors of intensity, width and depth lie between their bounds and 1.2 times these."""
    counts, position = histograms(GAUSS, 300, background)
    found = echoes(counts, GAUSS, bin_width_opl=WIDTH)
    assert found.sizes["echo"] == 2000  # Background near a return is no echo, if hardly known
    errors = {"depth": position / 2, "intensity": 300.0, "width": np.median(found["width"])}
    for name, bound in echo_bounds(300.0, background, GAUSS, WIDTH).items():
        rms = np.sqrt(np.mean((found[name].values - errors[name]) ** 2))
        assert 0.9 < rms / bound < 1.2, name


@pytest.mark.statistical
@pytest.mark.parametrize("background", [0.2, 2.0])
def test_false_alarms(background):
    """No more pixels than asked for have a false return, and with more allowed, some have."""
    counts = np.random.default_rng(3).poisson(background, (100, 100, BINS))
    for allowed, least in ((1e-3, 0.0), (0.05, 1e-4), (0.5, 5e-3)):
        found = echoes(counts, GAUSS, allowed, bin_width_opl=WIDTH)
        pixels = len(set(zip(found["y"].values, found["x"].values, strict=True))) / 1e4
        assert least <= pixels <= allowed


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: coates([-1, 2], 5), "counts = -1: must be at least 0"),
        (lambda: coates([4, 2], 5), "cycles = 5: must be at least the counts of a pixel, 6"),
        (lambda: estimate_depth(np.ones((1, 1, 5)), GAUSS, bin_width_opl=WIDTH), "shorter than"),
        (lambda: estimate_depth(np.ones((5, 5)), GAUSS, bin_width_opl=WIDTH), "counts with shape"),
        (lambda: estimate_depth(np.ones((1, 1, 99)), 3.0, bin_width_opl=WIDTH), "response = 3.0"),
        (lambda: echoes(np.ones((1, 1, 99)), GAUSS, 0.9, bin_width_opl=WIDTH), "false_alarm = 0.9"),
        (lambda: estimate_depth(np.ones((1, 1, 9)), WIDE, bin_width_opl=WIDTH), "shorter than"),
        (lambda: depth_bound(-1.0, 0.0, GAUSS, WIDTH), "signal = -1: must be at least 0"),
    ],
)
def test_bad_input(call, text):
    refused(text, call)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("first_photon", lambda rates: -np.expm1(-rates)),
        ("coates", lambda counts, cycles: counts / cycles),
        ("coates_variance", lambda rates, cycles: rates / cycles),
    ],
)
def test_check_of_pile_up(name, wrong):
    """The check passes the package's functions, and none that forgets pile-up."""
    right = {each: getattr(pile_up, each) for each in ("first_photon", "coates", "coates_variance")}
    check_pile_up(SimpleNamespace(**right))
    with pytest.raises(AssertionError):
        check_pile_up(SimpleNamespace(**right | {name: wrong}))
