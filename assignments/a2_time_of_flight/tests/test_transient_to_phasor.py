"""Phasors of transients."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_transient_to_phasor

START = formulas.inputs.number("first edge", 3.0, low=2.5, high=3.5)
WIDTH = 0.02
NAMES = ("I", "Q", "amplitude", "phase", "depth")


def random_cube(height=2, width=3, bins=50, channels=3):
    return np.random.default_rng(7).random((height, width, bins, channels)).astype(np.float32)


def convert(submission, cube, frequency_hz, start_opl=START, bin_width_opl=WIDTH):
    came = submission.ask(
        "phasors",
        transient=cube,
        frequency_hz=frequency_hz,
        start_opl=start_opl,
        bin_width_opl=bin_width_opl,
    )
    expect.true(len(came) == 5, f"five results ({', '.join(NAMES)}): came {len(came)}")
    return dict(zip(NAMES, came, strict=True))


def single(k, value=2.0):
    cube = np.zeros((1, 1, 400, 1), np.float32)
    cube[0, 0, k] = value
    return cube, START + (k + 0.5) * WIDTH


def test_real_and_imaginary_part(submission):
    """P = Σ L_k exp(+i 2π f opl_k / c), by bin centers."""
    cube = random_cube()
    frequency = formulas.inputs.number("wave of bins", 400.0, low=300, high=450) * 1e6
    came = convert(submission, cube, frequency)
    opl = START + (np.arange(50) + 0.5) * WIDTH
    k = 2 * np.pi * frequency / formulas.SPEED_OF_LIGHT
    wanted = np.einsum("yxtc,t->yxc", cube.astype(np.float64), np.exp(1j * k * opl))
    hint = "film data: no bin width; bin k is at start_opl + (k + 1/2) bin_width_opl; Q is + sine"
    for name, value in (("I", wanted.real), ("Q", wanted.imag)):
        expect.close(came[name], value, name, rtol=1e-4, atol=1e-3, hint=hint)


def test_amplitude_and_phase(submission):
    """Amplitude and phase of a single arrival."""
    for k in (10, 150, 390):
        cube, opl = single(k)
        came = convert(submission, cube, 30e6)
        wanted = formulas.one_path(2.0, opl, 30e6)
        hint = "amplitude √(I² + Q²), phase atan2(Q, I) in (-π, π]"
        for name in ("amplitude", "phase"):
            value = np.full((1, 1, 1), wanted[name])
            expect.close(came[name], value, f"{name}, opl = {opl:.2f}", rtol=1e-4, hint=hint)


def test_phase_of_half_a_wave(submission):
    """The interval (-π, π] has π and not -π."""
    real = -np.array([[[1.0, 2.0]]])
    zero = np.zeros((1, 1, 2))
    came = submission.ask("summed_channels", I=real, Q=zero, frequency_hz=20e6)
    hint = "atan2(0, -1) is π; the interval is (-π, π]"
    expect.close(came[3], np.full((1, 1, 1), np.pi), "phase of -3 + 0i", rtol=1e-4, hint=hint)


def test_depth_is_never_negative(submission):
    """Half the path length, wrapped to [0, c/2f)."""
    frequency = 30e6
    for k in (10, 150, 250, 390):
        cube, opl = single(k)
        came = convert(submission, cube, frequency)["depth"]
        wanted = np.full((1, 1, 1), formulas.one_path(2.0, opl, frequency)["depth"])
        hint = "c (phase mod 2π) / (4π f): atan2 alone gives negative depths for half of them"
        expect.close(came, wanted, f"depth, opl = {opl:.2f} m", rtol=1e-4, hint=hint)


def test_shapes(submission):
    """(height, width, bins, channels) becomes (height, width, channels)."""
    for shape in ((2, 5, 7, 3), (4, 3, 3, 1)):
        came = convert(submission, np.ones(shape, np.float32), 20e6)
        for name, value in came.items():
            wanted = (shape[0], shape[1], shape[3])
            expect.shape(value, wanted, name, hint="time is the third axis, axis=2")


def test_channels_are_summed_as_phasors(submission):
    """Phases wrap, so their mean means nothing; phasors add."""
    # Two paths of equal light, a little before and after a third, add up to one of its length
    opl = 7.6
    apart = 0.5
    frequency = 20e6
    channels = [(1.0, opl - apart), (0.5, opl), (1.0, opl + apart)]
    paths = [formulas.one_path(*path, frequency) for path in channels]
    I, Q = (np.tile([path[name] for path in paths], (2, 2, 1)) for name in "IQ")  # noqa: E741
    came = submission.ask("summed_channels", I=I, Q=Q, frequency_hz=frequency)
    light = 0.5 + 2 * np.cos(2 * np.pi * frequency * apart / formulas.SPEED_OF_LIGHT)
    hint = "sum I and Q over the channels first, then amplitude, phase and depth of the sums"
    for (name, value), each in zip(
        formulas.one_path(light, opl, frequency).items(), came, strict=True
    ):
        wanted = np.full((2, 2, 1), value)
        expect.close(each, wanted, f"{name} of all channels", rtol=1e-4, hint=hint)
