"""The modulation of a correlation sensor."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_amcw_pulse

OPL = np.linspace(0, 40, 401)
SLOW = formulas.inputs.number("slow wave", 20.0, low=15, high=35) * 1e6  # Hz
FAST = formulas.inputs.number("fast wave", 73.0, low=55, high=90) * 1e6
OFFSET = formulas.inputs.number("offset", 0.4, low=0.3, high=1.2)


def modulation(submission, frequency_hz=20e6, phase_offset=0.0):
    return submission.ask(
        "modulation", frequency_hz=frequency_hz, phase_offset=phase_offset, opl=OPL
    )


def expect_cosine(came, frequency_hz, offset, hint):
    wanted = np.cos(2 * np.pi * frequency_hz * OPL / formulas.SPEED_OF_LIGHT + offset)
    what = f"m(opl) at {frequency_hz / 1e6:g} MHz, phase_offset = {offset:.3f}"
    axis = {"x": OPL, "x_label": "opl [m]"}
    expect.close(came["values"], wanted, what, rtol=0, atol=5e-4, hint=hint, **axis)


def test_angular_frequency(submission):
    """ω = 2π f."""
    for frequency in (1e6, FAST):
        came = modulation(submission, frequency)
        expect.close(came["omega"], 2 * np.pi * frequency, "omega [rad/s]", rtol=1e-5, hint="2π f")


def test_cosine(submission):
    """Light is weighted by a cosine of its path length."""
    for frequency in (SLOW, FAST):
        hint = "cos(ω opl / c) with c = 299 792 458 m/s; the whole path counts, not its half"
        expect_cosine(modulation(submission, frequency), frequency, 0.0, hint)


def test_offset(submission):
    """The offset is in radians and added; with -π/2 the weight is plus sine."""
    for offset in (-np.pi / 2, OFFSET):
        hint = "cos(ω opl/c + phase_offset), radians; phase_offset = -π/2 gives + sin(ω opl/c)"
        expect_cosine(modulation(submission, SLOW, offset), SLOW, offset, hint)


def test_unambiguous_range(submission):
    """Depth, half a path, repeats after c / 2f."""
    for frequency in (SLOW, FAST):
        came = modulation(submission, frequency)["range"]
        wanted = formulas.SPEED_OF_LIGHT / 2 / frequency
        expect.close(came, wanted, "unambiguous range [m]", rtol=1e-5, hint="c / (2 f)")
