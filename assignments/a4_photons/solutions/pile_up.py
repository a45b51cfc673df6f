"""Pile-up by counting, bin after bin, the cycles that have not detected yet."""

from __future__ import annotations

import numpy as np


def first_photon(rates: np.ndarray) -> np.ndarray:
    """A bin detects if it has a photon and no bin before has one."""
    rates = np.asarray(rates, np.float64)
    found = np.empty(rates.shape)
    armed = np.ones(rates.shape[:-1])
    for k in range(rates.shape[-1]):
        found[..., k] = armed * -np.expm1(-rates[..., k])
        armed = armed * np.exp(-rates[..., k])
    return found


def coates(counts: np.ndarray, cycles: int) -> np.ndarray:
    """The fraction exp(-rate) of the armed cycles detects nothing."""
    counts = np.asarray(counts, np.float64)
    found, armed = np.empty(counts.shape), np.full(counts.shape[:-1], float(cycles))
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(counts.shape[-1]):
            found[..., k] = -np.log1p(-counts[..., k] / armed)
            armed = armed - counts[..., k]
    return found


def coates_variance(rates: np.ndarray, cycles: int) -> np.ndarray:
    """Binomial variance h (1 - h) / armed of the part h that detects, times (d rate / d h)²."""
    rates = np.asarray(rates, np.float64)
    part = -np.expm1(-rates)
    armed = first_photon(rates) / np.where(part > 0, part, 1) * cycles
    return np.where(part > 0, part / ((1 - part) * np.where(part > 0, armed, 1)), 0.0)
