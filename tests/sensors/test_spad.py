"""SPAD arrays against closed forms: means, variances, limits, and the order of the stages."""

import heapq
import re
import tracemalloc

import dask.array as da
import numpy as np
import pytest
import xarray as xr
from helpers.limits import lower
from helpers.support import agree, refused
from scipy.special import erfc

from tofrender.sensors import Response, Spad, events
from tofrender.sensors.dead_time import armed_detections
from tofrender.sensors.jitter import kernel
from tofrender.sensors.photon_rates import Block
from tofrender.sensors.pile_up import first_photon
from tofrender.sensors.response import distribution
from tofrender.sensors.sensor_config import read_sensor
from tofrender.signals.pulses import SampledPulse
from tofrender.signals.units import SPEED_OF_LIGHT

WIDTH = 0.03
BIN_S = WIDTH / SPEED_OF_LIGHT
FEW = np.array([0.05, 0.3, 1.2, 0.4, 0.1])
PEAK = 0.02 + 0.8 * np.exp(-0.5 * ((np.arange(24) - 9) / 2.0) ** 2)


def pixels(rates, rows=16, columns=64):
    """Return the same rates in many pixels, each an independent sample."""
    return np.broadcast_to(rates, (rows, columns, len(rates)))


def counts(spad, rates, cycles, seed=1):
    """Return histograms (pixel, bin) of many equal pixels."""
    found = spad.histogram(pixels(rates), cycles, seed, bin_width_opl=WIDTH)["counts"].values
    return found.reshape(-1, found.shape[-1]).astype(np.float64)


