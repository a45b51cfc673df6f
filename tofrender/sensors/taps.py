"""Taps of a correlation camera: expectation, noise, phase, and errors of the phase."""

from typing import Any

import numpy as np

from ..signals.phasors import phase_of, wrap


def correlation(angle: Any, contrast: float, harmonics: Any = ()) -> np.ndarray:
    """Return the relative sensitivity of a tap at a phase difference [rad], of any shape.

    g(a) = 1 + contrast (cos a + sum of a_h cos(h a)), with the harmonics a_2, a_3, ...
    """
    waves = [a * np.cos(h * angle) for h, a in enumerate((1.0, *harmonics), 1)]
    return 1 + contrast * np.sum(waves, axis=0)


def expected_taps(
    signal: Any, background: Any, phase: Any, contrast: float, taps: int = 4, harmonics: Any = ()
) -> np.ndarray:
    """Return the expected photoelectrons (tap, ...) of N taps.

    m_k = (S / N) g(phase - 2 pi k / N) + B / N with the sensitivity g of `correlation`.

    Args:
        signal: Photoelectrons S of the signal, (...).
        background: Photoelectrons B of the background, (...).
        phase: Phase of the signal [rad], (...).
        contrast: Modulation contrast.
        taps: Number N of taps.
        harmonics: Amplitudes of harmonics.

    Example:
        >>> expected_taps(4000, 400, 0.0, 0.5).round(9).tolist()
        [1600.0, 1100.0, 600.0, 1100.0]
    """
    light, ambient, phase = np.broadcast_arrays(signal, background, phase)
    steps = (2 * np.pi / taps * np.arange(taps)).reshape(-1, *[1] * phase.ndim)
    return (light * correlation(phase - steps, contrast, harmonics) + ambient) / taps


def sample_taps(
    rng: np.random.Generator, means: Any, read_noise: float = 0.0, full_well: float = np.inf
) -> np.ndarray:
    """Simulate the measured electrons of taps.

    Shot noise and read noise are added to the expected electrons. Then the sum is clipped at the
    full well, so the result can be negative but not above the full well.

    Args:
        rng: Generator of random numbers.
        means: Expected electrons of each tap, of any shape.
        read_noise: Standard deviation of the read noise [electrons].
        full_well: Largest number of electrons of a tap.

    Returns:
        Electrons of each tap, in the shape of `means`.
    """
    means = np.asarray(means)
    taps = rng.poisson(means) + rng.normal(0, read_noise, means.shape)
    return np.minimum(taps, full_well)


def demodulate(taps: Any, contrast: float) -> tuple[np.ndarray, np.ndarray]:
    """Return amplitude [electrons] and phase in [0, 2 pi) of taps (tap, ...).

    The amplitude is 2 |P| / contrast, and the phase is the angle of
    P = sum over k of m_k exp(+2 pi i k / N).

    Example:
        >>> amplitude, phase = demodulate([1100.0, 1600.0, 1100.0, 600.0], 0.5)
        >>> round(float(amplitude), 6), round(float(phase), 6)
        (4000.0, 1.570796)
    """
    phasor: Any = phasor_of_taps(taps, contrast)
    phase = phase_of(phasor.real, phasor.imag)
    return np.abs(phasor), wrap(phase, 2 * np.pi)


def phasor_of_taps(taps: Any, contrast: float) -> np.ndarray:
    """Return the phasor [electrons] of taps (tap, ...): 2 / contrast times P of `demodulate`."""
    taps = np.asarray(taps, np.float64)
    turns = np.exp(2j * np.pi * np.arange(len(taps)) / len(taps))
    return 2 / contrast * np.tensordot(turns, taps, axes=(0, 0))


def phase_deviation(
    signal: Any, background: Any, contrast: float, taps: int = 4, read_noise: float = 0.0
) -> np.ndarray:
    """Return the standard deviation of the phase [rad] by noise, for four or more taps.

    It is sqrt(2 (S + B + N read_noise²)) / (S contrast), if it is much smaller than 1 (Lange and
    Seitz 2001).

    Example:
        >>> phase_deviation(6000, 2000, 0.7, 4, 15).round(7).item()
        0.0317659
    """
    signal = np.asarray(signal, np.float64)
    return np.sqrt(2 * (signal + background + taps * read_noise**2)) / (signal * contrast)


def multipath_phase_error(ratio: Any, difference: Any) -> np.ndarray:
    """Return the error of the phase by a second return, arg(1 + ratio exp(i difference)).

    The error is in (-pi, pi] [rad]. The second return has `ratio` times the amplitude of the first
    return, and its phase is greater by `difference` [rad].

    Example:
        >>> multipath_phase_error(0.35, 1.9).round(6).item()
        0.357422
    """
    both: Any = 1 + np.asarray(ratio) * np.exp(1j * np.asarray(difference))
    return phase_of(both.real, both.imag)
