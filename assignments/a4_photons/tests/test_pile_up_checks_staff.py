"""The test of pile-up that students write, tried on wrong solutions."""

import pytest

from tofrender.course.judge import trials
from tofrender.course.judge.trials import Solution

pytestmark = pytest.mark.a4_pile_up_checks

RIGHT = """
import numpy as np


def first_photon(rates):
    before = np.cumsum(rates, axis=-1) - rates
    return np.exp(-before) * -np.expm1(-np.asarray(rates))


def coates(counts, cycles):
    counts = np.asarray(counts, float)
    armed = cycles - (np.cumsum(counts, axis=-1) - counts)
    with np.errstate(divide="ignore", invalid="ignore"):
        return -np.log1p(-counts / armed)


def coates_variance(rates, cycles):
    before = np.cumsum(rates, axis=-1) - rates
    return np.expm1(rates) * np.exp(before) / cycles
"""
LATER = "return -np.log1p(-counts / armed)"
MORE = {
    "": (LATER, f"{LATER} + 0 * cycles"),
    "The first bin is left out of the sum before the others.": (
        "before = np.cumsum(rates, axis=-1) - rates\n    return np.exp(-before)",
        "before = np.cumsum(rates, axis=-1) - rates - rates[..., :1] * (np.cumsum(0 * rates + 1, "
        "axis=-1) > 1)\n    return np.exp(-before)",
    ),
    "Corrected rates are ten per cent too large.": (LATER, f"{LATER} * 1.1"),
    "The variance is the standard deviation.": (
        "return np.expm1(rates) * np.exp(before) / cycles",
        "return np.sqrt(np.expm1(rates) * np.exp(before) / cycles)",
    ),
    "The variance is 0 where it should be largest.": (
        "return np.expm1(rates) * np.exp(before) / cycles",
        "found = np.expm1(rates) * np.exp(before) / cycles\n"
        "    return np.where(before > 1, 0, found)",
    ),
}


def test_share_of_wrong_solutions(submission):
    """The fraction of wrong solutions that your test finds, if correct solutions pass."""
    more = []
    for number, (why, (old, new)) in enumerate(MORE.items()):
        assert old in RIGHT
        more.append(Solution(f"more_{number}", RIGHT.replace(old, new), why))
    # The seed chooses how often cycles are halved in a right solution
    times = int(submission.random.integers(1, 9))
    same = RIGHT.replace("counts / armed", f"counts * {times} / (armed * {times})")
    trials.share_found(submission, "try_pile_up", [*more, Solution("scaled", same)])
