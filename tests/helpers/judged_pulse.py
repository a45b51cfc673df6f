"""An assignment of two problems, a pulse and a modulation, that is judged in a second."""

from __future__ import annotations

from pathlib import Path

from helpers import tiny_assignment

RUBRIC = """
[assignment]
id = "t1"
title = "Tiny"
comparisons = 10
submit = ["*.py"]

[[problem]]
id = "t1.pulse"
title = "A pulse"
file = "pulse.py"
names = ["GaussianPulse"]
withholds = ["tofrender.signals.pulses"]
timeout_s = 3
tests = [
  { id = "test_pulse.py::test_area", points = 2 },
  { id = "test_pulse.py::test_draws", points = 1 },
]

[[problem]]
id = "t1.square"
title = "A square"
file = "square.py"
names = ["AMCWPulse"]
timeout_s = 3
tests = [{ id = "test_square.py::test_one", points = 3 }]
"""

PROBES = """
import mitsuba as mi
import numpy as np

def density(theirs, width, t):
    return theirs.GaussianPulse(width_opl=width).eval(mi.Float(t))

def draws(theirs, width, seed):
    xi = np.random.default_rng(seed).random(1000).astype(np.float32)
    return theirs.GaussianPulse(width_opl=width).sample(mi.Float(xi))[0]

def one(theirs, opl):
    return theirs.AMCWPulse(frequency_hz=1e6).eval(mi.Float(opl))
"""

TEST_PULSE = '''
import numpy as np
import pytest
from tofrender.course.judge import expect

pytestmark = pytest.mark.t1_pulse

def test_area(submission):
    """The density integrates to one."""
    t = np.linspace(-0.5, 0.5, 1001)
    density = submission.ask("density", width=0.05, t=t)
    wanted = np.exp(-(t**2) / 2 / 0.05**2) / 0.05 / np.sqrt(2 * np.pi)
    expect.close(np.trapezoid(density, t), 1, "the integral", hint="is 1/σ there?")
    expect.close(density, wanted, "the density", atol=1e-5, x=t, x_label="t [m]")

def test_draws(submission):
    draws = [submission.ask("draws", width=0.05, seed=submission.seed + k) for k in range(16)]
    expect.estimate(np.mean(draws, axis=1), 0, "the mean of the samples")
'''

TEST_SQUARE = """
import pytest
from tofrender.course.judge import expect

pytestmark = pytest.mark.t1_square

def test_one(submission):
    expect.close(submission.ask("one", opl=0.0), [1.0], "the modulation at 0")
"""

PULSE = """
import drjit as dr
import mitsuba as mi

class GaussianPulse:
    def __init__(self, width_opl):
        self.width_opl = width_opl

    def eval(self, t):
        return dr.exp(-t * t / (2 * self.width_opl**2)) / (self.width_opl * dr.sqrt(dr.two_pi))

    def sample(self, xi):
        return self.width_opl * dr.sqrt(2) * dr.erfinv(2 * xi - 1), mi.Float(1)
"""

SQUARE = """
import drjit as dr

class AMCWPulse:
    def __init__(self, frequency_hz):
        self.frequency_hz = frequency_hz

    def eval(self, opl):
        return dr.cos(dr.two_pi * self.frequency_hz * opl / 299792458.0)
"""


def write_assignment(folder: Path) -> Path:
    """The assignment in a new folder."""
    files = {
        "rubric.toml": RUBRIC,
        "pytest.ini": tiny_assignment.FILES["pytest.ini"],
        "tests/probes.py": PROBES,
        "tests/test_pulse.py": TEST_PULSE,
        "tests/test_square.py": TEST_SQUARE,
    }
    return tiny_assignment.write(folder, files)


def write_submission(folder: Path, pulse: str | None = PULSE, square: str | None = SQUARE) -> Path:
    """A submission in a new folder; a file whose text is None is missing."""
    files = {"pulse.py": pulse, "square.py": square}
    return tiny_assignment.write(folder, {n: text for n, text in files.items() if text is not None})
