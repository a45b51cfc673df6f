"""Depth maps of drawn returns."""

import formulas_staff as formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_depth_map


def drawn(random):
    """Bins, their width [m], and a response of a few bins."""
    bins = int(random.integers(180, 240))
    width = random.uniform(0.01, 0.05)
    sigma = random.uniform(2.0, 3.5) * width / formulas.SPEED_OF_LIGHT
    return bins, width, sigma, random.choice([0.0, 1.0]) * sigma


def ask(submission, counts, sigma, tail_s, method, width, start=0.0):
    came = submission.ask(
        "estimate_depth",
        counts=counts,
        sigma_s=sigma,
        tail_s=tail_s,
        method=method,
        width=width,
        start=start,
    )
    for name in ("depth", "depth_std"):
        expect.shape(came[name], counts.shape[:2], f"{name} ({method})")
    return came


def test_any_returns(submission):
    """Random signal and background, without noise; the counts are not changed."""
    random = submission.random
    bins, width, sigma, _ = drawn(random)
    shape = tuple(int(n) for n in random.integers(2, 6, 2))
    for tail_s in (0.0, sigma):
        opl = random.uniform(0.4, 0.6, shape) * bins * width
        signal = np.exp(random.uniform(3, 8, shape))
        background = random.uniform(0.05, 2.0, shape)
        counts = formulas.returns(opl, signal, background, sigma, tail_s, width, bins)
        for method, most in (("matched", 0.2), ("ml", 0.05)):
            start = random.uniform(1, 9)
            came = ask(submission, counts, sigma, tail_s, method, width, start)
            off = (2 * came["depth"] - start - opl) / width
            hint = "depth is half of start_opl and the path length from there"
            expect.close(off, 0 * opl, f"error in bins, {method}", atol=most, hint=hint)
            wanted = formulas.deviations(
                submission,
                came["depth_std"],
                formulas.depth_bound(signal, background, sigma, tail_s, width),
                0.1,
                signal=signal,
                background=background,
                sigma_s=sigma,
                tail_s=tail_s,
                width=width,
            )
            expect.close(came["depth_std"], wanted, f"depth_std [m], {method}", rtol=0.1)
            text = "counts after the call of estimate_depth: as they were"
            expect.true(came["kept"], text)


def test_many_counts(submission):
    """Counts of 16 bits whose sum does not fit into 16 bits, and a map without any counts."""
    random = submission.random
    width = 0.02
    sigma = 5.0 * width / formulas.SPEED_OF_LIGHT
    opl = random.uniform(0.45, 0.55, (1, 3)) * 200 * width
    counts = formulas.returns(opl, 200_000.0, 300.0, sigma, 0.0, width, 200)
    counts = np.rint(counts).astype(np.uint16)
    for method in ("matched", "ml"):
        came = ask(submission, counts, sigma, 0.0, method, width)
        off = (2 * came["depth"] - opl) / width
        hint = "sums of 16-bit integers wrap above 65 535"
        what = f"error in bins, {method}, counts of uint16"
        expect.close(off, 0 * opl, what, atol=0.2, hint=hint)
        expect.true(came["kept"], "counts after the call of estimate_depth: as they were")
        came = ask(submission, np.zeros((2, 1, 200)), sigma, 0.0, method, width)
        dark = np.isnan(came["depth"]).all()
        expect.true(dark, f"depth of a map without counts, {method}: NaN")


def test_any_noise(submission):
    """Errors over the bound, for drawn signal, background and response."""
    random = submission.random
    bins, width, sigma, tail_s = drawn(random)
    signal = random.uniform(150, 600)
    background = random.uniform(0.0, 0.02)
    opl = random.uniform(0.4, 0.6, (25, 40)) * bins * width
    counts = random.poisson(formulas.returns(opl, signal, background, sigma, tail_s, width, bins))
    came = ask(submission, counts, sigma, tail_s, "ml", width)
    least = formulas.depth_bound(np.array(signal), background, sigma, tail_s, width)
    off = ((came["depth"] - opl / 2) / least).reshape(-1, 1)
    # The likeliest depth of few counts has a bias far below its error
    expect.close(off.mean(), 0.0, "mean error over the bound", atol=0.25)
    expect.noise(off, 1.14, "errors over the bound", hint="the likelihood of all bins around")


def test_strong_background(submission):
    """Returns that are found by all of their bins, not by the brightest."""
    random = submission.random
    bins = 160
    width = 0.02
    sigma = 4.0 * width / formulas.SPEED_OF_LIGHT
    opl = random.uniform(0.4, 0.6, (20, 20)) * bins * width
    counts = random.poisson(formulas.returns(opl, 70.0, 8.0, sigma, 0.0, width, bins))
    for method in ("matched", "ml"):
        came = ask(submission, counts, sigma, 0.0, method, width)
        far = np.abs(2 * came["depth"] - opl) > 4 * width
        what = f"part of the pixels that are off by more than 4 bins, {method}"
        expect.close(far.mean(), 0.0, what, atol=0.03, hint="correlate, then take the maximum")


def test_matched_noise(submission):
    """The matched filter of noisy counts, which is not their likeliest depth."""
    random = submission.random
    bins, width, sigma, tail_s = drawn(random)
    opl = random.uniform(0.4, 0.6, (12, 12)) * bins * width
    counts = random.poisson(formulas.returns(opl, 150.0, 0.2, sigma, tail_s, width, bins))
    came = ask(submission, counts, sigma, tail_s, "matched", width)
    off = (came["depth"] - formulas.matched(counts, sigma, tail_s, width)) * 2 / width
    hint = "correlation of the counts with the masses of the response, and its greatest value"
    typical = np.sqrt(np.mean(off**2))
    expect.close(typical, 0.0, "distance from the matched filter [bins]", atol=0.04, hint=hint)
