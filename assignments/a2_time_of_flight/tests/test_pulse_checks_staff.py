"""The test of pulses that students write, tried on other pulses."""

import numpy as np
import pytest

from tofrender.course.judge import trials
from tofrender.course.judge.trials import Solution

pytestmark = pytest.mark.a2_pulse_checks

PULSE = """
import drjit as dr
import mitsuba as mi


class GaussianPulse:
    def __init__(self, width_opl):
        self.width_opl = SCALE * width_opl
        self.support = (0.0, 12 * self.width_opl)

    def eval(self, t):
        return dr.select(t >= 0, dr.exp(-t / self.width_opl) / self.width_opl, 0)

    def cdf(self, t):
        return dr.select(t >= 0, 1 - dr.exp(-t / self.width_opl), 0)

    def sample(self, xi):
        return -self.width_opl * dr.log(dr.maximum(1 - xi, 2**-24)), dr.ones(mi.Float, dr.width(xi))
"""
EVAL = "dr.exp(-t / self.width_opl) / self.width_opl"
CDF = "1 - dr.exp(-t / self.width_opl)"
ONES = "dr.ones(mi.Float, dr.width(xi))"
SAMPLE = "-self.width_opl * dr.log(dr.maximum(1 - xi, 2**-24))"
RIGHT = {
    "as it is": [],
    "backwards": [("1 - xi", "xi")],
    "folded": [("1 - xi", "1 - dr.minimum(3 * xi - dr.floor(3 * xi), 1)")],
    "later": [
        ("(0.0, 12 * self.width_opl)", "(3 * self.width_opl, 15 * self.width_opl)"),
        (
            "(self, t):\n        return",
            "(self, t):\n        t = t - 3 * self.width_opl\n        return",
        ),
        (SAMPLE, f"3 * self.width_opl {SAMPLE}"),
    ],
    "mirrored": [
        ("(0.0, 12 * self.width_opl)", "(-12 * self.width_opl, 0.0)"),
        (f"t >= 0, {EVAL}", f"t <= 0, {EVAL.replace('-t', 't')}"),
        (f"t >= 0, {CDF}, 0", "t <= 0, dr.exp(t / self.width_opl), 1"),
        ("-self.width_opl * dr.log(", "self.width_opl * dr.log("),
    ],
}
WRONG = {
    "Samples of a pulse that is not symmetric are mirrored in time.": (SAMPLE, SAMPLE[1:]),
    "The cdf is what is still to come.": (CDF, CDF[4:]),
    "The cdf is a tenth too small.": (CDF, f"0.9 * ({CDF})"),
    "The cdf is that of a pulse of twice the width.": (CDF, CDF.replace("-t", "-0.5 * t")),
    "The density is negative where it should be small.": (EVAL, f"{EVAL} - 4e-4 / self.width_opl"),
    "The density integrates to 1.2.": (EVAL, f"1.2 * {EVAL}"),
    "The last tenth of the pulse is never drawn.": ("1 - xi", "1 - 0.9 * xi"),
    "Samples are too far apart, by half.": (SAMPLE, f"-1.5 * {SAMPLE[1:]}"),
    "Samples have the right mean, but half the spread.": (
        SAMPLE,
        f"0.5 * self.width_opl - 0.5 * {SAMPLE[1:]}",
    ),
    "Samples come late, by half a width.": (SAMPLE, f"0.5 * self.width_opl {SAMPLE}"),
    "The end ξ = 1 is not finite.": ("dr.maximum(1 - xi, 2**-24)", "1 - xi"),
    "The end ξ = 0 is not finite.": ("dr.maximum(1 - xi, 2**-24)", "xi"),
    "The weights are 2.": (ONES, f"2 * {ONES}"),
    "Weights are not 1 for the later half.": (ONES, "dr.select(xi > 0.5, mi.Float(0.5), 1)"),
    "A fifth of the pulse lies outside of its support.": ("12 * self", "1.6 * self"),
}


def test_share_of_wrong_pulses(submission):
    """The fraction of wrong pulses that your test finds, if correct pulses pass."""
    random = submission.random
    more = []
    for number, (edits, why) in enumerate(
        [
            *((edits, "") for edits in RIGHT.values()),
            *(([edit], why) for why, edit in WRONG.items()),
        ]
    ):
        scale = np.exp(random.uniform(np.log(0.1), np.log(40.0)))  # the probe's width is 0.05 m
        text = PULSE.replace("SCALE", f"{scale:.6g}")
        for old, new in edits:
            assert old in text
            text = text.replace(old, new)
        more.append(Solution(f"pulse_{number}", text, why))
    trials.share_found(submission, "try_pulse", more)
