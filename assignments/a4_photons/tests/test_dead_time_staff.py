"""Dead time with drawn rates."""

import formulas_staff as formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_dead_time


def drawn(random, most=1.2):
    """Rates (pixel, bin), some of them 0, and a dead time."""
    rates = random.uniform(0, most, [int(n) for n in random.integers([2, 5], [5, 9])])
    rates *= random.random(rates.shape) > 0.15
    return rates, int(random.integers(1, rates.shape[1]))


def test_any_detections(submission):
    """All patterns of photons, or the stationary chain."""
    random = submission.random
    for paralysable in (False, True):
        for periodic in (False, True):
            rates, dead = drawn(random)
            rates[:, 0] += 0.05
            if not periodic:
                wanted = [formulas.by_patterns(row, dead, paralysable)[0] for row in rates]
            elif paralysable:
                wanted = [formulas.paralysable_running(row, dead) for row in rates]
            else:
                wanted = [formulas.free_running(row, dead) for row in rates]
            came = submission.ask(
                "armed_detections",
                rates=rates,
                dead=dead,
                paralysable=paralysable,
                periodic=periodic,
            )
            what = f"detections with a dead time of {dead} of {rates.shape[1]} bins"
            what += ", paralyzable" * paralysable + ", periodic" * periodic
            expect.close(came["found"], np.array(wanted), what, rtol=1e-4, atol=1e-9)
            text = "rates after the call of armed_detections: as they were"
            expect.true(came["kept"], text)


def test_any_counts(submission):
    """Means and covariances of counts, pixel by pixel."""
    random = submission.random
    rates = random.uniform(0.1, 1.0, (2, int(random.integers(4, 8))))
    rates *= 2.0 / rates.sum(axis=1, keepdims=True)  # so that late bins count, too
    dead = int(random.integers(1, rates.shape[1] - 1))
    cycles = int(random.integers(40, 80))
    pixels = 2000
    tiled = np.repeat(rates, pixels, axis=0)
    came = submission.ask(
        "sample_counts", rates=tiled, cycles=cycles, dead=dead, seed=submission.seed
    )
    expect.shape(came["found"], tiled.shape, "simulated counts")
    counts = came["found"].reshape(2, pixels, -1).swapaxes(0, 1)
    moments = [formulas.by_patterns(row, dead) for row in rates]
    mean = cycles * np.array([one for one, _ in moments])
    what = f"counts of {cycles} cycles with a dead time of {dead} bins"
    expect.estimate(counts, mean, what)
    away = counts - mean
    products = away[..., :, None] * away[..., None, :]
    wanted = [cycles * (second - np.outer(one, one)) for one, second in moments]
    expect.estimate(formulas.in_groups(products), np.array(wanted), f"covariances of {what}")
    between = (away[:, 0].sum(axis=1) * away[:, 1].sum(axis=1))[:, None]
    expect.estimate(
        formulas.in_groups(between), 0.0, "covariance of two pixels", hint="pixels are independent"
    )


def test_many_cycles(submission):
    """Only the first photon of a cycle, and more cycles than counts fit into 16 bits."""
    random = submission.random
    rates = np.tile(random.uniform(0.3, 1.0, 4), (40, 1))
    cycles = 200_000
    came = submission.ask("sample_counts", rates=rates, cycles=cycles, dead=4, seed=submission.seed)
    wanted = cycles * formulas.first_photon(rates[0])
    expect.estimate(came["found"], wanted, f"first photons of {cycles} cycles")
    text = "detections of a pixel: at most one a cycle"
    expect.true(came["found"].sum(axis=1).max() <= cycles, text)