def stamps(spad, rates, cycles, seed=2):
    """Return the same histograms from tables of photons."""
    table = spad.photons(pixels(rates), cycles, seed, bin_width_opl=WIDTH)
    shape = (16 // spad.macro_pixel[0], 64 // spad.macro_pixel[1], len(rates))
    cell = np.ravel_multi_index([table[name].values for name in ("y", "x", "bin")], shape)
    return np.bincount(cell, minlength=np.prod(shape)).reshape(-1, len(rates)).astype(np.float64)


def agree_twice(samples, mean, variance):
    """Compare means and variances."""
    square = (samples - samples.mean(axis=0)) ** 2 * len(samples) / (len(samples) - 1)
    return agree(samples, np.asarray(mean)) and agree(square, np.asarray(variance))


def periodic(rates, dead):
    """Return the stationary histogram of a free-running SPAD by Rapp and Goyal's Markov chain."""
    bins = len(rates)
    chain = np.zeros((bins, bins))
    for s in range(bins):
        since = 0.0  # Rates since the detector is armed, after s
        for x in np.arange(s + 1 + dead, s + 1 + dead + bins) % bins:
            chain[s, x] = np.exp(-since) * -np.expm1(-rates[x]) / -np.expm1(-rates.sum())
            since += rates[x]
    stationary = np.linalg.matrix_power(chain, 1 << 12)[0]
    periods = sum(
        stationary[s] * (1 + dead + np.exp(-_armed(rates, s, dead)).sum()) for s in range(bins)
    )
    return stationary * bins / periods  # Detections per period


def _armed(rates, s, dead, most=40):
    """Return sums of rates from the first armed bin after s up to each bin, for many periods."""
    after = np.tile(rates, most)[(np.arange(1, len(rates) * (most - 2)) + s + dead)]
    return np.cumsum(after)


@pytest.mark.statistical
@pytest.mark.parametrize("draw", [counts, stamps])
@pytest.mark.parametrize("rates", [FEW, PEAK], ids=["few", "peak"])
def test_first_photon(draw, rates):
    """P_k = exp(-sum before) (1 - exp(-rate)): counts of all cycles are multinomial."""
    p, cycles = first_photon(rates), 500
    assert p[:5] == pytest.approx([0.048771, 0.246541, 0.49244, 0.069974, 0.013539], abs=5e-7) or (
        rates is PEAK
    )
    samples = draw(Spad(), rates, cycles)
    assert agree_twice(samples, cycles * p, cycles * p * (1 - p))
    total = samples.sum(axis=1)
    assert agree_twice(total, cycles * p.sum(), cycles * p.sum() * (1 - p.sum()))
    assert not agree(samples, cycles * rates)  # Power


@pytest.mark.statistical
@pytest.mark.parametrize("draw", [counts, stamps])
@pytest.mark.parametrize("mode", ["multi_hit", "free_running"])
def test_no_dead_time_is_poisson(draw, mode):
    assert agree_twice(draw(Spad(mode=mode), PEAK, 40), 40 * PEAK, 40 * PEAK)


@pytest.mark.statistical
def test_low_flux_is_linear():
    rates = 1e-4 * PEAK
    for mode, dead in (("first_photon", 0.0), ("multi_hit", 3.2 * BIN_S)):
        expected = Spad(mode=mode, dead_time_s=dead).expected(
            rates[None, None], bin_width_opl=WIDTH
        )
        assert expected["counts"].values[0, 0] == pytest.approx(rates, rel=2e-3)


@pytest.mark.statistical
@pytest.mark.parametrize("paralysable", [False, True])
@pytest.mark.parametrize("r", [3.0, 0.7])
def test_dead_time_at_constant_rate(paralysable, r):
    """Rate r/(1 + r tau) or r exp(-r tau), and their variances, in the limit of fine bins.

    A dead time starts anywhere in its bin. Therefore tau is half a bin longer than its whole bins.
    """
    tau, bins, cycles = 0.2, 4000, 9
    w = tau / 79.5
    spad = Spad(mode="free_running", dead_time_s=79 * BIN_S, paralysable=paralysable)
    samples = counts(spad, np.full(bins, r * w), cycles).sum(axis=1)
    total, other = bins * w * cycles, r * bins * w * cycles / (1 + r * tau)
    mean, variance = other, r * total / (1 + r * tau) ** 3
    if paralysable:
        m = r * np.exp(-r * tau)
        mean, variance = m * total, m * total - m**2 * tau * (2 * total - tau)
    assert agree(samples, np.array(mean), rounding=2e-3)
    square = (samples - samples.mean()) ** 2 * len(samples) / (len(samples) - 1)
    assert agree(square, np.array(variance), rounding=5e-3)
    assert not agree(samples, np.array(r * total), rounding=2e-3)  # Power


@pytest.mark.statistical
@pytest.mark.parametrize("dead", [2, 7])
def test_free_running_histogram_is_stationary(dead):
    """After a detection, the detector is armed T_d bins later (Rapp and Goyal's matrix)."""
    spad = Spad(mode="free_running", dead_time_s=dead * BIN_S)
    exact = periodic(PEAK, dead)
    expected = spad.expected(PEAK[None, None], bin_width_opl=WIDTH)["counts"].values[0, 0]
    assert expected == pytest.approx(exact, rel=1e-6)
    assert agree(counts(spad, PEAK, 300), 300 * exact, rounding=1e-2)


@pytest.mark.statistical
@pytest.mark.parametrize("paralysable", [False, True])
@pytest.mark.parametrize("draw", [counts, stamps])
def test_armed_at_the_start_of_cycles(paralysable, draw):
    """Counts of a bin over all cycles are binomial, independent of other bins."""
    spad = Spad(mode="multi_hit", dead_time_s=4 * BIN_S, paralysable=paralysable)
    p = armed_detections(PEAK[None], 4, paralysable=paralysable, periodic=False)[0]
    assert agree_twice(draw(spad, PEAK, 60), 60 * p, 60 * p * (1 - p))


IRF = SampledPulse([0.25, 0.5, 0.25], -1.5 * WIDTH, WIDTH)


@pytest.mark.statistical
def test_jitter_comes_after_detection():
    """Jitter of stamps (.25, .5, .25) gives .32535 in the third bin, jitter of light .30728."""
    spad = Spad(jitter=IRF)
    p = spad.expected(FEW[None, None], bin_width_opl=WIDTH)["counts"].values[0, 0]
    assert p[2] == pytest.approx(0.32535, abs=5e-6)
    before = first_photon(np.convolve(FEW, [0.25, 0.5, 0.25], mode="same"))
    assert before[2] == pytest.approx(0.30728, abs=5e-6)
    for draw in (counts, stamps):
        samples = draw(spad, FEW, 500)
        assert agree_twice(samples, 500 * p, 500 * p * (1 - p))
        assert not agree(samples, 500 * before)  # Power


@pytest.mark.parametrize("width", [0.5 * WIDTH, 0.2 * WIDTH])
def test_response(width, tmp_path):
    """Mean tau and variance sigma^2 + tau^2, towards later stamps; also from a file."""
    response = distribution("jitter", Response(sigma_s=2 * BIN_S, tail_s=3 * BIN_S))
    masses = kernel(response, width)
    lags = (np.arange(masses.size) - masses.size // 2) * width
    mean = masses @ lags
    assert mean == pytest.approx(3 * WIDTH, rel=1e-4)
    exact = 13 * WIDTH**2 + width**2 / 12  # Sheppard
    assert masses @ (lags - mean) ** 2 == pytest.approx(exact, rel=1e-3)
    s, a = 2 * WIDTH, 3 * WIDTH
    t = np.linspace(-3 * s, 6 * s, 50)
    formula = np.exp(s * s / (2 * a * a) - t / a) / (2 * a)
    formula *= erfc((s / a - t / s) / np.sqrt(2))
    assert response.pdf(t) == pytest.approx(formula, rel=1e-9)
    slopes = (response.cdf(t + 1e-6) - response.cdf(t - 1e-6)) / 2e-6
    assert slopes == pytest.approx(formula, rel=1e-5)
    path = tmp_path / "irf.csv"
    path.write_text("\n".join(f"{x},{p}" for x, p in zip(lags, masses, strict=True)))
    read = kernel(distribution("jitter", SampledPulse.from_file(path)), width)
    more = masses.size // 2 - read.size // 2
    assert np.pad(read, max(more, 0)) == pytest.approx(np.pad(masses, max(-more, 0)), abs=1e-5)


@pytest.mark.statistical
def test_afterpulses_follow_the_dead_time():
    """Each detection causes p / (1 - p) afterpulses, at exponential times after the dead time."""
    rates = np.zeros(200)
    rates[0] = 0.02
    p, mean = 0.2, 20
    spad = Spad(
        mode="multi_hit",
        dead_time_s=10 * BIN_S,
        afterpulse_probability=p,
        afterpulse_time_s=mean * BIN_S,
    )
    samples = counts(spad, rates, 4000)
    detections = 4000 * -np.expm1(-0.02)
    first = np.zeros(40)
    first[11:] = np.exp(-np.arange(29) / mean) * -np.expm1(-1 / mean) * p
    second = np.convolve(first, first)[:40]
    assert agree(samples[:, 1:40], detections * (first + second)[1:])
    assert agree(samples.sum(axis=1), np.array(detections / (1 - p)), rounding=1e-3)


DEAD, PROBABILITY, MEAN_DELAY = 10, 0.5, 5.0
UNEVEN = 0.2 + 0.1 * np.sin(np.arange(60) / 5)


def one_by_one(rng, cycles, free, paralysable):
    """Return the histogram of a pixel, with avalanches simulated one by one in order of time."""
    found = np.zeros(UNEVEN.size)
    photons = rng.poisson(UNEVEN, (cycles, UNEVEN.size))
    every = [photons.ravel()] if free else photons
    for each in every:
        waiting = np.repeat(np.arange(each.size), each).tolist()
        blocked_until = -1
        while waiting:
            time = heapq.heappop(waiting)
            is_armed = time > blocked_until
            if is_armed or paralysable:
                blocked_until = time + DEAD
            if is_armed:
                found[time % UNEVEN.size] += 1
                caused = time + DEAD + 1 + int(rng.exponential(MEAN_DELAY))
                if rng.random() < PROBABILITY and caused < each.size:
                    heapq.heappush(waiting, caused)
    return found


@pytest.mark.statistical
@pytest.mark.parametrize("paralysable", [False, True])
@pytest.mark.parametrize(
    ("mode", "chunk"), [("multi_hit", 1 << 20), ("free_running", 1 << 20), ("free_running", 700)]
)
def test_afterpulses_at_high_probability(mode, chunk, paralysable, monkeypatch):
    """Histograms agree with a simulation of avalanches: masked avalanches cause no afterpulses."""
    lower(monkeypatch, spad_events=chunk)  # 700 avalanches are one or two cycles
    spad = Spad(
        mode=mode,
        dead_time_s=DEAD * BIN_S,
        paralysable=paralysable,
        afterpulse_probability=PROBABILITY,
        afterpulse_time_s=MEAN_DELAY * BIN_S,
    )
    cycles = 50
    samples = counts(spad, UNEVEN, cycles, seed=11)
    rng = np.random.default_rng(12)
    free = mode == "free_running"
    exact = np.array([one_by_one(rng, cycles, free, paralysable) for _ in samples])
    assert agree(samples - exact + 1, np.ones(UNEVEN.size))
    totals, exact_totals = samples.sum(axis=1), exact.sum(axis=1)
    assert agree(totals - exact_totals + 1, np.array(1.0))
    off = 1.05 if paralysable else 1.015
    assert not agree(off * totals - exact_totals + 1, np.array(1.0))  # Power


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"paralysable": True},
        {"macro_pixel": (2, 2), "coincidence": 2, "coincidence_window_s": 4 * BIN_S},
        {"macro_pixel": (2, 4), "coincidence": 3, "coincidence_window_s": 9 * BIN_S},
    ],
)
def test_chunks_of_cycles_change_nothing(given, monkeypatch):
    """The same photons are detected for all divisions of a free-running SPAD's cycles."""
    rows, cycles, bins = 4, 30, 24
    layout = events.KeyLayout(
        (8, cycles, bins), 11, round(given.get("coincidence_window_s", 0) / BIN_S), True
    )
    spad = Spad(mode="free_running", dead_time_s=11 * BIN_S, **given)
    photons = np.random.default_rng(8).poisson(0.15, (rows, 8, cycles * bins))
    begun = {}

    def arrivals(rng, rates, chunk):
        row = int(rates[0, 0])
        first = begun.get(row, 0)
        begun[row] = first + chunk.cycles * bins
        pixel, time = np.nonzero(photons[row, :, first : begun[row]])
        keys = np.repeat(pixel * chunk.pixel_stride + time, photons[row, pixel, first + time])
        return keys

    monkeypatch.setattr(events, "arrivals", arrivals)
    values = np.broadcast_to(np.arange(rows, dtype=float)[:, None, None], (rows, 8, bins))
    found = []
    for chunk in (1 << 40, 1):
        lower(monkeypatch, spad_events=chunk)
        begun.clear()
        stamps = []
        for row, first, part, keys in events.detections(
            spad, Block(values, 0, range(rows)), layout, 1, BIN_S
        ):
            pixel, cycle, at = part.parts(keys)
            stamps += zip([row] * keys.size, pixel, (first + cycle) * bins + at, strict=True)
        found.append(sorted(stamps))
    assert len(found[0]) > 50
    assert found[0] == found[1]


