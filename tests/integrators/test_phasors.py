"""Phasors of transient data: one and two paths, conventions, unwrapping, bad input."""

# ruff: noqa: E741, SIM300 (I and Q are what the field calls them)

from __future__ import annotations

import tracemalloc
from itertools import product

import numpy as np
import pytest
import xarray as xr

from tofrender.analysis.conversion import (
    phasor_parts,
    sum_channels,
    transient_to_phasor,
    unambiguous_range,
    unwrap,
)

C = 299_792_458.0
START, WIDTH = 3.5, 0.02
FREQUENCIES = (20e6, 50e6, 100e6)


def centre(bin_index, start=START, width=WIDTH):
    return start + (bin_index + 0.5) * width


def paths(*arrivals, bins=300, channels=1):
    """A transient (2, 3, bins, channels), all pixels equal, with light in some bins."""
    data = np.zeros((2, 3, bins, channels), np.float32)
    for index, light in arrivals:
        data[:, :, index] += light
    return data


def dataset(data=None, drop=(), **attrs):
    data = paths((40, 1.0)) if data is None else data
    coords = {"opl": centre(np.arange(data.shape[2]))}
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


def phasors(arrivals, f):
    """The sum over arrivals, in pure Python: (I, Q)."""
    terms = [(light, 2 * np.pi * f * opl / C) for opl, light in arrivals]
    return sum(a * np.cos(p) for a, p in terms), sum(a * np.sin(p) for a, p in terms)


# ------------------------------------------------------------------------------ closed forms


@pytest.mark.parametrize("f", FREQUENCIES)
def test_one_path(f):
    """One path: phase k l modulo 2 pi, depth l / 2 modulo c / 2f."""
    length = centre(137)
    I, Q, amplitude, phase, depth = transient_to_phasor(paths((137, 0.25)), f, START, WIDTH)
    k = 2 * np.pi * f / C
    assert I == pytest.approx(np.full((2, 3, 1), 0.25 * np.cos(k * length)), abs=1e-12)
    assert Q == pytest.approx(np.full((2, 3, 1), 0.25 * np.sin(k * length)), abs=1e-12)
    assert amplitude == pytest.approx(np.full((2, 3, 1), 0.25))
    assert np.exp(1j * phase) == pytest.approx(np.exp(1j * k * np.full((2, 3, 1), length)))
    assert depth == pytest.approx(np.full((2, 3, 1), (length / 2) % (C / (2 * f))))


@pytest.mark.parametrize("f", FREQUENCIES)
def test_two_paths(f):
    """Two paths: z = exp(i k d1) + a exp(i k d2)."""
    k, a = 2 * np.pi * f / C, 0.4
    z = np.exp(1j * k * centre(20)) + a * np.exp(1j * k * centre(111))
    I, Q, amplitude, phase, depth = (
        v[1, 2, 0] for v in transient_to_phasor(paths((20, 1), (111, a)), f, START, WIDTH)
    )
    assert (I, Q, amplitude, phase) == pytest.approx(
        (z.real, z.imag, abs(z), np.angle(z)), rel=1e-6
    )
    assert depth == pytest.approx(C * (np.angle(z) % (2 * np.pi)) / (4 * np.pi * f), rel=1e-6)


def test_fourier_sums_of_noise_for_many_frequencies():
    rng = np.random.default_rng(1)
    data = rng.random((5, 4, 70, 3), dtype=np.float32)
    parts = transient_to_phasor(data, FREQUENCIES, -0.3, 0.05)
    assert [part.shape for part in parts] == [(3, 5, 4, 3)] * 5
    assert {part.dtype for part in parts} == {np.dtype(np.float64)}
    for index, f in enumerate(FREQUENCIES):
        waves = np.exp(2j * np.pi * f / C * centre(np.arange(70), -0.3, 0.05))
        sums = np.einsum("t,hwtc->hwc", waves, data.astype(float))
        assert parts[0][index] == pytest.approx(sums.real, abs=1e-9)
        assert parts[1][index] == pytest.approx(sums.imag, abs=1e-9)
        for alone, among in zip(transient_to_phasor(data, f, -0.3, 0.05), parts, strict=True):
            assert alone == pytest.approx(among[index])


