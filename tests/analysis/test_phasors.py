"""Phasors of transient data: one and two paths, conventions, bad input."""

# ruff: noqa: E741, SIM300 (I and Q are what the field calls them)

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
import xarray as xr

from tofrender import phasor_parts
from tofrender.analysis import (
    sum_channels,
    transient_to_phasor,
    unambiguous_range,
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


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_light_that_is_not_finite_is_refused(bad):
    data = paths((5, 1.0))
    data[0, 1, 7:9] = bad
    said = rf"transient_data: 2 of 1800 values .*, the first is {bad:g} at \[0, 1, 7, 0\]"
    one_line(said, data, 20e6, START, WIDTH)
    one_line(said, dataset(data), 20e6)


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
        r"frequency_hz.* = .*: must be a finite number of hertz from 1e-09",
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
    one_line("channels in the last axis", 1.0, 1.0, 20e6, function=sum_channels)