def test_memory_does_not_grow_with_cycles(monkeypatch):
    lower(monkeypatch, spad_events=20_000)
    spad = Spad(
        mode="free_running", dead_time_s=3 * BIN_S, afterpulse_probability=0.1,
        afterpulse_time_s=5 * BIN_S, crosstalk_probability=0.1,
    )  # fmt: skip
    rates = np.full((2, 8, 24), 0.04)
    peaks, found = [], []
    for cycles in (3000, 24_000):
        tracemalloc.start()
        found.append(spad.histogram(rates, cycles, 1, bin_width_opl=WIDTH)["counts"].values.sum())
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert found[1] == pytest.approx(8 * found[0], rel=0.01)
    assert peaks[1] < 1.3 * peaks[0]


@pytest.mark.statistical
def test_crosstalk_goes_to_neighbors():
    rates = np.zeros((24, 24, 3))
    rates[1::4, 1::4, 1] = 0.5
    spad = Spad(mode="multi_hit", dead_time_s=BIN_S, crosstalk_probability=0.2)
    found = spad.histogram(rates, 2000, 3, bin_width_opl=WIDTH)["counts"].values.astype(float)
    detections = 2000 * -np.expm1(-0.5)
    for y, x in ((0, 1), (2, 1), (1, 0), (1, 2)):
        assert agree(found[y::4, x::4, 1].ravel(), np.array(0.05 * detections))
    assert agree(found[1::4, 1::4, 1].ravel(), np.array(detections))
    assert found[0::4, 0::4].sum() == found[..., 0].sum() == 0


