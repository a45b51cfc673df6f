"""Fog that absorbs and scatters, and polarizers."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_fog

MU_S = formulas.inputs.number("scattering", 2.0, low=1.5, high=2.5)
G = formulas.inputs.number("mean cosine", 0.7, low=0.6, high=0.75)
LENGTH = formulas.inputs.number("length in fog", 3.0, low=2.5, high=3.5)


def test_absorption(submission):
    """Each bin is weaker by the mean of exp(-mu_a s) over its lengths."""
    cube = np.random.default_rng(5).random((2, 3, 12, 3)).astype(np.float32)
    start = 1.5
    width = 0.4
    for mu_a in (0.0, 0.3, 2.5):
        came = submission.ask(
            "absorbed", transient=cube, mu_a=mu_a, start_opl=start, bin_width_opl=width
        )
        wanted = cube * formulas.absorbed(12, mu_a, start, width)[:, None]
        hint = "the mean over the bin, (exp(-mu_a a) - exp(-mu_a b)) / (mu_a w), not its center"
        expect.close(came, wanted, f"light at mu_a = {mu_a} 1/m", rtol=1e-3, hint=hint)


def test_turns_follow_the_phase_function(submission):
    """A histogram of cosines against the integral of Henyey and Greenstein's function."""
    edges = np.linspace(-1, 1, 41)
    for k, g in enumerate((G, 0.0, -0.5)):
        xi = np.random.default_rng(submission.seed + k).random(100_000)
        came = submission.ask("turns", xi=xi, g=g)
        expect.shape(came, xi.shape, "cosines", hint="one for each random number")
        expect.finite(came, f"cosines for g = {g}", hint="0 / 0 at g = 0?")
        hint = "the inverse of the cdf; the mean of the cosine is g, its sign included"
        counts = np.histogram(came, edges)[0]
        beyond = xi.size - counts.sum()
        expect.true(beyond == 0, f"cosines for g = {g}: {beyond} are not in [-1, 1]", hint=hint)
        chances = np.diff(formulas.turn_cdf(edges, g))
        expect.histogram(counts, chances, f"cosines for g = {g}, in bins", hint=hint)


def test_photons_wander(submission):
    """⟨z⟩ and ⟨r²⟩ after a path length, exact to all orders of scattering."""
    came, _ = submission.ask("clouds", seed=submission.seed, mu_s=MU_S, g=G, opl=LENGTH, count=4000)
    exact = formulas.wandered(MU_S, G, LENGTH)
    hint = "distances -ln(1 - ξ) / mu_s; the last one ends where the path has its length"
    expect.estimate(came[:, 0], exact[0], "mean of z [m]", hint=hint)
    r2 = came[:, 1:].sum(axis=1)
    expect.estimate(r2, exact[1:].sum(), "mean of r² [m²]", hint=hint)


def test_polarizer(submission):
    """Malus' law, three polarizers, and circular light."""
    half = np.pi / 2
    quarter = np.pi / 4
    hint = "(S0 + S1 cos 2a + S2 sin 2a) / 2 passes, polarized along the axis"

    def behind(stokes, angle):
        return submission.ask("behind_polarizer", stokes=np.array(stokes), angle=angle)

    first = behind([[2.0, 0.0, 0.0, 0.0]], 0.0)
    expect.close(first, [[1.0, 1.0, 0, 0]], "unpolarized light", rtol=0, atol=1e-6, hint=hint)
    across = behind([[1.0, 1.0, 0.0, 0.0]], half)
    expect.close(across, np.zeros((1, 4)), "light across", rtol=0, atol=1e-6, hint=hint)
    between = behind([[1.0, 1.0, 0.0, 0.0]], quarter)
    expect.close(between, [[0.5, 0, 0.5, 0]], "light at 45°", rtol=0, atol=1e-6, hint=hint)
    circular = behind([[1.0, 0.0, 0.0, 1.0]], quarter)
    expect.close(circular, [[0.5, 0, 0.5, 0]], "circular light", rtol=0, atol=1e-6, hint=hint)
