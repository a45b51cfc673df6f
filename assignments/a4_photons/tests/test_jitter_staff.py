"""Jitter with drawn responses and histograms."""

import formulas_staff as formulas
import numpy as np
import pytest
from test_jitter import compare

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_jitter


def drawn_masses(random, reach):
    masses = random.random(2 * reach + 1)
    return masses / masses.sum()


def test_any_response(submission):
    """Narrow and wide bins, with and without a tail."""
    random = submission.random
    for share in (0.05, 0.6, 6.0):
        sigma = np.exp(random.uniform(np.log(2e-11), np.log(3e-10)))
        tail_s = random.choice([0.0, random.uniform(0.3, 3.0) * sigma])
        width = random.uniform(0.8, 1.2) * share * sigma * formulas.SPEED_OF_LIGHT
        for tail in (1e-6, 1e-3):
            found = submission.ask("kernel", sigma_s=sigma, tail_s=tail_s, width=width, tail=tail)
            compare(found, sigma, tail_s, width, tail)


def test_any_detections(submission):
    """Random detections and masses; the detections are not changed."""
    random = submission.random
    for periodic in (False, True):
        reach = int(random.integers(1, 5))
        shape = (*random.integers(1, 4, random.integers(0, 3)).tolist(), 2 * reach + 1 + 3)
        detections = random.random(shape)
        masses = drawn_masses(random, reach)
        came = submission.ask("add_jitter", detections=detections, masses=masses, periodic=periodic)
        wanted = formulas.jittered(detections, masses, periodic)
        expect.close(came["found"], wanted, f"stamps of detections of shape {shape}", atol=1e-9)
        expect.true(came["kept"], "detections after the call of add_jitter: as they were")


def test_any_lags(submission):
    """Drawn masses, some of them 0, and independent lags."""
    random = submission.random
    masses = drawn_masses(random, int(random.integers(1, 6)))
    masses[random.integers(0, masses.size)] = 0
    masses /= masses.sum()
    reach = masses.size // 2
    came = submission.ask("sample_jitter", masses=masses, size=30_000, seed=submission.seed)
    lags = came["found"]
    expect.shape(lags, (30_000,), "drawn lags")
    inside = np.abs(lags).max() <= reach
    expect.true(inside, f"drawn lags: from {-reach} to {reach}; came {lags.min()} to {lags.max()}")
    counts = np.bincount(lags + reach, minlength=masses.size)
    expect.histogram(counts, masses, f"drawn lags, {-reach} to {reach} bins")
    away = lags - masses @ np.arange(-reach, reach + 1)
    products = formulas.in_groups((away[1:-1] * away[:-2])[:29_950, None])
    expect.estimate(products, 0.0, "covariance of a lag and the next", hint="each is independent")
