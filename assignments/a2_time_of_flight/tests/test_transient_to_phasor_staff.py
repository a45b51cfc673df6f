"""Phasors of any transient."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_transient_to_phasor

NAMES = ("I", "Q", "amplitude", "phase", "depth")


def compare(came, wanted, frequency, what):
    """Compare five arrays with the complex numbers `wanted`."""
    expect.true(len(came) == 5, f"{what}: five results; came {len(came)}")
    came = dict(zip(NAMES, came, strict=True))
    scale = np.abs(wanted).max()
    for name, value in zip(NAMES, (wanted.real, wanted.imag, np.abs(wanted)), strict=False):
        expect.close(came[name], value, f"{name} of {what}", rtol=1e-3, atol=1e-4 * scale)
    reach = formulas.SPEED_OF_LIGHT / 2 / frequency
    for name, period, least in (("phase", 2 * np.pi, -np.pi), ("depth", reach, 0.0)):
        values = came[name]
        expect.shape(values, wanted.shape, f"{name} of {what}")
        expect.finite(values, f"{name} of {what}")
        inside = values.min() >= least - 1e-6 and values.max() <= least + period + 1e-6
        text = (
            f"{name} of {what}: from {least:.4g} to {least + period:.4g}; came {values.min():.4g}"
        )
        expect.true(inside, f"{text} to {values.max():.4g}", hint="phase in (-π, π], depth >= 0")
        turns = np.abs(wanted) * np.exp(2j * np.pi * np.asarray(values) / period)
        for part, a, b in (("cos", turns.real, wanted.real), ("sin", turns.imag, wanted.imag)):
            text = f"amplitude x {part} of the {name} of {what}"
            expect.close(a, b, text, rtol=1e-3, atol=1e-3 * scale)


def test_any_transient(submission):
    """A cube of drawn light, size, window and frequency, with a dark pixel."""
    random = submission.random
    height, width = (int(n) for n in random.permutation(5)[:2] + 1)
    bins = int(random.integers(20, 90))
    channels = (1, 3)[int(random.integers(2))]
    start = random.uniform(0.5, 6.0)
    step = random.uniform(0.01, 0.08)
    frequency = float(np.exp(random.uniform(np.log(1e7), np.log(5e8))))
    kind = (np.float32, np.float64)[int(random.integers(2))]
    cube = (random.random((height, width, bins, channels)) ** 8).astype(kind)
    cube[0, 0] = 0
    came = submission.ask(
        "phasors",
        transient=cube,
        frequency_hz=frequency,
        start_opl=float(start),
        bin_width_opl=float(step),
    )
    k = 2 * np.pi * frequency / formulas.SPEED_OF_LIGHT
    waves = np.exp(1j * k * (start + (np.arange(bins) + 0.5) * step))
    wanted = np.einsum("yxtc,t->yxc", cube.astype(np.float64), waves)
    compare(came, wanted, frequency, f"a transient of {bins} bins of {step:.3f} m")


def test_any_channels(submission):
    """Channels of drawn phases, in any number."""
    random = submission.random
    shape = tuple(int(n) for n in random.permutation([2, 3, 5]))
    frequency = float(random.uniform(5e6, 2e8))
    phasors = random.normal(size=shape) + 1j * random.normal(size=shape)
    came = submission.ask(
        "summed_channels", I=phasors.real.copy(), Q=phasors.imag.copy(), frequency_hz=frequency
    )
    compare(came, phasors.sum(axis=-1, keepdims=True), frequency, f"{shape[2]} channels")