@pytest.mark.statistical
@pytest.mark.parametrize("window", [0, 1])
def test_coincidence_of_two(window):
    """Both SPADs must detect in the same bin, or also in neighboring bins."""
    p = 1 - np.exp(-0.1)
    spad = Spad(
        mode="multi_hit",
        dead_time_s=2.2 * BIN_S,
        macro_pixel=(1, 2),
        coincidence=2,
        coincidence_window_s=window * BIN_S,
    )
    rates = np.array([0.0, 0.1, 0.1, 0.0, 0.0])
    samples = counts(spad, rates, 2000)
    same, later = p * p, 2 * p * p * (1 - p) if window else p * p * (1 - p) ** 2
    exact = np.array([0, same, later + (same * (1 - p) ** 2 if window else 0), 0, 0])
    assert agree(samples, 2000 * exact)
    joined = counts(Spad(macro_pixel=(2, 2)), FEW, 500)
    assert agree(joined, 500 * first_photon(4 * FEW))


@pytest.mark.statistical
def test_converter():
    """Codes cover several bins, have unequal widths, and stamps after the last code are lost."""
    merged = Spad(tdc_lsb_s=4 * BIN_S, tdc_bits=2)
    p = first_photon(PEAK).reshape(-1, 4).sum(axis=1)[:4]
    found = merged.histogram(pixels(PEAK), 300, bin_width_opl=WIDTH)
    assert agree(found["counts"].values.reshape(-1, 4).astype(float), 300 * p)
    assert found["opl"].values == pytest.approx((np.arange(4) + 0.5) * 4 * WIDTH)
    assert found.attrs["bin_width_opl"] == pytest.approx(4 * WIDTH)
    uneven = Spad(mode="multi_hit", tdc_dnl=0.2, device_seed=3)
    flat = uneven.expected(np.full((1, 1, 400), 0.01), bin_width_opl=WIDTH)["counts"].values
    assert flat.sum() == pytest.approx(4.0)
    assert flat.std() / flat.mean() == pytest.approx(0.2, rel=0.2)
    rates = np.full(24, 0.05)
    exact = Spad(mode="multi_hit", tdc_dnl=0.2).expected(
        rates[None, None], 100, bin_width_opl=WIDTH
    )
    for spad in (Spad(mode="multi_hit", tdc_dnl=0.2),):
        assert agree(counts(spad, rates, 100), exact["counts"].values[0, 0])
        assert agree(stamps(spad, rates, 100), exact["counts"].values[0, 0])


