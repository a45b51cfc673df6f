"""Phasors of transient data, and depths beyond the range of one frequency."""

# ruff: noqa: E741 (I and Q are what the field calls them)

import tracemalloc
from itertools import product

import numpy as np
import pytest
import xarray as xr
from helpers.support import refused

from tofrender import phasor_parts
from tofrender.analysis import sum_channels, transient_to_phasor, unambiguous_range, unwrap

C = 299_792_458.0
START, WIDTH = 3.5, 0.02
FREQUENCIES = (20e6, 50e6, 100e6)


def center(bin_index, start=START, width=WIDTH):
    return start + (bin_index + 0.5) * width


def converted(data, f=20e6, start=START, width=WIDTH, **options):
    return transient_to_phasor(data, f, start, width, **options)


def require_same(parts, others, **tolerance):
    for one, other in zip(parts, others, strict=True):
        assert one == pytest.approx(other, **tolerance)


def paths(*arrivals, bins=300, channels=1):
    """Return a transient (2, 3, bins, channels) with equal pixels and light in some bins."""
    data = np.zeros((2, 3, bins, channels), np.float32)
    for index, light in arrivals:
        data[:, :, index] += light
    return data


def dataset(data=None, drop=(), **attrs):
    data = paths((40, 1.0)) if data is None else data
    names = ["R", "G", "B"] if data.shape[3] == 3 else ["L"]
    coords = {"opl": center(np.arange(data.shape[2])), "channel": names}
    attrs = {
        "quantity": "radiance per bin",
        "bin_width_opl": WIDTH,
        "start_opl": START,
        "energy_outside_window": 0.0,
    } | attrs
    result = xr.Dataset(
        {"transient": (("y", "x", "opl", "channel"), data)}, coords=coords, attrs=attrs
    )
    for name in drop:
        del result.attrs[name]
    return result


@pytest.mark.parametrize("arrivals", [[(137, 0.25)], [(20, 1), (111, 0.4)]], ids=["one", "two"])
@pytest.mark.parametrize("f", FREQUENCIES)
def test_paths(arrivals, f):
    k = 2 * np.pi * f / C
    z = sum(a * np.exp(1j * k * center(index)) for index, a in arrivals)
    depth = (np.angle(z) % (2 * np.pi)) / (2 * k)
    for found, expected in zip(
        converted(paths(*arrivals), f), (z.real, z.imag, abs(z), np.angle(z), depth), strict=True
    ):
        assert found == pytest.approx(np.full((2, 3, 1), expected), rel=1e-6)
    if len(arrivals) == 1:
        assert depth == pytest.approx((center(137) / 2) % (C / (2 * f)))


def test_fourier_sums_of_noise_for_many_frequencies():
    rng = np.random.default_rng(1)
    data = rng.random((5, 4, 70, 3), dtype=np.float32)
    parts = transient_to_phasor(data, FREQUENCIES, -0.3, 0.05)
    assert [part.shape for part in parts] == [(3, 5, 4, 3)] * 5
    assert {part.dtype for part in parts} == {np.dtype(np.float64)}
    for index, f in enumerate(FREQUENCIES):
        waves = np.exp(2j * np.pi * f / C * center(np.arange(70), -0.3, 0.05))
        sums = np.einsum("t,hwtc->hwc", waves, data.astype(float))
        assert parts[0][index] == pytest.approx(sums.real, abs=1e-9)
        assert parts[1][index] == pytest.approx(sums.imag, abs=1e-9)
        for alone, among in zip(transient_to_phasor(data, f, -0.3, 0.05), parts, strict=True):
            assert alone == pytest.approx(among[index])


def test_scale_of_film_data_and_of_densities():
    """Film values are summed directly. Radiance per meter is multiplied by the bin width."""
    film = paths((30, 0.5), (31, 0.25))
    density = converted(film / WIDTH, quantity="radiance per meter")
    require_same(converted(film), density, rel=1e-6)
    slow = converted(film, 1.0)  # A period of 300 000 km: nothing wraps
    assert slow[2] == pytest.approx(np.full((2, 3, 1), 0.75))
    assert converted(film, [20e6])[4].shape == (1, 2, 3, 1)
    assert converted(film, np.float32(20e6))[4].shape == (2, 3, 1)