def test_one_frequency_in_a_list_keeps_its_axis():
    assert transient_to_phasor(paths((5, 1)), [20e6], START, WIDTH)[4].shape == (1, 2, 3, 1)
    assert transient_to_phasor(paths((5, 1)), np.float32(20e6), START, WIDTH)[4].shape == (2, 3, 1)


def test_later_light_has_a_larger_phase():
    early, late = (
        transient_to_phasor(paths((index, 1)), 20e6, 0.0, WIDTH)[3][0, 0, 0] for index in (10, 40)
    )
    assert 0 < early < late
    assert late - early == pytest.approx(2 * np.pi * 20e6 * 0.6 / C)


def test_scale_of_film_data_and_of_densities():
    """Film values are summed as they are; radiance per metre is multiplied by the bin width."""
    film = paths((30, 0.5), (31, 0.25))
    bins = transient_to_phasor(film, 20e6, START, WIDTH)
    density = transient_to_phasor(film / WIDTH, 20e6, START, WIDTH, quantity="radiance per metre")
    for ours, theirs in zip(bins, density, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-6)
    slow = transient_to_phasor(film, 1.0, START, WIDTH)  # A period of 300 000 km: nothing wraps
    assert slow[2] == pytest.approx(np.full((2, 3, 1), 0.75))


def test_binning_error_is_as_documented():
    """Light spread evenly over bins has sinc(f w / c) of the amplitude that their centres have."""
    f, width, fine = 100e6, 0.2, 1000
    coarse = transient_to_phasor(np.ones((1, 1, 4, 1)), f, 1.0, width)
    exact = transient_to_phasor(np.full((1, 1, 4 * fine, 1), 1 / fine), f, 1.0, width / fine)
    ratio = exact[2].item() / coarse[2].item()
    assert ratio == pytest.approx(np.sinc(f * width / C), abs=1e-7)
    assert ratio == pytest.approx(1 - (np.pi * f * width / C) ** 2 / 6, abs=2e-5)
    assert exact[3].item() == pytest.approx(coarse[3].item())


# -------------------------------------------------------------------------------- conventions


def test_phase_is_in_half_open_interval_and_depth_below_the_range():
    I = np.array([1.0, -1.0, -1.0, -1.0, 1.0, 0.0, 0.0])
    Q = np.array([0.0, 0.0, -0.0, -1e-300, -1e-18, -1.0, 0.0])
    amplitude, phase, depth = phasor_parts(I, Q, 20e6)
    full = C / 40e6
    assert amplitude == pytest.approx([1, 1, 1, 1, 1, 1, 0])
    assert (phase > -np.pi).all()
    assert (phase <= np.pi).all()
    assert phase[:4] == pytest.approx([0, np.pi, np.pi, np.pi])
    assert (depth >= 0).all()
    assert (depth < full).all()
    assert depth == pytest.approx([0, full / 2, full / 2, full / 2, full, 0.75 * full, 0])


def test_channels_are_summed_as_phasors():
    """Two colours with phases around +-pi: the mean of phases is 0, the right one is pi."""
    I, Q = np.zeros((2, 1, 1, 3)), np.zeros((2, 1, 1, 3))
    I[..., :] = -1.0, -1.0, 0.0
    Q[..., :] = 0.1, -0.1, 0.0
    assert phasor_parts(I, Q, (20e6, 50e6))[1].mean() == pytest.approx(0)
    summed = sum_channels(I, Q, (20e6, 50e6))
    assert [part.shape for part in summed] == [(2, 1, 1, 1)] * 5
    assert summed[0] == pytest.approx(np.full((2, 1, 1, 1), -2.0))
    assert np.abs(summed[3]) == pytest.approx(np.full((2, 1, 1, 1), np.pi))


