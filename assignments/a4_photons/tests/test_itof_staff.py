"""Taps of drawn light."""

import formulas_staff as formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_itof


def test_any_taps(submission):
    """Taps of random light and harmonics, and their demodulation; arrays are not changed."""
    random = submission.random
    shape = tuple(int(n) for n in random.integers(1, 5, random.integers(1, 4)))
    signal = random.uniform(100, 1e5, shape)
    background = random.uniform(0, 1e5, shape)
    phase = random.uniform(0.02, 6.26, shape)
    contrast = random.uniform(0.1, 1.0)
    taps = int(random.integers(4, 9))
    harmonics = (random.uniform(-0.2, 0.2, random.integers(0, 4))).tolist()
    arguments = {"signal": signal, "background": background, "phase": phase, "contrast": contrast}
    came = submission.ask("expected_taps", taps=taps, harmonics=harmonics, **arguments)
    wanted = formulas.expected_taps(signal, background, phase, contrast, taps, harmonics)
    what = f"electrons of {taps} taps of shape {shape}"
    expect.close(came, wanted, what)
    plain = submission.ask("expected_taps", **arguments)
    wanted = formulas.expected_taps(signal, background, phase, contrast)
    expect.close(plain, wanted, "electrons without taps and harmonics: 4 and none")
    electrons = formulas.expected_taps(signal, background, phase, contrast, taps)
    came = submission.ask("demodulate", taps=electrons, contrast=contrast)
    expect.close(came["phase"], phase, "phase [rad]", rtol=1e-6)
    expect.close(came["amplitude"], signal, "amplitude [electrons]", rtol=1e-6)
    expect.true(came["kept"], "taps after the call of demodulate: as they were")


def test_any_noise(submission):
    """Mean, variance and independence of drawn taps; the seed repeats them."""
    random = submission.random
    means = random.uniform(200, 3000, 4)
    read = random.uniform(5, 40)
    tiled = np.tile(means, (4000, 1))
    came = submission.ask("sample_taps", means=tiled, seed=submission.seed, read_noise=read)
    away = came["found"] - means
    expect.estimate(away, 0 * means, "electrons less their expectation")
    products = away[:, :, None] * away[:, None, :]
    expect.estimate(
        formulas.in_groups(products), np.diag(means + read**2), "covariances of the taps"
    )
    expect.true(came["kept"], "means after the call of sample_taps: as they were")
    text = "electrons under the same seed: the same; under another: others"
    expect.true(came["repeats"], text, hint="all random numbers come from rng")
    few = np.full(4000, 0.5)
    dark = submission.ask("sample_taps", means=few, seed=submission.seed)["found"]
    counts = np.bincount(np.rint(dark).astype(int).clip(0), minlength=3)[:3]
    part = np.exp(-0.5) * np.array([1, 0.5, 0.125])
    expect.histogram(counts, part, "electrons of a dark tap without read noise: 0, 1 or 2")
    low = submission.ask("sample_taps", means=few, seed=submission.seed, read_noise=20.0)["found"]
    text = "dark taps with read noise: some below 0"
    expect.true(low.min() < -5, text, hint="the black level of a converter is not here")


def test_any_deviation(submission):
    """Formula for drawn light, with the defaults."""
    random = submission.random
    signal = random.uniform(1e4, 1e5, 5)
    background = random.uniform(0, 1e4, 5)
    contrast = random.uniform(0.3, 1.0)
    options = {"signal": signal, "background": background, "contrast": contrast}
    came = submission.ask("phase_deviation", **options)
    wanted = formulas.phase_deviation(signal, background, contrast, 4, 0.0)
    expect.close(came, wanted, "deviation of the phase [rad], four taps, no read noise")
    taps = int(random.integers(4, 10))
    read = random.uniform(0, 50)
    came = submission.ask("phase_deviation", taps=taps, read_noise=read, **options)
    wanted = formulas.phase_deviation(signal, background, contrast, taps, read)
    expect.close(came, wanted, f"deviation of the phase [rad], {taps} taps")


def test_any_multipath(submission):
    """Errors of drawn returns, the stronger one the second or the first."""
    random = submission.random
    ratio = random.uniform(0, 3, (3, 4))
    difference = random.uniform(-9, 9, (3, 4))
    came = submission.ask("multipath_phase_error", ratio=ratio, difference=difference)
    wanted = formulas.multipath_phase_error(ratio, difference)
    expect.close(came, wanted, "error of the phase [rad]", rtol=1e-6, atol=1e-9)
