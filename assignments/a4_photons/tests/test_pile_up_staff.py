"""Pile-up of drawn rates and histograms."""

import formulas_staff as formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_pile_up


def drawn(random, most=1.5):
    """Rates of a drawn shape, some of them 0."""
    shape = tuple(int(n) for n in random.integers(2, 6, random.integers(1, 4)))
    rates = random.uniform(0, most, (*shape, int(random.integers(4, 12))))
    return rates * (random.random(rates.shape) > 0.2)


def test_any_rates(submission):
    """Probabilities and variances of random rates, which are not changed."""
    random = submission.random
    one_bin = random.uniform(0.1, 1.0, (3, 1))
    one_pixel = random.uniform(0.1, 1.0, (1, 6))
    for rates in (drawn(random), one_bin, one_pixel):
        cycles = int(random.integers(1000, 1_000_000))
        for probe, wanted, more in (
            ("first_photon", formulas.first_photon(rates), {}),
            ("coates_variance", formulas.coates_variance(rates, cycles), {"cycles": cycles}),
        ):
            came = submission.ask(probe, rates=rates, **more)
            expect.close(came["found"], wanted, f"{probe} of rates of shape {rates.shape}")
            expect.true(came["kept"], f"rates after the call of {probe}: as they were")
    bright = np.array([0.5, 900.0, 3.0, 1e4])
    found = submission.ask("first_photon", rates=bright)["found"]
    hint = "exp of a large sum overflows; exp of its negative does not"
    expect.close(found, formulas.first_photon(bright), "very bright bins", atol=1e-9, hint=hint)


def test_faint_rates(submission):
    """Rates from 1e-12 on keep six digits."""
    rates = np.geomspace(1e-12, 1e-6, 8) * submission.random.uniform(1.0, 1.5, 8)
    found = submission.ask("first_photon", rates=rates)["found"]
    hint = "1 - exp(-rate) loses digits of small rates; NumPy has expm1 and log1p"
    expect.close(found, formulas.first_photon(rates), "small probabilities", rtol=1e-6, hint=hint)


def test_any_histogram(submission):
    """Random histograms of several integer types, which are not changed."""
    random = submission.random
    for kind in (np.uint16, np.uint32, np.int64):
        rates = drawn(random, 0.8)
        cycles = int(random.integers(100, 60_000))
        p = formulas.first_photon(rates)
        whole = np.append(p, 1 - p.sum(axis=-1, keepdims=True), axis=-1).clip(0)
        counts = random.multinomial(cycles, whole / whole.sum(axis=-1, keepdims=True))
        counts = counts[..., :-1].astype(kind)
        came = submission.ask("coates", counts=counts, cycles=cycles)
        wanted = formulas.coates(counts, cycles)
        certain = np.isfinite(np.maximum.accumulate(wanted, axis=-1))
        found = came["found"]
        what = f"rates from counts of {kind.__name__}"
        expect.shape(found, counts.shape, what)
        hint = "unsigned integers wrap below 0: make them floats first"
        expect.close(found[certain], wanted[certain], what, hint=hint)
        expect.true(came["kept"], "counts after the call of coates: as they were")
    counts = np.array([[40_000, 30_000, 20_000, 5000], [200, 100, 60_000, 39_000]], np.uint16)
    found = submission.ask("coates", counts=counts, cycles=100_000)["found"]
    wanted = formulas.coates(counts, 100_000)
    hint = "sums of 16-bit integers wrap above 65 535"
    expect.close(found, wanted, "rates from many counts of uint16", hint=hint)
    found = submission.ask("coates", counts=np.zeros((2, 3), np.int64), cycles=9)["found"]
    expect.close(found, np.zeros((2, 3)), "rates of dark pixels")
    cycles = int(random.integers(2**31, 2**32))
    counts = np.array([cycles - 3, 2, 1], np.uint32)
    found = submission.ask("coates", counts=counts, cycles=cycles)["found"]
    hint = "single precision holds no integer of more than 24 bits"
    expect.close(found[:2], np.log([cycles / 3, 3]), "rates after many cycles", hint=hint)
    expect.true(np.isposinf(found[2]), f"rate of the last of {cycles} cycles: infinite", hint=hint)
