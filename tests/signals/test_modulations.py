"""Modulations: closed forms, periods, extrema, and as exact as single-precision lengths allow."""

import itertools
import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from tofrender.signals.modulations import (
    AMCWPulse,
    HamiltonianCode,
    MSequence,
    SquareWave,
    check_frequency,
)
from tofrender.signals.units import SPEED_OF_LIGHT as C

CODES = [code for k in (3, 4, 5) for code in HamiltonianCode.all(k, 30e6)]
MODULATIONS = {
    repr(each): each
    for each in (
        AMCWPulse(20e6),
        AMCWPulse(1e9, phase_offset=-math.pi / 2),
        SquareWave(50e6),
        SquareWave(50e6, phase_offset=2.0),
        *CODES,
        MSequence(2, 20e6),
        MSequence(7, 20e6, phase_offset=-1.0),
    )
}


def called(modulation, opl) -> np.ndarray:
    return np.array(modulation.eval(mi.Float(opl)), dtype=np.float64)


def period(modulation) -> float:
    return C / modulation.frequency_hz


def phases(n: int) -> np.ndarray:
    """Middles of n equal parts of a period, in turns."""
    return (np.arange(n) + 0.5) / n


@pytest.mark.parametrize("name", MODULATIONS)
def test_repeats_after_a_period(name):
    modulation = MODULATIONS[name]
    opl = phases(997) * period(modulation)
    once = called(modulation, opl)
    slope = np.abs(np.diff(once)).max() * 997 / period(modulation)
    for periods in (-1, 1, 12):
        later = np.float32(opl + periods * period(modulation))
        rounding = slope * np.abs(later - (opl + periods * period(modulation))).max()
        assert called(modulation, later) == pytest.approx(once, abs=rounding + 2e-5)


@pytest.mark.parametrize("name", MODULATIONS)
def test_numbers_give_numbers(name):
    modulation = MODULATIONS[name]
    assert modulation.get_unambiguous_range() == pytest.approx(C / (2 * modulation.frequency_hz))
    for opl in (0, 1, 3.7, np.float64(123.4), np.float32(0.1), -2.0):
        value = modulation.eval(opl)
        assert isinstance(value, float)
        assert value == pytest.approx(called(modulation, opl)[0], abs=3e-3)


@pytest.mark.parametrize("name", MODULATIONS)
def test_exact_at_100_meters(name):
    modulation = MODULATIONS[name]
    opl = np.float32(np.random.default_rng(3).uniform(90, 100, 2000))
    exact = np.array([modulation.eval(float(each)) for each in opl])
    assert called(modulation, opl) == pytest.approx(exact, abs=3e-5)


@pytest.mark.parametrize("name", MODULATIONS)
def test_an_offset_reads_at_a_longer_path(name):
    """phase_offset + 2 pi x is a path that is x periods longer."""
    modulation = MODULATIONS[name]
    arguments = {"frequency_hz": modulation.frequency_hz}
    for key in ("k", "demodulation", "n_bits"):
        if hasattr(modulation, key):
            arguments[key] = getattr(modulation, key)
    opl = phases(101) * period(modulation)
    for x in (0.3, -0.125, 1e6 + 0.25):
        offset = modulation.phase_offset + 2 * math.pi * x
        moved = type(modulation)(**arguments, phase_offset=offset)
        longer = opl + (x % 1) * period(modulation)
        assert called(moved, opl) == pytest.approx(called(modulation, longer), abs=2e-4)


@pytest.mark.parametrize(
    "modulation", [AMCWPulse(50e6), SquareWave(50e6), MSequence(3, 50e6), CODES[0]]
)
def test_derivative(modulation):
    """Arrival times can be differentiated: reverse mode gives the slope."""
    at = np.array([0.3, 1.1, 3.95, 40.7])
    opl = mi.Float(at)
    dr.enable_grad(opl)
    dr.backward(modulation.eval(opl))
    step = 1e-6
    slope = [(modulation.eval(each + step) - modulation.eval(each - step)) / 2e-6 for each in at]
    assert np.array(opl.grad) == pytest.approx(np.array(slope), rel=1e-3, abs=1e-4)


