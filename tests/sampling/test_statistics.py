"""Tests of noisy estimates: against SciPy, for false alarms, and for power."""

import numpy as np
import pytest
from helpers.support import ALPHA, COMPARISONS, agree, refused

from tofrender.sampling.statistics import p_values, smallest_allowed


def test_p_values_are_scipys():
    stats = pytest.importorskip("scipy.stats")
    noise = np.random.default_rng(2)
    a, b = noise.normal(1, 0.5, (12, 7)), noise.normal(1.2, 1.5, (20, 7))
    welch = stats.ttest_ind(a, b, equal_var=False).pvalue
    assert p_values(a, b, rounding=0) == pytest.approx(welch, rel=1e-9)
    student = stats.ttest_1samp(a, 1.1).pvalue
    assert p_values(a, np.full(7, 1.1), rounding=0) == pytest.approx(student, rel=1e-9)


def alarms(trials: int, alpha: float, shift: float = 1.0, bins: int = 20) -> float:
    """Return the fraction of trials in which `shift` times skewed noise differs from its mean."""
    noise = np.random.default_rng(3)
    light = np.linspace(0.2, 3.0, bins)
    ours = shift * light * noise.gamma(8, 1 / 8, (32, trials, bins))
    theirs = light * noise.gamma(8, 1 / 8, (32, trials, bins))
    return np.mean(p_values(ours, theirs).min(axis=1) < smallest_allowed(alpha, bins))


def test_false_alarms_are_as_rare_as_promised_and_too_bright_is_found():
    """The nominal rate is 1 %. With 1000 trials, 2.2 % is four standard deviations higher."""
    assert alarms(1000, 0.01) <= 0.022
    assert alarms(50, ALPHA / COMPARISONS, shift=1.8) == 1


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_fail(value):
    right = np.random.default_rng(4).normal(1, 0.1, (16, 3))
    wrong = right.copy()
    wrong[5, 1] = value
    assert p_values(wrong, np.ones(3))[1] == 0
    assert p_values(right, wrong)[1] == 0
    assert p_values(wrong, np.ones(3))[0] > 1e-6
    assert p_values(right, np.array([1, value, 1]))[1] == 0
    assert not agree(wrong, np.ones(3))


def test_values_without_noise():
    same = np.ones((4, 2))
    assert p_values(same, np.ones(2)).tolist() == [1, 1]
    assert p_values(same, np.array([1.0, 1.1])).tolist() == [1, 0]
    assert p_values(same, np.array([1.0, 1 + 1e-6])).tolist() == [1, 1]  # rounding
    assert p_values(0 * same, 0 * same).tolist() == [1, 1]


def test_a_missing_reference_fails():
    for missing in (None, np.zeros(3), np.full(3, np.nan)):
        with pytest.raises(AssertionError, match="missing"):
            agree(np.ones((4, 3)), missing)


@pytest.mark.parametrize(
    ("samples", "reference", "message"),
    [
        ((1, 3), (3,), "at least two seeds"),
        ((4, 3), (1, 3), "at least two seeds"),
        ((4, 3), (4,), r"must be \(3,\)"),
    ],
)
def test_bad_shapes(samples, reference, message):
    refused(message, p_values, np.ones(samples), np.ones(reference))
