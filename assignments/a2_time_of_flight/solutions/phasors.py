"""Phasors by complex numbers."""

from __future__ import annotations

import numpy as np

from tofrender.signals.units import SPEED_OF_LIGHT


def transient_to_phasor(
    transient_data: np.ndarray, frequency_hz: float, start_opl: float, bin_width_opl: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """P = Σ L_k exp(+i 2π f opl_k / c)."""
    bins = np.shape(transient_data)[2]
    opl = start_opl + (np.arange(bins) + 0.5) * bin_width_opl
    wave = np.exp(2j * np.pi * frequency_hz * opl / SPEED_OF_LIGHT)
    light = np.asarray(transient_data, np.float64)
    return _parts(np.einsum("yxtc,t->yxc", light, wave), frequency_hz)


def sum_channels(
    I: np.ndarray,  # noqa: E741
    Q: np.ndarray,
    frequency_hz: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The sum of the channels' phasors."""
    phasor = np.asarray(I, np.float64) + 1j * np.asarray(Q, np.float64)
    return _parts(phasor.sum(axis=-1, keepdims=True), frequency_hz)


def _parts(phasor, frequency_hz):
    phase = np.angle(phasor)
    half_wave = SPEED_OF_LIGHT / (2 * frequency_hz)
    depth = half_wave * np.mod(phase / (2 * np.pi), 1.0)
    return phasor.real, phasor.imag, np.abs(phasor), phase, depth
