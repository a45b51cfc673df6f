"""The Cramér-Rao bound of a depth, where it has a closed form."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_bound

SIGMA_OPL = formulas.inputs.number("width of the response", 0.06, low=0.04, high=0.09)
SIGMA = SIGMA_OPL / formulas.SPEED_OF_LIGHT
SIGNALS = np.array([[10.0, 100.0, 1000.0], [5.0, 50.0, 500.0]])
BACKGROUNDS = (0.3, np.array([0.1, 1.0, 10.0]))


def bound(submission, signal, background, width, tail_s=0.0, sigma_s=SIGMA):
    return submission.ask(
        "depth_bound",
        signal=signal,
        background=background,
        sigma_s=sigma_s,
        tail_s=tail_s,
        width=width,
    )


def test_gaussian_in_fine_bins(submission):
    """σ / (2 √S) without background."""
    signal = np.array([1.0, 20.0, 100.0, 5000.0])
    found = bound(submission, signal, 0.0, SIGMA_OPL / 40)
    wanted = SIGMA_OPL / (2 * np.sqrt(signal))
    ratios = {"2": "depth is half the path length", "1/2": "divided by 2 twice"}
    axis = {"x": signal, "x_label": "signal [counts]"}
    hint = "1 / (2 √I), and I is proportional to S"
    expect.close(found, wanted, "bound [m]", rtol=1e-3, ratios=ratios, hint=hint, **axis)


def test_bins_lose_little(submission):
    """Bins of width w add w² / (12 σ²) to the variance."""
    width = 0.5 * SIGMA_OPL
    found = bound(submission, np.array([400.0]), 0.0, width)
    wanted = SIGMA_OPL / 40 * np.sqrt(1 + (width / SIGMA_OPL) ** 2 / 12)
    hint = "the slope of P_k is the density at the bin's start less that at its end"
    expect.close(found, [wanted], "bound with bins of σ / 2 [m]", rtol=3e-4, hint=hint)


def test_much_background(submission):
    """I = S² / (4 √π σ³ b) for much background of b per meter."""
    width = SIGMA_OPL / 40
    per_meter = 1e7 / SIGMA_OPL
    found = bound(submission, np.array([100.0]), per_meter * width, width)
    information = 100.0**2 / (4 * np.sqrt(np.pi) * SIGMA_OPL**3 * per_meter)
    hint = "(S dP/dt)² over the variance of the bin, S P + b"
    expect.close(found, [0.5 / np.sqrt(information)], "bound [m]", rtol=2e-3, hint=hint)


def test_no_signal(submission):
    """Without signal nothing is known."""
    for background, width in ((0.5, 0.02), (0.0, 0.02), (0.0, 4 * SIGMA_OPL)):
        found = bound(submission, np.array([0.0, 10.0]), background, width)
        text = f"bound without signal: infinite; came {found[0]} for {background} counts of "
        text += f"background per bin and bins of {width:g} m"
        expect.true(np.isposinf(found[0]), text, hint="0/0 in bins that expect nothing")
        expect.finite(found[1], f"bound with signal in bins of {width:g} m")


def test_shapes(submission):
    """Signal of any shape, and background that broadcasts to it."""
    for background, wanted in zip(BACKGROUNDS, formulas.expected("bounds"), strict=True):
        found = bound(submission, SIGNALS, background, 0.02)
        expect.close(found, wanted, "bounds [m]", rtol=1e-3)