def test_sum_of_channels_equals_conversion_of_the_sum():
    data = np.random.default_rng(2).random((2, 2, 50, 3))
    colour = transient_to_phasor(data, FREQUENCIES, 1.0, WIDTH)
    grey = transient_to_phasor(data.sum(axis=3, keepdims=True), FREQUENCIES, 1.0, WIDTH)
    for ours, theirs in zip(sum_channels(*colour[:2], FREQUENCIES), grey, strict=True):
        assert ours == pytest.approx(theirs)


def test_three_axes_are_one_channel():
    data = np.random.default_rng(3).random((2, 3, 50))
    flat, full = (transient_to_phasor(d, 20e6, 1.0, WIDTH) for d in (data, data[..., None]))
    assert flat[0].shape == (2, 3, 1)
    assert all((a == b).all() for a, b in zip(flat, full, strict=True))


def test_unfinished_pixels_stay_unfinished():
    data = paths((5, 1.0))
    data[0, 1] = np.nan
    for part in transient_to_phasor(data, 20e6, START, WIDTH):
        assert np.isnan(part[0, 1]).all()
        assert np.isfinite(part[1]).all()


def test_memory_stays_below_twice_the_input():
    data = np.ones((32, 32, 1000, 3), np.float32)
    for view in (data, data[:, ::-1]):
        tracemalloc.start()
        transient_to_phasor(view, (20e6, 50e6), START, WIDTH)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 0.6 * data.nbytes


def test_memory_of_one_row_too():
    data = np.ones((1, 1000, 3000, 1), np.float32)
    tracemalloc.start()
    transient_to_phasor(data, 20e6, START, WIDTH)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.6 * data.nbytes


# ------------------------------------------------------------------------------------ Dataset


def test_a_dataset_knows_its_time_axis_and_quantity():
    data = paths((137, 0.25), (20, 1.0))
    expected = transient_to_phasor(data, FREQUENCIES, START, WIDTH)
    for ours, theirs in zip(transient_to_phasor(dataset(data), FREQUENCIES), expected, strict=True):
        assert ours == pytest.approx(theirs, abs=1e-12)
    density = dataset(data / WIDTH, quantity="radiance per metre")
    for ours, theirs in zip(transient_to_phasor(density, FREQUENCIES), expected, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-6, abs=1e-9)
    agreeing = transient_to_phasor(dataset(data), FREQUENCIES, START, WIDTH)
    assert agreeing[0] == pytest.approx(expected[0])


def test_part_of_a_dataset_keeps_its_time():
    part = dataset().isel(opl=slice(30, 60))
    assert transient_to_phasor(part, 20e6)[3] == pytest.approx(
        transient_to_phasor(dataset(), 20e6)[3]
    )


@pytest.mark.parametrize("outside", [0.0101, 0.3])
def test_lost_energy_warns(outside):
    with pytest.warns(UserWarning, match="outside the window") as caught:
        transient_to_phasor(dataset(energy_outside_window=outside), 20e6)
    assert caught[0].filename == __file__
    assert "\n" not in str(caught[0].message)


def test_little_lost_energy_does_not_warn():
    transient_to_phasor(dataset(energy_outside_window=0.0099), 20e6)  # Warnings are errors here


@pytest.mark.parametrize("name", ["quantity", "bin_width_opl", "energy_outside_window"])
def test_a_dataset_without_an_attribute(name):
    one_line(rf"dataset: attribute {name} is missing", dataset(drop=[name]), 20e6)


@pytest.mark.parametrize(
    ("match", "bad"),
    [
        ("coordinate opl is missing", dataset().drop_vars("opl")),
        ("must hold transient", dataset().rename(transient="light")),
        ("must hold transient", dataset().transpose("y", "x", "channel", "opl")),
        ("bin_width_opl = 'wide'", dataset(bin_width_opl="wide")),
        ("coordinate opl", dataset(bin_width_opl=0.03)),
        ("quantity = 'photons'", dataset(quantity="photons")),
        ("energy_outside_window = 'none'", dataset(energy_outside_window="none")),
    ],
)
def test_a_dataset_that_is_wrong(match, bad):
    one_line(match, bad, 20e6)


