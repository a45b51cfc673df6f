"""Depth from histograms, without noise and with it."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_depth_map

WIDTH = 0.02
BINS = 160
SIGMA = formulas.inputs.number("response of the depth map [ps]", 180.0, low=150, high=220) * 1e-12
TAIL = 1.3 * SIGMA
SIGNALS = np.array([[50.0, 100, 200], [400, 800, 1600]])
BACKGROUND = formulas.inputs.number("background of the depth map", 0.4, low=0.2, high=0.8)


def estimate(submission, counts, method, tail_s=0.0, sigma_s=SIGMA, width=WIDTH):
    """Depth and its standard deviation, of the right shape."""
    came = submission.ask(
        "estimate_depth", counts=counts, sigma_s=sigma_s, tail_s=tail_s, method=method, width=width
    )
    for name in ("depth", "depth_std"):
        expect.shape(came[name], counts.shape[:2], f"{name} ({method})")
    return came


def expected(opl, signal, background, tail_s=0.0):
    return formulas.returns(opl, signal, background, SIGMA, tail_s, WIDTH, BINS)


def drawn_places(random, shape):
    """Path lengths anywhere in a bin, away from the ends."""
    return random.uniform(0.4 * BINS, 0.6 * BINS, shape) * WIDTH


def bins_off(came, opl):
    """Error of the path length in bins."""
    return (2 * came["depth"] - opl) / WIDTH


def test_matched_filter(submission):
    """The strongest return of each pixel, to a tenth of a bin."""
    opl = drawn_places(np.random.default_rng(1), (4, 5))
    counts = expected(opl, 300.0, BACKGROUND) + expected(opl - 30 * WIDTH, 100.0, 0.0)
    came = estimate(submission, counts, "matched")
    hint = "bin k is at (k + 1/2) width; half of it is depth; a parabola through three values"
    expect.close(bins_off(came, opl), 0 * opl, "error in bins, matched", atol=0.1, hint=hint)


def test_likeliest(submission):
    """The greatest likelihood, to a fiftieth of a bin."""
    opl = drawn_places(np.random.default_rng(2), (4, 5))
    counts = expected(opl, 300.0, BACKGROUND) + expected(opl - 30 * WIDTH, 100.0, 0.0)
    came = estimate(submission, counts, "ml")
    hint = "maximum of sum (N ln m - m) for m = S P(t) + b, not only on the grid of bins"
    expect.close(bins_off(came, opl), 0 * opl, "error in bins, ml", atol=0.02, hint=hint)
    default = estimate(submission, counts, None)
    expect.close(default["depth"], came["depth"], "depth [m] without a method, as by ml", rtol=1e-9)


def test_delay_of_the_response(submission):
    """A response with a tail is late in the mean, and depth is without that."""
    opl = drawn_places(np.random.default_rng(3), (3, 4))
    counts = expected(opl, 300.0, BACKGROUND, TAIL)
    hint = "correlate with the masses of the response, whose element 0 bins late is light on time"
    for method, most in (("matched", 0.15), ("ml", 0.02)):
        came = estimate(submission, counts, method, TAIL)
        off = bins_off(came, opl)
        expect.close(off, 0 * opl, f"error in bins, {method}, with tail", atol=most, hint=hint)


def test_noise(submission):
    """Errors of the likeliest depth agree with the bound."""
    random = submission.random
    opl = drawn_places(random, (25, 40))
    counts = random.poisson(expected(opl, 250.0, BACKGROUND / 10))
    came = estimate(submission, counts, "ml")
    least = formulas.expected("bound_of_noise")
    off = ((came["depth"] - opl / 2) / least).reshape(-1, 1)
    expect.estimate(off, 0.0, "mean error over the bound", hint="a bias")
    hint = "the matched filter has 1.24 times the bound without background, the likelihood 1.00"
    expect.noise(off, 1.14, "errors over the bound", hint=hint)


def test_confidence(submission):
    """`depth_std` is the bound for the signal and background of the pixel."""
    random = np.random.default_rng(4)
    opl = drawn_places(random, (2, 3))
    counts = expected(opl, SIGNALS, BACKGROUND)
    for method in ("matched", "ml"):
        came = estimate(submission, counts, method)["depth_std"]
        wanted = formulas.deviations(
            submission,
            came,
            formulas.expected("bounds_of_pixels"),
            0.06,
            signal=SIGNALS,
            background=BACKGROUND,
            sigma_s=SIGMA,
            tail_s=0.0,
            width=WIDTH,
        )
        hint = "signal: counts around the peak less the background there; background: the others"
        expect.close(came, wanted, f"depth_std [m], {method}", rtol=0.06, hint=hint)


def test_dark_pixels(submission):
    """The depth of pixels without counts is NaN; other pixels are not disturbed."""
    opl = drawn_places(np.random.default_rng(5), (2, 2))
    counts = expected(opl, 300.0, 0.0)
    counts[0, 1] = 0
    for method in ("matched", "ml"):
        came = estimate(submission, counts, method)
        depth = came["depth"][0, 1]
        std = came["depth_std"][0, 1]
        right = np.isposinf(std)
        if not right:
            # Points for a wrong bound without signal are lost in a4.bound
            own = submission.ask(
                "depth_bound",
                signal=np.array([[0.0, 10.0]]),
                background=0.0,
                sigma_s=SIGMA,
                tail_s=0.0,
                width=WIDTH,
            )
            right = np.array_equal(own[0, 0], std, equal_nan=True)
        text = f"depth and depth_std of a dark pixel: NaN and infinite; came {depth} and {std}"
        expect.true(np.isnan(depth) and right, text)
        lit = came["depth"][[0, 1, 1], [0, 0, 1]]
        expect.close(lit, opl[[0, 1, 1], [0, 0, 1]] / 2, "depth beside it [m]", atol=0.1 * WIDTH)
