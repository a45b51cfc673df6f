"""Estimators against their bounds: pile-up, depth, echoes and false alarms."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from helpers.support import ALPHA, COMPARISONS, agree, refused, smallest_allowed
from scipy.ndimage import correlate1d
from scipy.stats import binom, norm

from tofrender.sensors import (
    Response,
    Spad,
    coates,
    coates_variance,
    depth_bound,
    echo_bounds,
    echoes,
    estimate_depth,
    false_alarms,
    pile_up,
)
from tofrender.sensors.jitter import kernel
from tofrender.sensors.pile_up_checks import check_pile_up
from tofrender.sensors.response import distribution
from tofrender.signals.pulses import GaussianPulse, SampledPulse
from tofrender.signals.units import SPEED_OF_LIGHT

WIDTH = 0.02
SIGMA = 3 * WIDTH
GAUSS = Response(SIGMA / SPEED_OF_LIGHT)
WIDE = Response(0.1)
LATE = Response(SIGMA / SPEED_OF_LIGHT, 2 * SIGMA / SPEED_OF_LIGHT)
BINS = 120


def histograms(response, signal, background, count=2000, seed=1, bins=BINS):
    """Return counts (1, count, bin) of returns anywhere in a bin, and their path lengths [m]."""
    rng = np.random.default_rng(seed)
    position = (bins // 2 + rng.random(count)) * WIDTH
    masses = np.diff(
        distribution("response", response).cdf(np.arange(bins + 1) * WIDTH - position[:, None])
    )
    return rng.poisson(signal * masses + background)[None], position


@pytest.mark.statistical
def test_coates_undoes_pile_up():
    """Mean rate, variance (exp(rate) - 1) / (M exp(-sum before)), and uncorrelated bins."""
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
    """sigma / (2 sqrt S); bins add w^2 / 24 sigma^2; large background: S^2 / (4 sqrt(pi) s^3 b)."""
    fine = WIDTH / 20
    assert depth_bound(100.0, 0.0, GAUSS, fine) == pytest.approx(SIGMA / 20, rel=1e-3)
    ratio = depth_bound(1.0, 0.0, GAUSS, WIDTH) / (SIGMA / 2)
    assert ratio**2 == pytest.approx(1 + WIDTH**2 / (12 * SIGMA**2), rel=1e-3)
    density = 1e6  # Counts per meter
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
    found = estimate_depth(counts, response, method, start_opl=0.0, bin_width_opl=WIDTH)
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
    """They reach 1.2 times the bound where they are nearly maximum likelihood."""
    error, _ = rms(response, 300, background, method)
    assert np.sqrt((error**2).mean()) < limit * depth_bound(300, background, response, WIDTH)
    assert abs(error.mean()) < 5e-2 * SIGMA


def test_depth_from_a_sensor():
    """A complete chain finds the wall at 1.23 m on the time axis of the Dataset."""
    rates = np.zeros((2, 3, 200))
    rates[..., 100:] = 1e-4
    jitter = Response(60e-12, 80e-12)
    rates[..., 123] = 0.3
    counts = Spad(jitter=jitter).histogram(rates, 5000, 1, bin_width_opl=WIDTH)
    found = estimate_depth(counts, jitter)
    assert found["depth"].values == pytest.approx(123.5 * WIDTH / 2, abs=2e-3)
    assert (found["depth_std"].values < 5e-4).all()
    later, both = slice(40, None), counts.isel(x=slice(2))
    parts = (counts.isel(bin=later), counts.transpose("bin", "x", "y"), both)
    for part in parts:  # Bins are where their coordinate says
        again = estimate_depth(part, jitter)["depth"]
        assert again.values == pytest.approx(123.5 * WIDTH / 2, abs=4e-3)
    refused("counts: the bins are not cons", estimate_depth, counts.isel(bin=[0, 1, 9]), jitter)
    refused("2 m wide.* tofrender.rebin", estimate_depth, counts.coarsen(bin=2).sum(), jitter)


def test_a_responses_origin_is_no_matter():
    """A response recorded at 1 m delays all counts by 1 m, but is not longer."""
    masses = np.diff(norm.cdf(np.arange(-50, 51) * WIDTH, scale=SIGMA))
    rng = np.random.default_rng(3)
    light = np.zeros(400)
    light[[150, 180]] = 300, 200
    rates = np.convolve(light, masses, "same") + 0.2
    counts = rng.poisson(rates, (5, 5, 400))
    for late in (0, 50):
        recorded = SampledPulse(masses / WIDTH, (late - 50) * WIDTH, WIDTH)
        seen = np.roll(counts, late, axis=-1)
        found = echoes(seen, recorded, start_opl=0.0, bin_width_opl=WIDTH)
        assert found["number"].values.tolist() == [1, 2] * 25
        assert found["opl"].values[::2] == pytest.approx(np.full(25, 150.5 * WIDTH), abs=0.03)
        depth = estimate_depth(seen, recorded, "centroid", start_opl=0.0, bin_width_opl=WIDTH)[
            "depth"
        ]
        assert abs(depth.values - 150.5 * WIDTH / 2).max() < 0.02


@pytest.mark.statistical
@pytest.mark.parametrize("opl", [0.05, BINS * WIDTH - 0.05])
def test_the_likeliest_depth_at_an_end_of_the_window(opl):
    rates = 300 * np.diff(norm.cdf(np.arange(BINS + 1) * WIDTH, opl, SIGMA)) + 0.2
    counts = np.random.default_rng(4).poisson(rates, (1, 400, BINS))
    found = estimate_depth(counts, GAUSS, start_opl=0.0, bin_width_opl=WIDTH)[
        "depth"
    ].values.ravel()
    assert agree(found, np.array(opl / 2), rounding=0.01)
    dark = estimate_depth(np.zeros((1, 1, BINS)), GAUSS, start_opl=0.0, bin_width_opl=WIDTH)
    assert np.isnan(dark["depth"].item())
    assert np.isinf(dark["depth_std"].item())


@pytest.mark.statistical
def test_echoes():
    """Two returns: position, intensity and width, with the mean S and the variance S + b n."""
    rng = np.random.default_rng(2)
    lags = np.arange(300)[:, None] + [0, 1]
    masses = [np.diff(norm.cdf((lags - at) / 3)).T[0] for at in (80.5, 200.5)]
    counts = rng.poisson(200 * masses[0] + 60 * masses[1] + 0.2, (40, 50, 300))
    found = echoes(counts, GAUSS, start_opl=0.0, bin_width_opl=WIDTH)
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


@pytest.mark.parametrize("opl", [15.15, 15.26])
def test_echoes_of_an_asymmetric_pulse_are_where_it_is_0(opl):
    """The mean of the counts comes later than the return, by the mean of the pulse."""
    pulse = SampledPulse([8.0, 4.0, 2.0, 1.0, 1.0], start_opl=-0.1, bin_width_opl=0.25)
    edges = 1.3 + 0.3 * np.arange(81)
    masses = np.diff([pulse.cdf(edge - opl) for edge in edges])
    counts = np.rint(1e5 * masses).astype(int) + 3
    found = echoes(counts[None, None], pulse, start_opl=1.3, bin_width_opl=0.3)
    assert found["opl"].values == pytest.approx([opl], abs=0.02)


def test_bounds_that_bins_cannot_tell_are_infinite():
    found = echo_bounds(100.0, 0.0, Response(WIDTH / 50 / SPEED_OF_LIGHT), WIDTH)
    assert all(np.isinf(each) for each in found.values())


@pytest.mark.parametrize("response", [GAUSS, LATE])
def test_bounds_of_echoes(response):
    """Against a Fisher matrix by finite differences. For b = 0: s/2 sqrt S, sqrt S, s/sqrt(2 S)."""
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
    """Errors of intensity, width and depth are between their bounds and 1.2 times the bounds."""
    counts, position = histograms(GAUSS, 300, background)
    found = echoes(counts, GAUSS, start_opl=0.0, bin_width_opl=WIDTH)
    assert found.sizes["echo"] == 2000  # Background near a return is no echo, if hardly known
    errors = {"depth": position / 2, "intensity": 300.0, "width": np.median(found["width"])}
    for name, bound in echo_bounds(300.0, background, GAUSS, WIDTH).items():
        rms = np.sqrt(np.mean((found[name].values - errors[name]) ** 2))
        assert 0.9 < rms / bound < 1.2, name


def share_with_echoes(counts, false_alarm, **options):
    """Return the fraction of pixels of counts (1, pixel, bin) with an echo."""
    found = echoes(counts, GAUSS, false_alarm, start_opl=3.0, bin_width_opl=WIDTH, **options)
    return len(set(found["x"].values)) / counts.shape[1]


@pytest.mark.statistical
@pytest.mark.parametrize("known", [True, False], ids=["known", "unknown"])
@pytest.mark.parametrize("asked", [0.1, 0.01, 0.001])
@pytest.mark.parametrize("background", [3e-3, 0.04, 1.0, 20.0])
def test_false_alarms(background, asked, known):
    """Background alone has echoes at the requested rate within a factor of 1.5."""
    count = 20_000
    counts = np.random.default_rng(3).poisson(background, (1, count, BINS))
    given = {"background": background} if known else {}
    found = round(share_with_echoes(counts, asked, **given) * count)
    unlikely = smallest_allowed(ALPHA, COMPARISONS)
    assert binom.sf(found - 1, count, 1.5 * asked) > unlikely
    assert binom.cdf(found, count, asked / 1.5) > unlikely


@pytest.mark.statistical
@pytest.mark.parametrize("known", [True, False], ids=["known", "unknown"])
@pytest.mark.parametrize("background", [0.02, 0.3, 1.6, 1.9, 6.5])
def test_false_alarms_of_a_response_in_one_bin(background, known):
    """Filtered counts are integers, so that each background has a separate threshold."""
    count, bins, asked = 8000, 500, 0.1
    counts = np.random.default_rng(3).poisson(background, (1, count, bins))
    given = {"background": background} if known else {}
    axis = {"start_opl": 2.0, "bin_width_opl": 0.1}
    table = echoes(counts, GaussianPulse(0.01), asked, **axis, **given)
    found = len(set(table["x"].values))
    unlikely = smallest_allowed(ALPHA, COMPARISONS)
    assert binom.sf(found - 1, count, 1.1 * asked) > unlikely
    assert binom.cdf(found, count, asked / 1.1) > unlikely


@pytest.mark.parametrize("known", [True, False], ids=["known", "unknown"])
def test_many_backgrounds_are_simulated_in_short_pixels(known, monkeypatch):
    """A threshold needs as many simulated bins for a long window as for a short window."""
    simulated = []
    draw = false_alarms._histograms

    def count_bins(number, at, bins):
        simulated.append(number.size * bins)
        return draw(number, at, bins)

    monkeypatch.setattr(false_alarms, "_histograms", count_bins)
    false_alarms._simulated.cache_clear()
    counts = np.random.default_rng(3).poisson(3e-3, (4, 3, 4000))
    given = {"background": 3e-3} if known else {}
    echoes(counts, GAUSS, 0.01, start_opl=2.0, bin_width_opl=WIDTH, **given)
    assert simulated
    assert max(simulated) <= 4e5


@pytest.mark.statistical
@pytest.mark.parametrize("asked", [0.1, 0.01, 0.001])
@pytest.mark.parametrize(
    ("background", "signal"), [(1e-4, 1.5), (1e-4, 5.1), (0.02, 5.0), (1.0, 16.0), (20.0, 50.0)]
)
def test_weak_echoes_are_detected(background, signal, asked):
    """As many echoes are found as by the likelihood-ratio detector with an empirical threshold."""
    empty = np.random.default_rng(5).poisson(background, (20_000, BINS))
    counts, _ = histograms(GAUSS, signal, background, count=3000)
    masses = kernel(distribution("response", GAUSS), WIDTH, 1e-3)
    weights = np.log1p(signal * masses / background)
    highest, alone = (
        correlate1d(each.astype(float), weights, axis=-1, mode="constant").max(axis=-1)
        for each in (counts[0], empty)
    )
    limit = np.sort(alone)[-round(asked * alone.size)]
    best = np.mean(highest > limit * (1 + 1e-9))
    assert best > 0.05
    found = share_with_echoes(counts, asked, background=background)
    assert found > best - 0.05


def test_light_in_many_places_is_not_in_echoes():
    """Fog above a faint known background has as many echoes as above an unknown background."""
    counts = np.random.default_rng(6).poisson(0.5, (1, 500, 6 * BINS))
    assert share_with_echoes(counts, 0.01, background=1e-4) == share_with_echoes(counts, 0.01)
    assert share_with_echoes(counts, 0.01) < 0.03


def test_seeds_choose_at_the_threshold_only():
    """Equal seeds have equal echoes. Strong echoes do not depend on the seed."""
    counts, _ = histograms(GAUSS, 40, 0.0, count=300)
    counts[0, :100] = np.random.default_rng(7).poisson(3e-3, (100, BINS))
    axis = {"start_opl": 0.0, "bin_width_opl": WIDTH, "background": 3e-3}
    first, again, other = (echoes(counts, GAUSS, 0.1, **axis, seed=seed) for seed in (1, 1, 2))
    assert first.identical(again)
    assert not first.identical(other)
    kept = [each.sel(echo=each["x"] >= 100)["opl"].values for each in (first, other)]
    np.testing.assert_array_equal(*kept)


LATER = 5.0  # Start of the bins [m]


def late_rates():
    """Return rates of a sensor with a window from 5 m, and returns at different path lengths."""
    rates = np.full((2, 3, 200), 1e-4)
    at = np.array([[40, 71, 123], [90, 150, 60]])
    np.put_along_axis(rates, at[..., None], 0.4, axis=-1)
    arrays = {"rate": (("y", "x", "bin"), rates), "background": (("y", "x"), rates[..., 0])}
    axis = {"opl": ("bin", LATER + (np.arange(200) + 0.5) * WIDTH)}
    attrs = {"start_opl": LATER, "bin_width_opl": WIDTH}
    return xr.Dataset(arrays, axis, attrs), (LATER + (at + 0.5) * WIDTH) / 2


def test_labeled_counts_keep_their_time_axis():
    """Depths of counts, corrected rates, parts and records of data sets use their own time axis."""
    rates, depth = late_rates()
    jitter = Response(60e-12)
    measured = Spad(jitter=jitter).histogram(rates, 5000, 1)
    counts = measured["counts"]
    corrected = coates(counts, 5000)
    assert isinstance(corrected, xr.DataArray)
    np.testing.assert_array_equal(corrected["opl"], counts["opl"])
    np.testing.assert_array_equal(corrected.values, coates(counts.values, 5000))
    places = {f"sensor_{dim}": counts["opl" if dim == "bin" else dim].values for dim in counts.dims}
    record = xr.DataArray(counts.values, places, list(places))
    film = counts.swap_dims(bin="opl").drop_vars("bin", errors="ignore")
    values = corrected.fillna(0) * 5000
    for each in (measured, counts, record, film, values, values.isel(bin=slice(20, None))):
        found = estimate_depth(each, jitter)
        assert found["depth"].values == pytest.approx(depth, abs=3e-3)
        table = echoes(each, jitter, 1e-6)
        assert table["depth"].values == pytest.approx(depth.ravel(), abs=3e-3)
    turned = counts.transpose("bin", "x", "y")
    assert coates(turned, 5000).dims == turned.dims
    np.testing.assert_array_equal(coates(turned, 5000).transpose(*counts.dims), corrected)
    variance = coates_variance(corrected.fillna(0), 5000)
    np.testing.assert_array_equal(variance["opl"], counts["opl"])
    assert found["y"].values.tolist() == [0, 1]


def test_arrays_have_the_time_axis_that_is_given():
    rates, depth = late_rates()
    counts = Spad().histogram(rates, 5000, 1)["counts"].values
    axis = {"start_opl": LATER, "bin_width_opl": WIDTH}
    narrow = Response(30e-12)
    assert estimate_depth(counts, narrow, **axis)["depth"].values == pytest.approx(depth, abs=3e-3)
    found = echoes(counts, narrow, **axis)["depth"].values
    assert found == pytest.approx(depth.ravel(), abs=3e-3)


@pytest.mark.parametrize("function", [estimate_depth, echoes])
def test_time_axes_that_are_missing(function):
    counts = np.ones((1, 1, 99))
    refused("start_opl = None", function, counts, GAUSS, bin_width_opl=WIDTH)
    refused("bin_width_opl = None", function, counts, GAUSS, start_opl=0.0)
    bare = xr.DataArray(counts, dims=("y", "x", "bin"))
    refused("needs a coordinate opl", function, bare, GAUSS)
    labeled = bare.assign_coords(opl=("bin", np.arange(99) * WIDTH))
    refused("must be None for labeled counts", function, labeled, GAUSS, start_opl=0.0)
    refused("one time axis", function, bare.rename(bin="time"), GAUSS)
    refused(
        "rates: expected a Dataset of expected_photons, found a DataArray",
        Spad().histogram,
        bare,
        10,
    )


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: coates([-1, 2], 5), "counts = -1:"),
        (lambda: coates([4, 2], 5), "cycles = 5:"),
        (
            lambda: estimate_depth(np.ones((1, 1, 5)), GAUSS, start_opl=0.0, bin_width_opl=WIDTH),
            "shorter than",
        ),
        (
            lambda: estimate_depth(np.ones((5, 5)), GAUSS, start_opl=0.0, bin_width_opl=WIDTH),
            "counts with shape",
        ),
        (
            lambda: estimate_depth(np.ones((1, 1, 99)), 3.0, start_opl=0.0, bin_width_opl=WIDTH),
            "response = 3.0",
        ),
        (
            lambda: echoes(np.ones((1, 1, 99)), GAUSS, 0.9, start_opl=0.0, bin_width_opl=WIDTH),
            "false_alarm = 0.9",
        ),
        (
            lambda: estimate_depth(np.ones((1, 1, 9)), WIDE, start_opl=0.0, bin_width_opl=WIDTH),
            "shorter than",
        ),
        (lambda: depth_bound(-1.0, 0.0, GAUSS, WIDTH), "signal = -1:"),
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
    """The check accepts the functions of the package, and refuses functions without pile-up."""
    right = {each: getattr(pile_up, each) for each in ("first_photon", "coates", "coates_variance")}
    check_pile_up(SimpleNamespace(**right))
    with pytest.raises(AssertionError):
        check_pile_up(SimpleNamespace(**right | {name: wrong}))
