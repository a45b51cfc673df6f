"""Jitter with drawn responses and histograms."""

import formulas_staff as formulas
import numpy as np
import pytest
from scipy import stats
from test_jitter import compare, compare_masses

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


def test_any_tail(submission):
    """A very long tail, a tail on the early side, and parts left out of 1e-9 to 1e-2."""
    random = submission.random
    sigma = random.uniform(3e-11, 6e-11)
    tail_s = random.uniform(8, 12) * sigma
    for tail in (1e-9, 1e-2):
        found = submission.ask("kernel", sigma_s=sigma, tail_s=tail_s, width=0.03, tail=tail)
        compare(found, sigma, tail_s, 0.03, tail)
    scale = random.uniform(0.02, 0.05)
    found = submission.ask("kernel_of_early_delays", scale=scale, width=0.03, tail=1e-5)
    compare_masses(found, stats.gumbel_l(0.0, scale).cdf, 0.03, 1e-5)


def test_any_detections(submission):
    """Random detections and masses, which are not changed; pixels do not mix."""
    random = submission.random
    for periodic in (False, True):
        for pixels in ((), (1,), (3,), (2, 1, 3)):
            reach = int(random.integers(1, 5))
            shape = (*pixels, 2 * reach + 1 + int(random.choice([0, 3])))
            detections = random.random(shape)
            masses = drawn_masses(random, reach)
            came = submission.ask(
                "add_jitter", detections=detections, masses=masses, periodic=periodic
            )
            wanted = formulas.jittered(detections, masses, periodic)
            hint = "each pixel has a window of its own"
            what = f"stamps of detections of shape {shape}"
            expect.close(came["found"], wanted, what, atol=1e-6, hint=hint)
            text = "detections and masses after the call of add_jitter: as they were"
            expect.true(came["kept"], text)


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
    for size in (0, 1):
        lags = submission.ask("repeated_lags", masses=masses, size=size, calls=1, seed=1)
        right = lags.shape == (1, size)
        text = f"drawn lags for size = {size}: expected shape ({size},), came {lags.shape[1:]}"
        expect.true(right, text)


def test_independent_lags(submission):
    """Counts of lags are multinomial: their covariances, over many calls."""
    random = submission.random
    masses = drawn_masses(random, 2)
    size = 20
    lags = submission.ask(
        "repeated_lags", masses=masses, size=size, calls=2000, seed=submission.seed
    )
    expect.shape(lags, (2000, size), "lags of 2000 calls")
    counts = (lags[..., None] == np.arange(-2, 3)).sum(axis=1)
    away = counts - size * masses
    products = away[:, :, None] * away[:, None, :]
    wanted = size * (np.diag(masses) - np.outer(masses, masses))
    hint = "numbers that are spread evenly, as by strata, are not independent"
    what = f"covariances of the numbers of lags among {size}"
    expect.estimate(formulas.in_groups(products), wanted, what, hint=hint)