def cosines(low: float, frequency: float, offset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Lengths up to 100 m, and the cosine at them in double precision."""
    opl = np.float32(np.random.default_rng(1).uniform(low, 100, 10_000))
    return opl, np.cos(2 * math.pi * (frequency / C * opl.astype(np.float64)) + offset)


@pytest.mark.parametrize("frequency", [20e6, 99.7e6, 1e9])
@pytest.mark.parametrize("offset", [0.0, -math.pi / 2, math.pi / 2, 100.0])
def test_cosine_against_double_precision(frequency, offset):
    """To 1e-6 at 100 m and 1 GHz, where 2 pi f opl/c in single precision is off by 1e-4."""
    opl, exact = cosines(0, frequency, offset)
    assert np.abs(called(AMCWPulse(frequency, offset), opl) - exact).max() < 1.5e-6
    opl, exact = cosines(90, 1e9)
    plain = np.array(dr.cos(mi.Float(opl) * (2 * math.pi * 1e9 / C)), dtype=np.float64)
    assert np.abs(plain - exact).max() > 5e-5


def test_plus_sine_is_minus_a_quarter():
    """I + iQ of one path is exp(+i k opl), so that its phase grows with its length."""
    opl = np.linspace(0, 20, 1001)
    i, q = called(AMCWPulse(30e6), opl), called(AMCWPulse(30e6, -math.pi / 2), opl)
    assert i + 1j * q == pytest.approx(np.exp(2j * math.pi * 30e6 / C * opl), abs=1e-5)


def test_attributes_of_the_cosine():
    pulse = AMCWPulse(20e6, 0.5)
    assert (pulse.frequency, pulse.frequency_hz, pulse.phase_offset) == (20e6, 20e6, 0.5)
    assert pulse.omega == pytest.approx(2 * math.pi * 20e6)
    assert pulse.c == 299_792_458
    assert repr(pulse) == "AMCWPulse(frequency_hz=2e+07, phase_offset=0.5)"


def circular_correlation(light: np.ndarray, demodulation: np.ndarray) -> np.ndarray:
    """Mean of light(t - x) demodulation(t) over a period, for every shift x."""
    product = np.conj(np.fft.fft(light)) * np.fft.fft(demodulation)
    return np.fft.ifft(product).real / light.size


def test_square_wave_is_a_triangle():
    """The correlation of two square waves; light 0 or 2, demodulation -1 or 1."""
    n = 1000
    square = np.where(np.arange(n) < n // 2, 1.0, -1.0)
    triangle = circular_correlation(1 + square, square)
    opl = np.arange(n) / n * C / 50e6
    assert called(SquareWave(50e6), opl) == pytest.approx(triangle, abs=1e-5)


@pytest.mark.parametrize(("k", "slots"), [(3, 6), (4, 12), (5, 30)])
def test_hamiltonian_codes_tour_the_cube(k, slots):
    """Edge by edge through different corners and back, never all on nor all off."""
    corners = np.stack([code.code for code in HamiltonianCode.all(k, 1e6)], axis=1)
    assert corners.shape == (slots, k)
    assert set(np.unique(corners)) == {-1, 1}
    assert np.all(np.sum(corners != np.roll(corners, -1, axis=0), axis=1) == 1)
    visited = {tuple(corner) for corner in corners.tolist()}
    assert len(visited) == slots
    left_out = set(itertools.product((-1, 1), repeat=k)) - visited
    assert {(-1,) * k, (1,) * k} <= left_out
    assert len(left_out) == 2**k - slots
    assert np.all(corners.sum(axis=0) == 0)
    if k == 3:  # Shifted by thirds of the period
        for i in range(3):
            assert corners[:, i].tolist() == np.roll(corners[:, 0], 2 * i).tolist()


@pytest.mark.parametrize("code", CODES, ids=repr)
def test_hamiltonian_correlations(code):
    """Light of one slot, n times the mean power, correlated with the demodulation."""
    fine = 40
    slots = code.code.size
    light = np.where(np.arange(slots * fine) < fine, slots, 0.0)
    expected = circular_correlation(light, np.repeat(code.code, fine))
    opl = np.arange(slots * fine) / (slots * fine) * period(code)
    assert called(code, opl) == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("n_bits", range(2, 17))
def test_m_sequence_autocorrelation(n_bits):
    """1 at no shift and -1/N at all others: only a sequence of the largest period has this."""
    sequence = MSequence(n_bits, 1e6)
    code, n = sequence.code, 2**n_bits - 1
    assert code.shape == (n,)
    assert code.sum() == 1
    expected = np.full(n, -1 / n)
    expected[0] = 1
    assert circular_correlation(code, code) == pytest.approx(expected, abs=1e-9)
    opl = np.arange(n) / n * C / 1e6
    assert called(sequence, opl) == pytest.approx(expected, abs=0.01)


def test_m_sequence_between_chips():
    """The correlation of the chips as steps in time, and the mean (1/N)² that follows from it."""
    sequence, fine = MSequence(4, 20e6), 32
    steps = np.repeat(sequence.code, fine)
    opl = np.arange(steps.size) / steps.size * C / 20e6
    expected = circular_correlation(steps, steps)
    assert called(sequence, opl) == pytest.approx(expected, abs=2e-5)
    assert expected.mean() == pytest.approx(1 / 15**2)
    assert called(sequence, opl).mean() == pytest.approx(1 / 15**2, abs=1e-6)
    light = circular_correlation(1 + steps, steps)
    assert light.min() == pytest.approx(0, abs=1e-12)  # As the class says of real light


BAD = {
    "frequency_hz = {}: must be a finite number of hertz from 1e-09 to 1e+18": (
        [0, -20e6, math.nan, math.inf, "20e6", None, True, [2e7], 1e-30, 1e30],
        AMCWPulse,
        SquareWave,
        lambda f: HamiltonianCode(3, f),
        lambda f: HamiltonianCode.all(3, f),
        lambda f: MSequence(3, f),
        lambda f: check_frequency("frequency_hz", f),
    ),
    "phase_offset = {}: must be a finite number of radians": (
        [math.nan, math.inf, "pi", None],
        lambda offset: AMCWPulse(20e6, offset),
        lambda offset: SquareWave(20e6, offset),
    ),
    "k = {}: must be an integer from 3 to 5": (
        [2, 6, -3, 3.0, "3", None, True],
        lambda k: HamiltonianCode(k, 20e6),
        lambda k: HamiltonianCode.all(k, 20e6),
    ),
    "demodulation = {}: must be an integer from 0 to 2": (
        [-1, 3, 0.5],
        lambda demodulation: HamiltonianCode(3, 20e6, demodulation),
    ),
    "n_bits = {}: must be an integer from 2 to 16": (
        [1, 17, -1, 7.5, "7", None],
        lambda n_bits: MSequence(n_bits, 20e6),
    ),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_input(message):
    values, *makers = BAD[message]
    for make, value in itertools.product(makers, values):
        with pytest.raises(ValueError, match=" = ") as error:
            make(value)
        assert str(error.value) == message.format(repr(value))
