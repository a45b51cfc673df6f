"""Phasors of transient data: one and two paths, conventions, bad input."""

# ruff: noqa: E741 (I and Q are what the field calls them)

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


def converted(data, f=20e6, start=START, width=WIDTH, **options):
    return transient_to_phasor(data, f, start, width, **options)


def require_same(parts, others, **tolerance):
    for one, other in zip(parts, others, strict=True):
        assert one == pytest.approx(other, **tolerance)


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


@pytest.mark.parametrize("arrivals", [[(137, 0.25)], [(20, 1), (111, 0.4)]], ids=["one", "two"])
@pytest.mark.parametrize("f", FREQUENCIES)
def test_paths(arrivals, f):
    k = 2 * np.pi * f / C
    z = sum(a * np.exp(1j * k * centre(index)) for index, a in arrivals)
    depth = (np.angle(z) % (2 * np.pi)) / (2 * k)
    for found, expected in zip(
        converted(paths(*arrivals), f), (z.real, z.imag, abs(z), np.angle(z), depth), strict=True
    ):
        assert found == pytest.approx(np.full((2, 3, 1), expected), rel=1e-6)
    if len(arrivals) == 1:
        assert depth == pytest.approx((centre(137) / 2) % (C / (2 * f)))


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


def test_scale_of_film_data_and_of_densities():
    """Film values are summed as they are; radiance per metre is multiplied by the bin width."""
    film = paths((30, 0.5), (31, 0.25))
    density = converted(film / WIDTH, quantity="radiance per metre")
    require_same(converted(film), density, rel=1e-6)
    slow = converted(film, 1.0)  # A period of 300 000 km: nothing wraps
    assert slow[2] == pytest.approx(np.full((2, 3, 1), 0.75))
    assert converted(film, [20e6])[4].shape == (1, 2, 3, 1)
    assert converted(film, np.float32(20e6))[4].shape == (2, 3, 1)


def test_binning_error_is_as_documented():
    """Light spread evenly over bins has sinc(f w / c) of the amplitude that their centres have."""
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
    colour, grey = (converted(d, FREQUENCIES) for d in (data, data.sum(axis=3, keepdims=True)))
    require_same(sum_channels(*colour[:2], FREQUENCIES), grey)
    flat, full = (converted(d) for d in (data[..., 0], data[..., :1]))
    assert flat[0].shape == (2, 2, 1)
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
    density = dataset(data / WIDTH, quantity="radiance per metre")
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
        ("coordinate opl is missing", dataset().drop_vars("opl")),
        ("must hold transient", dataset().rename(transient="light")),
        ("must hold transient", dataset().transpose("y", "x", "channel", "opl")),
        ("bin_width_opl = 'wide'", dataset(bin_width_opl="wide")),
        ("coordinate opl", dataset(bin_width_opl=0.03)),
        ("quantity = 'photons'", dataset(quantity="photons")),
        ("energy_outside_window = 'none'", dataset(energy_outside_window="none")),
    ],
)
def test_a_dataset_that_is_wrong(said, bad):
    one_line(said, bad, 20e6)


def test_arguments_that_contradict_the_dataset():
    for name, value in (
        ("start_opl", 0.0),
        ("bin_width_opl", 0.01),
        ("quantity", "radiance per metre"),
    ):
        one_line(rf"{name} = .* as the Dataset has it", dataset(), 20e6, **{name: value})


def one_line(match, *args, function=transient_to_phasor, **kwargs):
    with pytest.raises(ValueError, match=rf"\A.*{match}.*\Z"):
        function(*args, **kwargs)


def test_bad_frequencies():
    match = r"frequency_hz.* = .*: must be a finite number of hertz from 1e-09"
    for f in (0, -20e6, [20e6, 0]):
        one_line(match, paths((5, 1)), f, START, WIDTH)
        one_line(match, np.ones(2), np.ones(2), f, function=phasor_parts)
        one_line(match, f, function=unambiguous_range)


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
    one_line(said, np.ones(shape), 20e6, START, WIDTH)


LIGHT = paths((5, 1))
NO_REAL = "transient_data of type .* must hold real numbers"


@pytest.mark.parametrize(
    ("match", "arguments"),
    [
        *(("at least one frequency", (LIGHT, none, START, WIDTH)) for none in ([], np.zeros(0))),
        ("must be below 7.49481e[+]09", (LIGHT, [20e6, 7.5e9], START, WIDTH)),
        (NO_REAL, (LIGHT.astype(complex), 20e6, START, WIDTH)),
    ],
)
def test_bad_arguments(match, arguments):
    one_line(match, *arguments)


def test_parts_that_do_not_fit():
    one_line("quantity = 'radiance'", LIGHT, 20e6, START, WIDTH, quantity="radiance")
    one_line("must be equal", np.ones(3), np.ones(4), 20e6, function=phasor_parts)
    one_line("2 frequencies first", np.ones(3), np.ones(3), [1e6, 2e6], function=phasor_parts)
    one_line("channels in the last axis", 1.0, 1.0, 20e6, function=sum_channels)
