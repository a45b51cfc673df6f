"""Correlation by sines and cosines, noise by propagation of errors."""

from __future__ import annotations

import numpy as np


def _angles(taps, like):
    """Phases of the taps, with axes for an array."""
    return (2 * np.pi * np.arange(taps) / taps).reshape(-1, *[1] * np.ndim(like))


def expected_taps(signal, background, phase, contrast, taps=4, harmonics=()):
    """A wave for the fundamental and for each harmonic."""
    signal, background, phase = np.broadcast_arrays(signal, background, phase)
    away = phase - _angles(taps, phase)
    wave = np.cos(away)
    for order, amplitude in enumerate(harmonics, 2):
        wave = wave + amplitude * np.cos(order * away)
    return signal / taps * (1 + contrast * wave) + background / taps


def sample_taps(rng, means, read_noise=0.0, full_well=np.inf):
    """Poisson, Gaussian, limited."""
    means = np.asarray(means, np.float64)
    electrons = rng.poisson(means) + read_noise * rng.standard_normal(means.shape)
    return np.where(electrons > full_well, full_well, electrons)


def demodulate(taps, contrast):
    """Sums with cosine and sine."""
    taps = np.asarray(taps, np.float64)
    angles = _angles(len(taps), taps[0])
    real = (taps * np.cos(angles)).sum(axis=0)
    imaginary = (taps * np.sin(angles)).sum(axis=0)
    phase = np.arctan2(imaginary, real)
    phase = np.where(phase < 0, phase + 2 * np.pi, phase)
    phase = np.where(phase >= 2 * np.pi, 0, phase)
    return 2 * np.hypot(real, imaginary) / contrast, phase


def phase_deviation(signal, background, contrast, taps=4, read_noise=0.0):
    """Each tap's variance times the square of the phase's derivative by it, at the phase 0."""
    signal = np.asarray(signal, np.float64)
    means = expected_taps(signal, background, 0.0, contrast, taps)
    slopes = 2 * np.sin(_angles(taps, signal)) / (signal * contrast)
    return np.sqrt(((means + read_noise**2) * slopes**2).sum(axis=0))


def multipath_phase_error(ratio, difference):
    """Angle of the sum of two arrows."""
    ratio = np.asarray(ratio, np.float64)
    return np.arctan2(ratio * np.sin(difference), 1 + ratio * np.cos(difference))