@pytest.mark.statistical
def test_hot_pixels():
    spad = Spad(mode="multi_hit", hot_fraction=0.25, hot_rate_hz=1e6, device_seed=5)
    found = spad.expected(pixels(FEW), bin_width_opl=WIDTH)["counts"].values - FEW
    hot = found > 1e-9
    assert found[hot] == pytest.approx(1e6 * BIN_S)
    assert agree(hot[..., 0].ravel().astype(float), np.array(0.25))


CHAINS = [
    Spad(jitter=Response(2 * BIN_S)),
    Spad(
        mode="multi_hit", dead_time_s=3 * BIN_S, jitter=Response(2 * BIN_S), hot_fraction=0.1,
        hot_rate_hz=1e8,
    ),
    Spad(
        mode="free_running", dead_time_s=3 * BIN_S, afterpulse_probability=0.1,
        afterpulse_time_s=5 * BIN_S, crosstalk_probability=0.1, macro_pixel=(2, 2), coincidence=2,
    ),
]  # fmt: skip


@pytest.mark.parametrize("spad", CHAINS, ids=["first", "multi", "free"])
def test_chunks_change_nothing(spad):
    """Lazy rates have a lazy result with the same counts as an array in memory, for each seed."""
    rates = np.broadcast_to(PEAK, (36, 8, 24)) * np.linspace(0.5, 1, 36)[:, None, None]
    found = spad.histogram(rates, 50, 7, bin_width_opl=WIDTH)["counts"]
    arrays = {"rate": (("y", "x", "bin"), rates), "background": (("y", "x"), np.zeros((36, 8)))}
    centers = {"opl": ("bin", (np.arange(24) + 0.5) * WIDTH)}
    dataset = xr.Dataset(arrays, centers, {"start_opl": 0.0, "bin_width_opl": WIDTH})
    for chunks in ((36, 8, 24), (5, 3, 7)):
        lazy = dataset.assign(rate=(("y", "x", "bin"), da.from_array(rates, chunks)))
        result = spad.histogram(lazy, 50, 7)["counts"]
        assert result.chunks is not None
        assert result.dtype == found.dtype
        np.testing.assert_array_equal(result.values, found.values)
    assert (spad.histogram(rates, 50, 8, bin_width_opl=WIDTH)["counts"] != found).any()
    equal = spad.histogram(pixels(PEAK, 36, 8), 50, 7, bin_width_opl=WIDTH)["counts"].values
    assert len(np.unique(equal.reshape(len(equal), -1), axis=0)) == len(equal)
    table = spad.photons(rates, 50, 7, bin_width_opl=WIDTH)
    assert (np.diff(table["y"].values) >= 0).all()
    if spad.mode == "free_running":
        assert table.sizes["photon"] == found.sum()