def test_binning_error_is_as_documented():
    """Light spread evenly over bins has sinc(f w / c) times the amplitude of bin centers."""
    f, width, fine = 100e6, 0.2, 1000
    coarse = transient_to_phasor(np.ones((1, 1, 4, 1)), f, 1.0, width)
    exact = transient_to_phasor(np.full((1, 1, 4 * fine, 1), 1 / fine), f, 1.0, width / fine)
    ratio = exact[2].item() / coarse[2].item()
    assert ratio == pytest.approx(np.sinc(f * width / C), abs=1e-7)
    assert ratio == pytest.approx(1 - (np.pi * f * width / C) ** 2 / 6, abs=2e-5)
    assert exact[3].item() == pytest.approx(coarse[3].item())


def test_phase_is_in_half_open_interval_and_depth_below_the_range():
    I = np.array([1.0, -1.0, -1.0, -1.0, 1.0, 0.0, 0.0])
    Q = np.array([0.0, 0.0, -0.0, -1e-300, -1e-18, -1.0, 0.0])
    amplitude, phase, depth = phasor_parts(I, Q, 20e6)
    full = C / 40e6
    assert amplitude == pytest.approx([1, 1, 1, 1, 1, 1, 0])
    assert ((phase > -np.pi) & (phase <= np.pi)).all()
    assert phase[:4] == pytest.approx([0, np.pi, np.pi, np.pi])
    assert ((depth >= 0) & (depth < full)).all()
    assert depth == pytest.approx([0, full / 2, full / 2, full / 2, full, 0.75 * full, 0])


def test_sum_of_channels_equals_conversion_of_the_sum():
    data = np.random.default_rng(2).random((2, 2, 50, 3))
    color, gray = (converted(d, FREQUENCIES) for d in (data, data.sum(axis=3, keepdims=True)))
    require_same(sum_channels(*color[:2], FREQUENCIES), gray)
    flat, full = (converted(d) for d in (data[..., 0], data[..., :1]))
    assert flat[0].shape == (2, 2, 1)
    assert all((a == b).all() for a, b in zip(flat, full, strict=True))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_light_that_is_not_finite_is_refused(bad):
    data = paths((5, 1.0))
    data[0, 1, 7:9] = bad
    said = rf"transient_data: 2 of 1800 values .*, the first is {bad:g} at \[0, 1, 7, 0\]"
    refused(said, transient_to_phasor, data, 20e6, START, WIDTH)
    refused(said, transient_to_phasor, dataset(data), 20e6)


def test_memory_stays_below_twice_the_input():
    data = np.ones((32, 32, 1000, 3), np.float32)
    for view in (data, data[:, ::-1], np.ones((1, 1000, 3000, 1), np.float32)):
        tracemalloc.start()
        converted(view, (20e6, 50e6))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 0.6 * view.nbytes


def test_a_dataset_knows_its_time_axis_and_quantity():
    data = paths((137, 0.25), (20, 1.0))
    expected = converted(data, FREQUENCIES)
    require_same(transient_to_phasor(dataset(data), FREQUENCIES), expected, abs=1e-12)
    density = dataset(data / WIDTH, quantity="radiance per meter")
    require_same(transient_to_phasor(density, FREQUENCIES), expected, rel=1e-6, abs=1e-9)
    require_same(converted(dataset(data), FREQUENCIES), expected)
    part = transient_to_phasor(dataset().isel(opl=slice(30, 60)), 20e6)[3]
    assert part == pytest.approx(transient_to_phasor(dataset(), 20e6)[3])