@pytest.mark.parametrize(
    ("name", "value"),
    [("start_opl", 0.0), ("bin_width_opl", 0.01), ("quantity", "radiance per metre")],
)
def test_arguments_that_contradict_the_dataset(name, value):
    one_line(rf"{name} = .* as the Dataset has it", dataset(), 20e6, **{name: value})


# ---------------------------------------------------------------------------------- bad input


def one_line(match, *args, function=transient_to_phasor, **kwargs):
    with pytest.raises(ValueError, match=match) as caught:
        function(*args, **kwargs)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("f", [0, -20e6, np.nan, np.inf, "20e6", None, True, [20e6, 0], ["50e6"]])
@pytest.mark.parametrize("function", [transient_to_phasor, phasor_parts, unambiguous_range])
def test_bad_frequencies(f, function):
    arguments = {
        transient_to_phasor: (paths((5, 1)), f, START, WIDTH),
        phasor_parts: (np.ones(2), np.ones(2), f),
        unambiguous_range: (f,),
    }[function]
    one_line(
        r"frequency_hz.* = .*: must be a finite number of hertz above 0",
        *arguments,
        function=function,
    )


@pytest.mark.parametrize("empty", [[], (), np.zeros(0)])
def test_no_frequency(empty):
    one_line("at least one frequency", paths((5, 1)), empty, START, WIDTH)


def test_frequency_that_bins_cannot_hold():
    one_line("must be below 7.49481e[+]09", paths((5, 1)), [20e6, 7.5e9], START, WIDTH)


@pytest.mark.parametrize(
    "shape",
    [
        (4, 5, 3, 300),
        (4, 5, 1, 300),
        (4, 5, 3),
        (4, 5, 300, 2),
        (300,),
        (2, 4, 5, 300, 3),
        (4, 5, 0, 3),
        (0, 5, 300, 3),
    ],
)
def test_wrong_axis_order(shape):
    one_line(r"transient_data with shape .*channels last", np.ones(shape), 20e6, START, WIDTH)


def test_wrong_axis_order_says_what_helps():
    one_line("moveaxis", np.ones((4, 5, 3, 300)), 20e6, START, WIDTH)


@pytest.mark.parametrize("data", ["light", None, paths((5, 1)).astype(complex), [[1], [1, 2]]])
def test_data_that_is_not_real(data):
    one_line("transient_data of type .* must hold real numbers", data, 20e6, START, WIDTH)


@pytest.mark.parametrize(
    ("start", "width", "match"),
    [
        (None, WIDTH, "start_opl"),
        (np.nan, WIDTH, "start_opl"),
        (START, None, "bin_width_opl"),
        (START, 0, "bin_width_opl"),
        (START, -1, "bin_width_opl"),
        (START, "1", "bin_width_opl"),
    ],
)
def test_bad_time_axis(start, width, match):
    one_line(f"{match} = ", paths((5, 1)), 20e6, start, width)


def test_bad_quantity():
    one_line("quantity = 'radiance'", paths((5, 1)), 20e6, START, WIDTH, quantity="radiance")


def test_parts_that_do_not_fit():
    one_line("must be equal", np.ones(3), np.ones(4), 20e6, function=phasor_parts)
    one_line("2 frequencies first", np.ones(3), np.ones(3), [1e6, 2e6], function=phasor_parts)
    one_line("channels in its last axis", 1.0, 1.0, 20e6, function=sum_channels)


# ---------------------------------------------------------------------------------- unwrapping


def phases_of(depth, frequencies):
    """Wrapped phases in (-pi, pi] of one path there and back."""
    return np.stack([np.angle(np.exp(4j * np.pi * f * depth / C)) for f in frequencies])


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
    """All of the common range of 15 m, twice that of 20 MHz and ten times that of 100 MHz."""
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


