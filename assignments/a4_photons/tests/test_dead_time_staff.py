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
            dark = rates.shape[0] - 1
            rates[dark] = 0
            if not periodic:
                wanted = [formulas.by_patterns(row, dead, paralysable)[0] for row in rates]
            elif paralysable:
                wanted = [formulas.paralysable_running(row, dead) for row in rates]
            else:
                wanted = [formulas.free_running(row, dead) for row in rates[:dark]]
                wanted.append(np.zeros(rates.shape[1]))
            came = submission.ask(
                "armed_detections",
                rates=rates,
                dead=dead,
                paralysable=paralysable,
                periodic=periodic,
            )
            what = f"detections with a dead time of {dead} of {rates.shape[1]} bins"
            what += ", paralyzable" * paralysable + ", periodic" * periodic
            hint = "a pixel without light has no detections"
            expect.close(came["found"], np.array(wanted), what, atol=1e-6, hint=hint)
            text = "rates after the call of armed_detections: as they were"
            expect.true(came["kept"], text)
            single = np.array([[0.4], [1.3]])
            came = submission.ask(
                "armed_detections", rates=single, dead=0, paralysable=paralysable, periodic=periodic
            )
            expect.close(came["found"], -np.expm1(-single), "detections of cycles of one bin")


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
    dead = int(random.integers(4, 40))
    came = submission.ask(
        "sample_counts", rates=rates, cycles=cycles, dead=dead, seed=submission.seed
    )
    wanted = cycles * formulas.first_photon(rates[0])
    expect.estimate(came["found"], wanted, f"first photons of {cycles} cycles")
    text = "detections of a pixel: at most one a cycle"
    expect.true(came["found"].sum(axis=1).max() <= cycles, text)


def test_independent_pixels(submission):
    """The variance of the counts of all pixels together, over many calls."""
    random = submission.random
    rates = random.uniform(0.2, 0.9, 5)
    dead = int(random.integers(1, 4))
    pixels = 12
    cycles = 6
    calls = 500
    counts = submission.ask(
        "repeated_counts",
        rates=np.tile(rates, (pixels, 1)),
        cycles=cycles,
        dead=dead,
        calls=calls,
        seed=submission.seed,
    )
    expect.shape(counts, (calls, pixels, 5), f"counts of {calls} calls")
    mean, second = formulas.by_patterns(rates, dead)
    away = counts.sum(axis=(1, 2)) - pixels * cycles * mean.sum()
    variance = pixels * cycles * (second.sum() - mean.sum() ** 2)
    hint = "numbers that are spread evenly, as by strata, are not independent"
    squares = formulas.in_groups((away**2)[:, None])
    expect.estimate(squares, variance, "variance of the counts of all pixels", hint=hint)


def test_edges(submission):
    """No cycles, one cycle, and a pixel without light."""
    rates = np.array([[0.0, 0.0, 0.0], [0.7, 0.1, 0.9]])
    for cycles in (0, 1, 30):
        came = submission.ask("sample_counts", rates=rates, cycles=cycles, dead=1, seed=3)
        counts = came["found"]
        expect.shape(counts, (2, 3), f"counts of {cycles} cycles")
        expect.close(counts[0], np.zeros(3), f"counts of {cycles} cycles without light")
        text = (
            f"counts of {cycles} cycles: from 0 to {cycles}; came {counts.min()} to {counts.max()}"
        )
        expect.true(counts.min() >= 0 and counts.max() <= cycles, text)
