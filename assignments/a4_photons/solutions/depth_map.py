"""Depth by a search on a grid of path lengths, finer where the likelihood is greatest."""

from __future__ import annotations

import numpy as np
from bound import depth_bound
from scipy.ndimage import correlate1d

from tofrender.sensors.response import distribution

LEVELS = (0.125, 0.02, 0.003)  # steps of the path length, in bins
STEPS = 8  # to each side


def estimate_depth(
    counts, response, method: str = "ml", *, start_opl: float, bin_width_opl: float
) -> dict:
    """Strongest bin of the matched filter, then a parabola or the greatest likelihood."""
    counts = np.asarray(counts, np.float64)
    delays = distribution("response", response)
    reach = max(1, int(np.rint(np.abs(delays.ppf([1e-3, 1 - 1e-3])).max() / bin_width_opl)))
    lags = np.arange(-reach, reach + 1)

    def masses(offset):
        """Part of the light in each bin around the peak, if it is so many bins late."""
        edges = np.append(lags, reach + 1) - 0.5 - np.asarray(offset)[..., None]
        return np.diff(delays.cdf(edges * bin_width_opl))

    score = correlate1d(counts, masses(0.0), mode="constant")
    peak = score.argmax(axis=-1)
    around = np.clip(peak[..., None] + lags, 0, counts.shape[-1] - 1)
    inside = np.take_along_axis(counts, around, axis=-1)
    others = (counts.sum(-1) - inside.sum(-1)) / (counts.shape[-1] - lags.size)
    signal = np.maximum(inside.sum(-1) - others * lags.size, 0)
    if method == "matched":
        sides = np.clip(peak[..., None] + np.arange(-1, 2), 0, counts.shape[-1] - 1)
        low, top, high = np.moveaxis(np.take_along_axis(score, sides, axis=-1), -1, 0)
        curve = low + high - 2 * top
        offset = 0.5 * (low - high) / np.where(curve < 0, curve, -1)
    else:
        base, strength = np.maximum(others, 1e-6), np.maximum(signal, 1e-3)
        offset = np.zeros(peak.shape)
        for level in LEVELS:
            tried = offset[..., None] + level * np.arange(-STEPS, STEPS + 1)
            means = strength[..., None, None] * masses(tried) + base[..., None, None]
            fit = (inside[..., None, :] * np.log(means) - means).sum(axis=-1)
            best = fit.argmax(axis=-1)[..., None]
            offset = np.take_along_axis(tried, best, axis=-1)[..., 0]
    lit = counts.sum(axis=-1) > 0
    start = start_opl / 2
    depth = start + np.where(lit, (peak + 0.5 + offset) * bin_width_opl / 2, np.nan)
    return {"depth": depth, "depth_std": depth_bound(signal * lit, others, response, bin_width_opl)}