def test_unwrap_weighs_by_amplitude():
    """A frequency that is all noise but dark does no harm, the reference included."""
    rng = np.random.default_rng(5)
    frequencies = (20e6, 30e6, 100e6)
    depth = rng.uniform(0.5, 14.0, (200,))
    phases = phases_of(depth, frequencies)
    phases[2] = rng.uniform(-np.pi, np.pi, 200)
    amplitudes = np.array([1.0, 1.0, 1e-6])[:, None] * np.ones(200)
    assert unwrap(phases, frequencies, amplitudes=amplitudes)[0] == pytest.approx(depth, abs=1e-6)
    assert np.abs(unwrap(phases, frequencies)[0] - depth).max() > 0.1


@pytest.mark.parametrize("frequencies", [(20e6, 50e6), (20e6, 30e6, 40e6), (90e6, 80e6, 100e6)])
def test_unwrap_finds_the_best_of_all_wrap_counts(frequencies):
    """Of all combinations, for phases that fit no depth at all and amplitudes from 0.01 to 1."""
    rng = np.random.default_rng(0)
    phases = rng.uniform(-np.pi, np.pi, (len(frequencies), 400))
    amplitudes = 10 ** rng.uniform(-2, 0, phases.shape)
    limit = unambiguous_range(frequencies)
    ranges = C / 2 / np.array(frequencies)[:, None]
    weights = (amplitudes / ranges) ** 2 / ((amplitudes / ranges) ** 2).sum(axis=0)
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


def test_unwrap_up_to_a_depth_that_is_known():
    """Noise that would lead to a far candidate does no harm if the room is known to be small."""
    frequencies = (20e6, 50e6)
    phases = phases_of(np.array([2.0, 5.0]), frequencies) + np.array([[0.8], [0.0]])
    free, bounded = (unwrap(phases, frequencies, limit)[0] for limit in (None, 5.5))
    assert np.abs(free - [2.0, 5.0]).max() > 1
    assert bounded == pytest.approx([2.0, 5.0], abs=0.4)
    assert np.isnan(unwrap(phases_of(np.array([2.0]), frequencies), frequencies, 1.0)[0]).all()


def test_unwrap_of_converted_phasors():
    """From bins to a depth of 9 m, beyond the range of each of the two frequencies."""
    index = 449
    data = paths((index, 0.3), bins=500, channels=3)
    start, width = 0.0, 0.04
    _, _, amplitude, phase, depth = transient_to_phasor(data, (20e6, 50e6), start, width)
    true = centre(index, start, width) / 2
    assert (np.abs(depth - true) > 1).all()
    found, _ = unwrap(phase, (20e6, 50e6), amplitudes=amplitude)
    assert found == pytest.approx(np.full((2, 3, 3), true), abs=1e-9)


@pytest.mark.parametrize(
    ("match", "arguments", "options"),
    [
        ("two or more frequencies", (np.ones((1, 4)), [20e6]), {}),
        ("two or more frequencies", (np.ones((1, 4)), 20e6), {}),
        (r"frequencies_hz\[1\] = 0", (np.ones((2, 4)), [20e6, 0]), {}),
        ("at least one frequency", (np.ones((0, 4)), []), {}),
        ("2 frequencies first", (np.ones((3, 4)), [20e6, 50e6]), {}),
        ("2 frequencies first", (1.0, [20e6, 50e6]), {}),
        ("real numbers", (np.ones((2, 4), complex), [20e6, 50e6]), {}),
        ("at most 14.98", (np.ones((2, 4)), [20e6, 50e6], 15.1), {}),
        ("max_depth = 0", (np.ones((2, 4)), [20e6, 50e6], 0), {}),
        ("max_depth = nan", (np.ones((2, 4)), [20e6, 50e6], np.nan), {}),
        ("4096 ranges", (np.ones((2, 4)), [20e6, 20.0001e6]), {}),
        ("amplitudes", (np.ones((2, 4)), [20e6, 50e6]), {"amplitudes": np.ones((2, 3))}),
        ("amplitudes", (np.ones((2, 4)), [20e6, 50e6]), {"amplitudes": -np.ones((2, 4))}),
    ],
)
def test_unwrap_refuses(match, arguments, options):
    one_line(match, *arguments, function=unwrap, **options)
