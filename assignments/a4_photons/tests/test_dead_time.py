"""Detections with a dead time: closed forms, all patterns of photons, and simulated counts."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_dead_time

RATES = np.array([[0.2, 0.9, 0.4, 0.1, 0.7, 0.3, 0.5], [0.6, 0.1, 0.3, 0.8, 0.2, 0.4, 0.1]])
RATES = RATES * formulas.inputs.number("flux with dead time", 1.0, low=0.7, high=1.4)
DEAD = formulas.inputs.integer("dead time", 2, low=2, high=3)
PIXELS = 2000


def detections(submission, rates, dead, paralysable=False, periodic=False):
    return submission.ask(
        "armed_detections", rates=rates, dead=dead, paralysable=paralysable, periodic=periodic
    )["found"]


def test_no_dead_time(submission):
    """Each bin that has a photon detects."""
    hint = "1 - exp(-rate): two photons of a bin are one detection"
    for paralysable in (False, True):
        found = detections(submission, RATES, 0, paralysable)
        expect.close(found, -np.expm1(-RATES), "detections without dead time", hint=hint)


def test_non_paralysable(submission):
    """Photons within the dead time are lost, and change nothing."""
    wanted = formulas.expected("non_paralysable")
    found = detections(submission, RATES, DEAD)
    hint = f"a bin is dead if one of the {DEAD} bins before it has detected"
    expect.close(found, wanted, "detections, non-paralyzable", hint=hint)


def test_paralysable(submission):
    """Photons within the dead time prolong it."""
    wanted = formulas.expected("paralysable")
    found = detections(submission, RATES, DEAD, paralysable=True)
    hint = f"none of the {DEAD} bins before has a photon, detected or not"
    expect.close(found, wanted, "detections, paralyzable", hint=hint)


def test_constant_light(submission):
    """Rates per time of r / (1 + r τ) and r exp(-r τ), in fine bins of a free-running SPAD."""
    bins = 60
    rate = 0.002
    dead = 40
    rates = np.full((1, bins), rate)
    hint = "periodic: the dead time of the last bins goes on in the first"
    found = detections(submission, rates, dead, periodic=True)
    p = -np.expm1(-rate)
    wanted = np.full((1, bins), p / (1 + p * dead))
    expect.close(found, wanted, "constant light, non-paralyzable", hint=hint)
    found = detections(submission, rates, dead, paralysable=True, periodic=True)
    wanted = p * np.exp(-rate * dead) + 0 * rates
    expect.close(found, wanted, "constant light, paralyzable", hint=hint)


def test_free_running(submission):
    """A dead time that extends into the next cycle."""
    wanted = formulas.expected("free_running")
    found = detections(submission, RATES, DEAD, periodic=True)
    hint = "periodic and non-paralyzable: each bin depends on the others, all around the cycle"
    expect.close(found, wanted, "detections of a free-running SPAD", hint=hint)


def counts_of(submission, rates, cycles, dead):
    """Counts of many equal pixels."""
    tiled = np.tile(rates, (PIXELS, 1))
    came = submission.ask(
        "sample_counts", rates=tiled, cycles=cycles, dead=dead, seed=submission.seed
    )
    expect.shape(came["found"], tiled.shape, "simulated counts")
    return came


def test_mean_counts(submission):
    """Means of simulated counts, with and without a dead time."""
    for dead, mean in zip((0, DEAD, RATES.shape[1]), formulas.expected("means"), strict=True):
        came = counts_of(submission, RATES[0], 50, dead)
        wanted = 50 * mean
        what = f"counts of 50 cycles with a dead time of {dead} bins"
        expect.estimate(came["found"], wanted, what, x=range(7), x_label="bin")
        text = f"type of the simulated counts: integers; came {came['found'].dtype}"
        expect.true(came["whole"], text)


def test_noise_of_counts(submission):
    """Variances and covariances: dead time makes counts less noisy than Poisson's."""
    mean = formulas.expected("non_paralysable")[0]
    second = formulas.expected("second_moments")
    counts = counts_of(submission, RATES[0], 50, DEAD)["found"]
    away = counts - 50 * mean
    products = away[:, :, None] * away[:, None, :]
    wanted = 50 * (second - np.outer(mean, mean))
    hint = "each cycle has photons of its own, and a dead time of its own"
    expect.estimate(
        formulas.in_groups(products), wanted, "covariances of the counts of bins", hint=hint
    )


def test_random_numbers(submission):
    """Equal generators give equal counts, and the rates are not changed."""
    came = counts_of(submission, RATES[1], 5, 1)
    expect.true(came["kept"], "rates after the call of sample_counts: as they were")
    text = "counts under the same seed: the same; under another: others"
    expect.true(came["repeats"], text, hint="all random numbers come from rng")