def test_dtypes_and_labels():
    axes = {
        "rate": (("y", "x", "bin"), np.full((2, 2, 4), 0.5)),
        "background": (("y", "x"), np.zeros((2, 2))),
    }
    dataset = xr.Dataset(
        axes,
        {"y": [5, 6], "x": [3, 4], "opl": ("bin", 2.0 + (np.arange(4) + 0.5) * WIDTH)},
        {"start_opl": 2.0, "bin_width_opl": WIDTH},
    )
    for cycles, mode in ((65536, "first_photon"), (9, "multi_hit")):
        found = Spad(mode=mode).histogram(dataset, cycles, 4)
        assert found["counts"].dtype == np.int64  # Sums of counts do not overflow
    assert found["y"].values.tolist() == [5, 6]
    assert found["opl"].values == pytest.approx(2.0 + (np.arange(4) + 0.5) * WIDTH)
    assert found["cycles"].item() == 9
    given = {"sensor_seed": 4, "spad_mode": "multi_hit"}
    assert (given | {"quantity": "counts"}).items() <= found.attrs.items()
    attrs = Spad().photons(dataset.assign_attrs(quantity="rate"), 9, 4).attrs
    assert {"cycles": 9, "sensor_seed": 4, "quantity": "photons"}.items() <= attrs.items()


