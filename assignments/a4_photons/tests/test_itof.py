"""Taps of a correlation camera."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_itof

CONTRAST = formulas.inputs.number("contrast", 0.7, low=0.4, high=0.9)
SIGNALS = np.array([6000.0, 20_000.0, 100_000.0])
HARMONICS = [0.0, 1 / 9, 0.0, 1 / 25]
RATIOS = np.array([0.0, 0.35, 0.35, 0.9, 1.5, 0.5])
DIFFERENCES = np.array([1.0, 1.9, -1.9, 2.8, 3.0, 7.0])
PHASES = np.array([0.3, 1.4, 2.6, 3.5, 4.9, 6.1])


def test_expected_taps(submission):
    """m_k = S / N (1 + M cos(φ - 2π k / N)) + B / N."""
    for taps in (3, 4, 5, 8):
        came = submission.ask(
            "expected_taps",
            signal=np.full(6, 6000.0),
            background=2000.0,
            phase=PHASES,
            contrast=CONTRAST,
            taps=taps,
        )
        wanted = formulas.expected(f"taps_{taps}")
        hint = "signal and background are divided among the taps; taps are the first axis"
        expect.close(came, wanted, f"electrons of {taps} taps", hint=hint)


def test_harmonics(submission):
    """Two rectangles correlate to a triangle, with harmonics 1 / h²."""
    options = {"contrast": CONTRAST, "taps": 4, "harmonics": HARMONICS}
    came = submission.ask(
        "expected_taps", signal=np.full(6, 1e4), background=0.0, phase=PHASES, **options
    )
    wanted = formulas.expected("taps_with_harmonics")
    hint = "the first harmonic of the list is a_2; the contrast multiplies all of them"
    expect.close(came, wanted, "electrons of taps with harmonics", hint=hint)


def test_noise_of_taps(submission):
    """Shot noise and read noise."""
    means = np.tile([900.0, 30.0, 300.0], (4000, 1))
    came = submission.ask("sample_taps", means=means, seed=submission.seed, read_noise=12.0)
    taps = came["found"]
    expect.shape(taps, means.shape, "electrons")
    expect.estimate(taps, means[0], "electrons", hint="noise has the mean 0")
    hint = "Poisson: the variance is the mean; read noise adds its square"
    squares = formulas.in_groups((taps - means) ** 2)
    expect.estimate(squares, means[0] + 144, "variance of the electrons", hint=hint)


def test_full_well(submission):
    """A tap shows no more than its full well."""
    means = np.array([[2000.0, 100.0], [900.0, 5000.0]])
    came = submission.ask("sample_taps", means=means, seed=1, read_noise=5.0, full_well=1500.0)
    full = came["found"][[0, 1], [0, 1]]
    expect.close(full, [1500.0, 1500.0], "taps of more electrons", hint="after all noise")
    others = came["found"][[0, 1], [1, 0]]
    text = f"taps of fewer electrons: below 1200; came {others}"
    expect.true(others.max() < 1200, text)


def test_demodulate(submission):
    """Amplitude S and phase in [0, 2π), whatever the background."""
    for taps in (3, 4, 8):
        electrons = formulas.expected(f"taps_{taps}")
        came = submission.ask("demodulate", taps=electrons, contrast=CONTRAST)
        hint = "sum of m_k exp(+2π i k / N): its phase is φ, not -φ; phases below 0 get 2π more"
        expect.close(came["phase"], PHASES, f"phase of {taps} taps [rad]", hint=hint)
        hint = "2 |P| / M, for the sum P over all taps"
        expect.close(came["amplitude"], np.full(6, 6000.0), "amplitude [electrons]", hint=hint)


def test_phase_deviation(submission):
    """√(2 (S + B + N σ²)) / (S M)."""
    for taps in (4, 5, 8):
        came = submission.ask(
            "phase_deviation",
            signal=SIGNALS,
            background=2000.0,
            contrast=CONTRAST,
            taps=taps,
            read_noise=15.0,
        )
        wanted = formulas.expected(f"deviation_{taps}")
        hint = "background is not modulated, but has noise; each tap is read once"
        expect.close(came, wanted, f"deviation of the phase, {taps} taps [rad]", hint=hint)


def test_multipath(submission):
    """arg(1 + r exp(i Δ))."""
    came = submission.ask("multipath_phase_error", ratio=RATIOS, difference=DIFFERENCES)
    wanted = formulas.expected("multipath")
    hint = "phasors add, phases do not; atan2 knows all quadrants"
    expect.close(came, wanted, "error of the phase [rad]", atol=1e-6, hint=hint)
