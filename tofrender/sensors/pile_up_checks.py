"""Consistency check of first-photon probabilities, Coates' correction, and its variance."""

from typing import Any

import numpy as np

# Number of laser cycles and of pixels in the simulation
CYCLES = 4000
PIXELS = 4000

# Rates of two pixels, photons per bin and cycle
RATES = np.array([[0.05, 0.3, 1.2, 0.4, 0.1], [0.3, 0.1, 0.0, 0.2, 0.5]])

# Largest error of a mean, in standard errors
FAR = 5.0


def check_pile_up(pile_up: Any) -> None:
    """Raise an AssertionError if `first_photon`, `coates` or `coates_variance` is wrong.

    First photons of simulated cycles must follow the probabilities. The mean of their correction
    must equal the rates, and its variance must equal the computed variance.

    Example:
        >>> from tofrender.sensors import pile_up
        >>> check_pile_up(pile_up)
    """
    # Probabilities
    given = RATES.copy()
    found = np.asarray(pile_up.first_photon(given))
    assert found.shape == RATES.shape, "a probability for each rate"
    assert np.all((found >= 0) & (found <= 1)), "probabilities are from 0 to 1"
    faint = np.asarray(pile_up.first_photon(np.array([1e-12, 1e-11])))
    assert np.allclose(faint, [1e-12, 1e-11], rtol=1e-6, atol=0), "first_photon of faint light"

    # Compare with simulated cycles
    rng = np.random.default_rng(1)
    for rates, p in zip(RATES, found, strict=True):
        # Cycles with their first photon in bin k
        armed = np.full(PIXELS, CYCLES)
        counts = np.zeros((PIXELS, rates.size), np.int64)
        for k, rate in enumerate(rates):
            counts[:, k] = rng.binomial(armed, -np.expm1(-rate))
            armed = armed - counts[:, k]
        _agree(counts / CYCLES, p, "first_photon")

        # Mean of the correction
        before = counts.copy()
        corrected = np.asarray(pile_up.coates(counts, CYCLES))
        assert np.array_equal(counts, before), "coates changes its counts"
        _agree(corrected, rates, "coates")

        # Variance of the correction
        variance = np.asarray(pile_up.coates_variance(rates.copy(), CYCLES))
        ratio = corrected.var(axis=0) / np.where(rates > 0, variance, 1)
        scatter = FAR * np.sqrt(2 / PIXELS)
        assert np.all(np.abs(ratio - 1)[rates > 0] < scatter), "coates_variance"
        few = counts[:3].astype(np.uint16)
        same = np.asarray(pile_up.coates(few, CYCLES))
        assert np.allclose(same, corrected[:3]), "coates of unsigned integers"

    # Shapes and special values
    both = np.asarray(pile_up.coates_variance(given, CYCLES))
    assert both.shape == RATES.shape, "a variance for each rate"
    assert np.allclose(both[1], variance), "coates_variance of two pixels"
    assert np.array_equal(given, RATES), "rates are changed"
    blind = np.asarray(pile_up.coates(np.array([3, 7, 0]), 10))
    assert np.isinf(blind[1]), "coates, where all that are left detect"


def _agree(samples: np.ndarray, mean: np.ndarray, what: str) -> None:
    """Compare the mean of samples with its expected value."""
    error = samples.std(axis=0) / np.sqrt(len(samples)) + 1e-3 * mean + 1e-9
    assert np.all(np.abs(samples.mean(axis=0) - mean) < FAR * error), what
