"""Any fog, any polarizer."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_fog


def test_any_absorption(submission):
    """Cubes of drawn light, windows and absorptions, thin and dense."""
    random = submission.random
    for mu_a in np.exp(random.uniform(np.log([1e-4, 0.1, 1.0]), np.log([1e-3, 1.0, 5.0]))):
        height, width, bins = (int(n) for n in random.permutation(6)[:3] + 1)
        start = random.uniform(0.0, 3.0)
        step = random.uniform(0.1, 0.6)
        cube = random.random((height, width, bins, int(random.integers(1, 4))))
        came = submission.ask(
            "absorbed",
            transient=cube,
            mu_a=float(mu_a),
            start_opl=float(start),
            bin_width_opl=float(step),
        )
        share = formulas.absorbed(bins, mu_a, start, step)
        what = f"light at mu_a = {mu_a:.3g} 1/m, bins of {step:.2f} m from {start:.2f} m"
        hint = "the mean of exp(-mu_a s) over each bin; time is the third axis"
        expect.close(came, cube * share[:, None], what, rtol=1e-3, hint=hint)


def test_any_turn(submission):
    """Even random numbers become cosines with even shares, for any g, and at both ends."""
    random = submission.random
    count = 4000
    xi = (random.permutation(count) + random.random(count)) / count
    even = (np.arange(count) + 0.5) / count
    for g in (*random.uniform([-0.9, 0.2, 0.8], [-0.2, 0.8, 0.95]), 0.0, 1e-4):
        came = submission.ask("turns", xi=xi, g=float(g))
        expect.shape(came, xi.shape, "cosines", hint="one for each random number")
        shares = np.sort(formulas.turn_cdf(came, g))
        what = f"shares below the cosines, in order, for evenly spread ξ and g = {g:.4g}"
        hint = "the inverse of the cdf, 2ξ - 1 at g = 0"
        expect.close(shares, even, what, rtol=0, atol=2e-3, hint=hint)
    for g in (-0.99, 0.0, float(random.uniform(0.1, 0.9)), 0.99):
        ends = submission.ask("turns", xi=np.array([0.0, 1.0, 0.5]), g=g)
        expect.finite(ends, f"cosines at ξ = 0 and 1, g = {g:.2f}")
        far = float(np.abs(ends).max())
        expect.true(far <= 1, f"cosines at ξ = 0 and 1, g = {g:.2f}: in [-1, 1]; came ±{far:.9g}")


def test_any_cloud(submission):
    """Drawn fog: four moments, the share that met nothing, nobody faster than light."""
    random = submission.random
    mu_s = float(random.uniform(0.6, 2.0))
    g = float(random.choice([-0.4, 0.3, 0.6, 0.8]))
    s = float(random.uniform(1.5, 2.5))
    count = 3000
    seed = int(random.integers(1 << 30))
    came, p = submission.ask("clouds", seed=seed, mu_s=mu_s, g=g, opl=s, count=count)
    fog = f"mu_s = {mu_s:.2f} 1/m, g = {g}, s = {s:.2f} m"
    hint = "turn evenly around the direction, by a new cosine each time; start along +z"
    what = f"means of z, x², y², z² at {fog}"
    expect.estimate(came, formulas.wandered(mu_s, g, s), what, hint=hint)
    away = np.linalg.norm(p, axis=1).max()
    expect.true(away <= s * (1 + 1e-6), f"a photon is {away:.6g} m away after {s:.6g} m")
    straight = np.sum(np.abs(p - [0, 0, s]).max(axis=1) < 1e-9 * s)
    chance = np.exp(-mu_s * s)
    hint = "after distances with the density mu_s exp(-mu_s t), exp(-mu_s s) have met nothing"
    counts = np.array([straight, count - straight])
    expect.histogram(counts, [chance, 1 - chance], f"photons straight on, {fog}", hint=hint)


def test_any_photon(submission):
    """Equal seeds give equal clouds; clear air; a single photon."""
    random = submission.random
    seed = int(random.integers(1 << 30))
    s = float(random.uniform(0.5, 4.0))
    first, again = submission.ask("wandered", seed=seed, mu_s=1.5, g=0.5, opl=s, count=50)
    expect.shape(first, (50, 3), "positions")
    what = "positions by the same random numbers once more"
    expect.close(again, first, what, rtol=1e-6, hint="draw from `random` and from nothing else")
    other, _ = submission.ask("wandered", seed=seed + 1, mu_s=1.5, g=0.5, opl=s, count=50)
    apart = np.abs(np.asarray(other) - first).max()
    what = "positions by other random numbers: expected others, came the same"
    expect.true(apart > 1e-3, what, hint="draw from `random`")
    clear, _ = submission.ask("wandered", seed=seed, mu_s=0.0, g=0.5, opl=s, count=3)
    expect.close(clear, [[0, 0, s]] * 3, "positions in clear air", rtol=1e-6, atol=1e-9)
    alone, _ = submission.ask("wandered", seed=seed, mu_s=1.0, g=0.0, opl=s, count=1)
    expect.shape(alone, (1, 3), "the position of one photon")


def test_any_polarizer(submission):
    """Light of drawn polarization, in arrays of any shape, through drawn polarizers."""
    random = submission.random
    for shape in ((4,), (3, 4), (2, 5, 3, 4)):
        stokes = random.normal(size=shape)
        length = np.linalg.norm(stokes[..., 1:], axis=-1)
        stokes[..., 0] = length * random.uniform(1.0, 3.0, shape[:-1])
        angle = float(random.uniform(-np.pi, np.pi))
        came = submission.ask("behind_polarizer", stokes=stokes, angle=angle)
        wanted = formulas.polarized(stokes, angle)
        what = f"Stokes vectors of shape {shape} behind a polarizer at {np.degrees(angle):.1f}°"
        hint = "components are in the last axis; angles of Stokes vectors count twice"
        expect.close(came, wanted, what, rtol=1e-4, atol=1e-4, hint=hint)
