"""A test of pulses by histograms: masses of bins from the density, the cdf and the samples."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

BINS, FINE, SAMPLES = 40, 50, 40_000


def check_pulse(pulse) -> None:
    """Raise an AssertionError that describes the first violation of the contract."""
    first, last = pulse.support
    edges = np.linspace(first, last, BINS + 1)
    step = (last - first) / (BINS * FINE)
    middle = first + (np.arange(BINS * FINE) + 0.5) * step
    density = numbers(pulse.eval(mi.Float(middle)))
    assert np.all(density >= 0), "negative density"
    masses = density.reshape(BINS, FINE).sum(axis=1) * step
    assert abs(masses.sum() - 1) < 0.01, f"the integral of the density is {masses.sum():.3f}"
    from_cdf = np.diff(numbers(pulse.cdf(mi.Float(edges))))
    assert np.abs(from_cdf - masses).max() < 0.01, "cdf and density disagree"

    strata = (np.arange(SAMPLES) + np.random.default_rng(1).random(SAMPLES)) / SAMPLES
    strata[[0, -1]] = 0, 1
    t, weight = pulse.sample(mi.Float(strata))
    assert dr.is_array_v(weight), "weights are no array"
    assert np.allclose(numbers(weight), 1, atol=1e-3), "weights are not 1"
    t = numbers(t)
    counts = np.histogram(t, edges)[0] / SAMPLES
    assert np.abs(counts - masses).max() < 0.01, "samples and density disagree"


def numbers(values) -> np.ndarray:
    """As NumPy has them, all of them finite."""
    values = np.array(values, dtype=float)
    assert np.all(np.isfinite(values)), "not finite"
    return values
