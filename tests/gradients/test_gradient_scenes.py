"""The scenes of the table of gradients, as they are rendered, against their closed forms.

This finds a scene that is not what its form says, before any derivative is asked for: values over
seeds, and differences of renders with the same random numbers.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_cases import CASES
from helpers.gradient_of import differences, render
from helpers.support import over_seeds
from oracles.gradients import Phasor, derived

SEEDS = range(1, 5)
NOISY = {"index": 0.2}
"""Rows whose differences are noisy, since light takes the other way at an interface: how much."""


@pytest.mark.parametrize("name", CASES)
def test_weights_of_tensors_are_those_of_what_is_seen(name):
    """A loss by entries of the tensor is the weighted sum of its mean over pixels and colours."""
    case = CASES[name]
    tensor = case.output(mi.render(case.load(), spp=16, seed=1))
    seen = case.mean(tensor)
    for what, weights in case.weights().items():
        entries = np.array(case.tensor_weights(weights, tensor.shape), dtype=np.float64)
        loss = entries @ np.array(tensor.array, dtype=np.float64)
        scale = np.abs(weights * seen).sum()
        assert loss == pytest.approx(weights @ seen, abs=1e-5 * scale), what


@pytest.mark.parametrize("name", CASES)
def test_renders_are_what_the_forms_say(name):
    case = CASES[name]
    expected, change = case.expected()
    values = over_seeds(lambda seed: render(case, seed=seed), SEEDS).mean(axis=0)
    found = over_seeds(lambda seed: differences(case, seed=seed), SEEDS).mean(axis=0)
    for what, weights in case.weights().items():
        if not isinstance(case.seen, Phasor):
            assert weights @ values == pytest.approx(weights @ expected, rel=2e-3), what
        tolerance = NOISY.get(case.row, 5e-3)
        assert weights @ found == pytest.approx(weights @ change, rel=tolerance), what
    assert values == pytest.approx(expected, abs=3e-3 * np.abs(expected).max())
    # Differences of the form leave out as much of a curve as those of the renders
    right, left = (
        case.at(theta).seen.value(derived(case.form, theta))
        for theta in (case.theta + case.step, case.theta - case.step)
    )
    apart = (right - left) / (2 * case.step)
    tolerance = NOISY.get(case.row, 1e-2) * np.abs(apart).max()
    assert found == pytest.approx(apart, abs=tolerance)
