"""The Gaussian pulse."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_gaussian_pulse

WIDTHS = (
    formulas.inputs.number("narrow pulse", 0.005, low=0.004, high=0.009),
    formulas.inputs.number("middle pulse", 0.03, low=0.02, high=0.09),
    formulas.inputs.number("wide pulse", 0.7, low=0.4, high=0.9),
)


def test_normalization(submission):
    """The factor in front of the exponential function."""
    for width in WIDTHS:
        came = submission.ask("pulse_normalization", width_opl=width)
        wanted = 1 / (width * np.sqrt(2 * np.pi))
        expect.close(came, wanted, f"normalization for σ = {width}", rtol=1e-5, hint="1/(σ √(2π))")


def test_density(submission):
    """Values of the density, and its integral."""
    for width in WIDTHS:
        t = np.linspace(-6 * width, 6 * width, 2001)
        density = submission.ask("pulse_density", width_opl=width, t=t)
        expect.close(
            density,
            formulas.gaussian(t, width),
            f"density for σ = {width}",
            rtol=1e-4,
            atol=1e-5 / width,
            hint="exp(-t²/(2σ²)) / (σ √(2π)): is σ squared, is the 2 there?",
            x=t,
            x_label="t [m]",
        )
        area = np.trapezoid(density, t)
        expect.close(area, 1.0, f"integral of the density, σ = {width}", rtol=1e-4)


def test_cdf(submission):
    """The integral of the density, from 0 to 1."""
    for width in WIDTHS:
        t = np.linspace(-5 * width, 5 * width, 501)
        came = submission.ask("pulse_cdf", width_opl=width, t=t)
        wanted = formulas.gaussian_cdf(t, width)
        hint = "(1 + erf(t / (σ √2))) / 2"
        what = f"cdf for σ = {width}"
        expect.close(came, wanted, what, rtol=0, atol=2e-6, hint=hint, x=t, x_label="t [m]")


def test_samples_follow_the_density(submission):
    """A histogram of samples against the cdf, and their weights."""
    width = 0.05
    number = 200_000
    xi = np.random.default_rng(submission.seed + 1).random(number, dtype=np.float32)
    came = submission.ask("pulse_samples", width_opl=width, xi=xi)
    expect.shape(came["t"], (number,), "offsets", hint="one for each random number")
    edges = width * np.linspace(-6, 6, 61)
    counts = np.histogram(came["t"], edges)[0]
    beyond = number - counts.sum()
    chances = np.diff(formulas.gaussian_cdf(edges, width))
    expect.histogram(
        np.append(counts, beyond),
        np.append(chances, 1 - chances.sum() + 1e-9),
        "samples in bins of σ/5",
        hint="t = σ √2 erfinv(2ξ - 1): is the √2 there, is it 2ξ - 1?",
    )


def test_weights_are_one(submission):
    """Samples in proportion to the density need no correction."""
    xi = (np.arange(1000) + 0.5) / 1000
    came = submission.ask("pulse_samples", width_opl=0.05, xi=xi)
    hint = "density over density: 1, not the density itself"
    axis = {"x": xi, "x_label": "ξ"}
    expect.close(came["weight"], np.ones(1000), "weights of samples", rtol=1e-5, hint=hint, **axis)


def test_ends_are_finite(submission):
    """A sampler returns 0 once in 2²³ draws, and then the whole pixel is NaN."""
    tiny = 2.0**-24
    xi = np.array([0.0, tiny, 2 * tiny, 0.5, 1 - 2 * tiny, 1 - tiny, 1.0], dtype=np.float32)
    came = submission.ask("pulse_samples", width_opl=0.05, xi=xi)
    hint = "dr.erfinv(±1) is not finite: keep its argument a little inside"
    expect.finite(came["t"], "offsets at ξ = 0, 2⁻²⁴, ..., 1", hint=hint)
    far = np.abs(came["t"]).max() / 0.05
    expect.true(far < 9, f"offsets within 9 σ: one is at {far:g} σ", hint=hint)
