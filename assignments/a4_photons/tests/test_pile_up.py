"""First photons, Coates' correction and its variance."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_pile_up

SCALE = formulas.inputs.number("flux", 1.0, low=0.6, high=1.6)
RATES = SCALE * np.array([0.05, 0.3, 1.2, 0.4, 0.1])
CYCLES = formulas.inputs.integer("cycles", 10_000, low=5000, high=50_000)
SEVERAL = np.stack([RATES, RATES[::-1], 0 * RATES])[:, None]
BINS = {"x": range(5), "x_label": "bin"}


def test_first_photon(submission):
    """P_k = exp(-sum of the rates before k) (1 - exp(-rate_k))."""
    found = submission.ask("first_photon", rates=RATES)["found"]
    hint = "no photon in all bins before, and one or more in this bin"
    expect.close(found, formulas.expected("first_photon"), "probabilities", hint=hint, **BINS)


def test_several_pixels(submission):
    """Bins are the last axis, whatever the others are."""
    rates = SEVERAL
    counts = formulas.expected("several_counts")
    for probe, arguments, wanted in (
        ("first_photon", {"rates": rates}, formulas.expected("several_first_photon")),
        ("coates", {"counts": counts, "cycles": CYCLES}, formulas.expected("several_coates")),
        (
            "coates_variance",
            {"rates": rates, "cycles": CYCLES},
            formulas.expected("several_variance"),
        ),
    ):
        found = submission.ask(probe, **arguments)["found"]
        hint = "shape (..., bin): sums go along the last axis, of each pixel for itself"
        expect.close(found, wanted, f"{probe} of several pixels", hint=hint)


def test_coates(submission):
    """-ln(1 - N_k / (cycles - sum of N before k))."""
    counts = formulas.expected("counts")
    found = submission.ask("coates", counts=counts, cycles=CYCLES)["found"]
    hint = "only the cycles that have not detected before can detect in bin k"
    expect.close(found, formulas.expected("coates"), "corrected rates", hint=hint, **BINS)


def test_last_cycle(submission):
    """The estimate is infinite in the bin where the last cycle detects."""
    counts = np.array([[2, 3, 5, 0], [1, 0, 1, 0]])
    found = submission.ask("coates", counts=counts, cycles=10)["found"]
    text = f"rate where all 10 cycles have detected: infinite; came {found[0, 2]}"
    expect.true(np.isposinf(found[0, 2]), text, hint="-ln 0")
    expect.close(found[1], [np.log(10 / 9), 0, np.log(9 / 8), 0], "rates of the other pixel")


def test_variance(submission):
    """(exp(rate_k) - 1) / (cycles exp(-sum of the rates before k))."""
    found = submission.ask("coates_variance", rates=RATES, cycles=CYCLES)["found"]
    hint = "few cycles are left in late bins; bright bins are worse than Poisson counts"
    wanted = formulas.expected("variance")
    expect.close(found, wanted, "variance of the corrected rates", hint=hint, **BINS)