def test_lost_energy_warns():
    transient_to_phasor(dataset(energy_outside_window=0.0099), 20e6)  # Warnings are errors here
    for outside in (0.0101, 0.3):
        with pytest.warns(UserWarning, match=r"\A.*outside the window.*\Z") as caught:
            transient_to_phasor(dataset(energy_outside_window=outside), 20e6)
        assert caught[0].filename == __file__


@pytest.mark.parametrize(
    ("said", "bad"),
    [
        ("attribute quantity is missing", dataset(drop=["quantity"])),
        ("attribute bin_width_opl is missing", dataset(drop=["bin_width_opl"])),
        ("attribute energy_outside_window is missing", dataset(drop=["energy_outside_window"])),
        ("coordinate opl along the axis opl is missing", dataset().drop_vars("opl")),
        ("variable transient is missing", dataset().rename(transient="light")),
        ("attribute bin_width_opl", dataset(bin_width_opl="wide")),
        ("0.02 m apart, but 0.03 m wide", dataset(bin_width_opl=0.03)),
        ("quantity = 'photons'", dataset(quantity="photons")),
        ("energy_outside_window = 'none' is not", dataset(energy_outside_window="none")),
    ],
)
def test_a_dataset_that_is_wrong(said, bad):
    refused(said, transient_to_phasor, bad, 20e6)


def test_arguments_that_contradict_the_dataset():
    for name, value in (
        ("start_opl", 0.0),
        ("bin_width_opl", 0.01),
        ("quantity", "radiance per meter"),
    ):
        refused(
            rf"{name} = .* as the Dataset has it",
            transient_to_phasor,
            dataset(),
            20e6,
            **{name: value},
        )


@pytest.mark.parametrize(
    "shape",
    [
        *((4, 5, 3, 300), (4, 5, 1, 300), (4, 5, 3), (4, 5, 300, 2), (300,)),
        *((2, 4, 5, 300, 3), (4, 5, 0, 3), (0, 5, 300, 3)),
    ],
)
def test_wrong_axis_order(shape):
    said = r"transient_data with shape .*channels last"
    said += ".*moveaxis" if shape == (4, 5, 3, 300) else ""
    refused(said, transient_to_phasor, np.ones(shape), 20e6, START, WIDTH)


LIGHT = paths((5, 1))
NO_REAL = "transient_data of type .* must contain real numbers"


@pytest.mark.parametrize(
    ("match", "arguments"),
    [
        *(("at least one frequency", (LIGHT, none, START, WIDTH)) for none in ([], np.zeros(0))),
        ("must be below 7.49481e[+]09", (LIGHT, [20e6, 7.5e9], START, WIDTH)),
        (NO_REAL, (LIGHT.astype(complex), 20e6, START, WIDTH)),
    ],
)
def test_bad_arguments(match, arguments):
    refused(match, transient_to_phasor, *arguments)


def test_parts_that_do_not_fit():
    refused("quantity = 'light'", transient_to_phasor, LIGHT, 20e6, START, WIDTH, quantity="light")
    refused("must be equal", phasor_parts, np.ones(3), np.ones(4), 20e6)
    refused("2 frequencies first", phasor_parts, np.ones(3), np.ones(3), [1e6, 2e6])
    refused("channels in the last axis", sum_channels, 1.0, 1.0, 20e6)


def phases_of(depth, frequencies):
    """Return wrapped phases in (-pi, pi] of a single path to a depth and back."""
    return np.stack([np.angle(np.exp(4j * np.pi * f * depth / C)) for f in frequencies])


def chances(frequencies, count: int, least: float, seed: int):
    """Return phases that fit no depth, amplitudes, and ranges and weights of the frequencies."""
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
        ((1e9, 50.0), 50.0),
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
    """Phase noise s causes depth noise s c / (4 pi f), and less with several frequencies."""
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
    """With ranges of R/2 and R/5, both frequencies differ from two depths by the same amount."""
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
    """If noise moves a depth of 0 below 0, outside the range, the result is 0."""
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
    """The result has the lowest cost of all depths in steps of 1 mm, for phases that fit none."""
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
