"""The test of pulses that students write, tried on other pulses."""

import pytest

from tofrender.course.judge import trials
from tofrender.course.judge.trials import Solution

pytestmark = pytest.mark.a2_pulse_checks

DECAY = """
import drjit as dr
import mitsuba as mi


class GaussianPulse:
    def __init__(self, width_opl):
        self.width_opl, self.support = width_opl, (0.0, 12 * width_opl)

    def eval(self, t):
        return dr.select(t >= 0, dr.exp(-t / self.width_opl) / self.width_opl, 0)

    def cdf(self, t):
        return dr.select(t >= 0, 1 - dr.exp(-t / self.width_opl), 0)

    def sample(self, xi):
        return -self.width_opl * dr.log(dr.maximum(1 - xi, 2**-24)), dr.ones(mi.Float, dr.width(xi))
"""
EDITS = {
    "Samples of a pulse that is not symmetric are mirrored in time.": (
        "return -self.width_opl * dr.log(",
        "return self.width_opl * dr.log(",
    ),
    "The cdf is what is still to come.": ("1 - dr.exp(", "dr.exp("),
    "The density is negative where it should be small.": (
        "/ self.width_opl, 0)\n\n    def cdf",
        "/ self.width_opl - 0.02 / self.width_opl, 0)\n\n    def cdf",
    ),
    "The last tenth of the pulse is never drawn.": (
        "dr.log(dr.maximum(1 - xi",
        "dr.log(dr.maximum(1 - 0.9 * xi",
    ),
}


def test_share_of_wrong_pulses(submission):
    """The share of wrong pulses that your test finds, if right ones pass."""
    more = [Solution("decay", DECAY)]
    for number, (why, (old, new)) in enumerate(EDITS.items()):
        assert DECAY.count(old) == 1
        more.append(Solution(f"decay_{number}", DECAY.replace(old, new), why))
    trials.share_found(submission, "try_pulse", more)
