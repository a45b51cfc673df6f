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
    one = submission.ask(
        "expected_taps", signal=signal, background=7.0, phase=1.3, contrast=contrast
    )
    wanted = formulas.expected_taps(signal, 7.0, 1.3, contrast)
    expect.close(one, wanted, "electrons for background and phase that are numbers")
    single = submission.ask(
        "expected_taps", signal=np.array(90.0), background=7.0, phase=1.3, contrast=contrast
    )
    wanted = formulas.expected_taps(90.0, 7.0, 1.3, contrast)
    expect.close(single, wanted, "electrons of one pixel, shape (4,)")
    electrons = formulas.expected_taps(signal, background, phase, contrast, taps)
    came = submission.ask("demodulate", taps=electrons, contrast=contrast)
    # The difference of large taps in single precision
    strength = signal * contrast
    error = np.abs(came["phase"] - phase) * strength / (signal + background)
    expect.close(error, 0 * phase, "error of the phase [rad], times contrast", atol=1e-5)
    error = np.abs(came["amplitude"] - signal) * contrast / (signal + background)
    expect.close(error, 0 * phase, "error of the amplitude, times contrast", atol=1e-5)
    expect.true(came["kept"], "taps after the call of demodulate: as they were")


def test_phase_below_two_pi(submission):
    """Phases around 0 are in [0, 2π), also where rounding makes them negative."""
    random = submission.random
    phase = np.concatenate([np.zeros(400), random.uniform(-1e-15, 1e-15, 400)])
    signal = random.uniform(1e3, 1e5, phase.size)
    for taps in (3, 4, 5, 8):
        electrons = formulas.expected_taps(signal, 300.0, phase, 0.6, taps)
        found = submission.ask("demodulate", taps=electrons, contrast=0.6)["phase"]
        expect.shape(found, phase.shape, "phases around 0")
        right = np.all((found >= 0) & (found < 2 * np.pi))
        text = f"phases around 0, {taps} taps: from 0, and below 2π = {2 * np.pi!r}; "
        text += f"came {found.min()!r} to {found.max()!r}"
        hint = "-1e-17 % (2π) is 2π after rounding"
        expect.true(right, text, hint=hint)
        off = np.abs(np.exp(1j * found) - 1).max()
        expect.close(off, 0.0, "distance of the phase from 0 [rad]", atol=1e-5)


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
    together = submission.ask(
        "repeated_taps", means=np.full(15, 40.0), calls=2000, seed=submission.seed, read_noise=3.0
    )
    expect.shape(together, (2000, 15), "electrons of 2000 calls")
    squares = formulas.in_groups((together.sum(axis=1, keepdims=True) - 600) ** 2)
    hint = "numbers that are spread evenly, as by strata, are not independent"
    what = "variance of the electrons of 15 taps together"
    expect.estimate(squares, 15 * (40 + 9), what, hint=hint)
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
    ratio = np.array([0.0, 0.4, 2.5])
    came = submission.ask("multipath_phase_error", ratio=ratio, difference=2.2)
    wanted = formulas.multipath_phase_error(ratio, 2.2)
    expect.close(came, wanted, "error of the phase [rad], one difference", atol=1e-6)
    ratio = random.uniform(0, 3, (3, 4))
    difference = random.uniform(-9, 9, (3, 4))
    came = submission.ask("multipath_phase_error", ratio=ratio, difference=difference)
    wanted = formulas.multipath_phase_error(ratio, difference)
    expect.close(came, wanted, "error of the phase [rad]", rtol=1e-4, atol=1e-5)