BAD_RATES = [
    (np.full((1, 1, 3), np.nan), "rates: 3 of 3 values are not finite"),
    (np.array([[[0.1, -0.1]]]), "rates = -0.1:"),
    (np.ones((2, 2)), r"rates with shape \(2, 2\): must be \(y, x, bin\)"),
    (xr.Dataset(), "rates"),
]


@pytest.mark.parametrize(("rates", "text"), BAD_RATES)
def test_bad_rates(rates, text):
    width = None if isinstance(rates, xr.Dataset) else WIDTH
    for call in (Spad().histogram, Spad().photons, Spad().expected):
        refused(text, call, rates, 10, bin_width_opl=width)


@pytest.mark.parametrize(
    ("spad", "call", "text"),
    [
        ({"mode": "multi_hit", "dead_time_s": 6 * BIN_S}, {}, "must be shorter than the window"),
        ({"tdc_lsb_s": 1.5 * BIN_S}, {}, "tdc_lsb_s"),
        ({"macro_pixel": (2, 1)}, {}, r"macro_pixel = \(2, 1\):"),
        ({}, {"cycles": 0}, "cycles = 0"),
        ({"mode": "multi_hit"}, {"cycles": 1 << 30, "rates": 9.0}, "cycles = .*: must be fewer"),
        ({"jitter": Response(80e-6)}, {}, "jitter = .*: must be shorter than the window"),
        ({}, {"seed": -1}, "seed = -1"),
        ({}, {"bin_width_opl": None}, "bin_width_opl"),
    ],
)
def test_bad_calls(spad, call, text):
    arguments = {"cycles": 5, "seed": 1, "bin_width_opl": WIDTH, "rates": 1.0} | call
    rates = np.full((1, 1, 5), arguments.pop("rates"))
    refused(text, Spad(**spad).histogram, rates, **arguments)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *[("dead_time_s", 1e-9), ("paralysable", True), ("afterpulse_time_s", 1e-9)],
        ("afterpulse_probability", 0.1),  # Never falls into an armed cycle of "first_photon"
        *[("hot_rate_hz", 1.0), ("coincidence_window_s", 1e-9), ("crosstalk_probability", 1.1)],
        *[("afterpulse_probability", np.nan), ("coincidence", 2), ("tdc_bits", 0)],
    ],
)
def test_bad_parameters(name, value):
    """Parameters are out of range, or have no effect."""
    refused(name, Spad, **{name: value})


@pytest.mark.parametrize(
    ("name", "value", "cause"),
    [
        ("dead_time_s", 1e-8, 'in mode "first_photon". Remove it or choose mode "multi_hit"'),
        ("afterpulse_probability", 0.1, 'in mode "first_photon". Remove it or choose mode'),
        ("paralysable", True, "with dead_time_s = 0. Remove it or set dead_time_s"),
        ("afterpulse_time_s", 1e-9, "with afterpulse_probability = 0"),
        ("hot_rate_hz", 1.0, "with hot_fraction = 0"),
        ("coincidence_window_s", 1e-9, "with coincidence = 1"),
    ],
)
def test_messages_name_what_makes_a_parameter_useless(name, value, cause):
    refused(re.escape(f"{name} has no effect {cause}"), Spad, **{name: value})
    described = {"cycles": 9, "photons": {"photons_per_cycle": 0.1}, "spad": {name: value}}
    refused(re.escape(f"sensor.spad.{name} has no effect {cause}"), read_sensor, described)


def test_expected_is_refused_where_there_is_no_closed_form():
    for given in (
        {"crosstalk_probability": 0.1},
        {"mode": "multi_hit"} | {"afterpulse_probability": 0.1},
    ):
        refused(
            "left out for expected", Spad(**given).expected, np.ones((1, 1, 5)), bin_width_opl=WIDTH
        )


def test_too_many_photons_warn():
    with pytest.warns(UserWarning, match="blind after"):
        Spad().histogram(np.full((1, 1, 10), 6.0), 10, bin_width_opl=WIDTH)
