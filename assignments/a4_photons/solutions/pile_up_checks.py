"""A test of pile-up by closed forms for two bins, and by a loop over the bins of more."""

from __future__ import annotations

import math

import numpy as np


def check_pile_up(pile_up) -> None:
    """Raise an AssertionError that describes the first violation of the contract."""
    rng = np.random.default_rng(5)
    for shape in ((6,), (3, 5), (2, 2, 7)):
        rates = rng.uniform(0.0, 1.5, shape)
        rates[..., 1] = 0
        rates[..., 2] *= 1e-12
        given = rates.copy()
        cycles = 10**9
        p = np.asarray(pile_up.first_photon(rates))
        variance = np.asarray(pile_up.coates_variance(rates, cycles))
        assert np.array_equal(rates, given), "rates are changed"
        assert p.shape == variance.shape == shape, "shape"
        expected = np.empty(shape)
        spread = np.empty(shape)
        for where in np.ndindex(shape[:-1]):
            armed = 1.0
            for k, rate in enumerate(rates[where]):
                part = -math.expm1(-rate)
                expected[(*where, k)] = armed * part
                spread[(*where, k)] = part / ((1 - part) * armed * cycles)
                armed *= math.exp(-rate)
        assert np.allclose(p, expected, rtol=1e-7, atol=0), "first_photon"
        assert np.allclose(variance, spread, rtol=1e-7, atol=0), "coates_variance"
        counts = np.rint(cycles * expected).astype(np.int64)
        given = counts.copy()
        found = np.asarray(pile_up.coates(counts, cycles))
        assert np.array_equal(counts, given), "counts are changed"
        assert found.shape == shape, "shape"
        assert np.all(np.abs(found - rates) <= 1e-6), "coates"
    small = np.array([5, 9, 2], np.uint16)
    half = np.asarray(pile_up.coates(small, 40))
    wanted = [-math.log(1 - 5 / 40), -math.log(1 - 9 / 35), -math.log(1 - 2 / 26)]
    assert np.allclose(half, wanted), "coates of unsigned integers"
    assert np.isposinf(np.asarray(pile_up.coates(np.array([3, 4]), 7))[1]), "the last cycle"
