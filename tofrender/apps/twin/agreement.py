"""Measures of the agreement of rendered and measured histograms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FIRST_BIN = 10  # First bin that is compared
LAST_BIN = 63  # Last bin that is compared
PEAK = 0.1  # Least height of a first peak, as a fraction of the largest count
NEAR_M = 0.01
COUNTS_WITHIN = 0.3


@dataclass(frozen=True)
class Agreement:
    """Agreement of two sets of histograms.

    Args:
        poses: Number of poses.
        correlation: Correlation of the counts of all zones of a pose, the median over poses.
        correlation_p10: Its 10th percentile.
        log_correlation: Correlation of the logarithms of counts plus 1, the median.
        log_correlation_p10: Its 10th percentile.
        zone_correlation: Correlation of the counts of each zone over all poses.
        peak_error_m: Median difference of the first peaks, as depth [m].
        peak_error_p90_m: Its 90th percentile.
        peak_near: Fraction of the zones of all poses with first peaks that differ by less than
            10 mm.
        counts_near: Fraction of the zones of all poses with sums of counts that differ by less than
            30 %.
    """

    poses: int
    correlation: float
    correlation_p10: float
    log_correlation: float
    log_correlation_p10: float
    zone_correlation: list[float]
    peak_error_m: float
    peak_error_p90_m: float
    peak_near: float
    counts_near: float


def agreement(expected: np.ndarray, measured: np.ndarray, bin_width_m: float) -> Agreement:
    """Compare counts (poses, zones, bins). The width of the bins is in meters of depth."""
    # Compare the shapes of histograms
    bins = slice(FIRST_BIN, LAST_BIN + 1)
    e = expected[..., bins]
    m = measured[..., bins]
    poses, zones = m.shape[:2]
    by_pose = correlations(e.reshape(poses, -1), m.reshape(poses, -1))
    logs = correlations(np.log1p(e).reshape(poses, -1), np.log1p(m).reshape(poses, -1))
    by_zone = correlations(
        e.transpose(1, 0, 2).reshape(zones, -1), m.transpose(1, 0, 2).reshape(zones, -1)
    )

    # Compare the places of first peaks, and the sums of counts
    error = np.abs(first_peaks(e) - first_peaks(m)) * bin_width_m
    ratio = e.sum(axis=-1) / m.sum(axis=-1)
    return Agreement(
        poses=poses,
        correlation=float(np.median(by_pose)),
        correlation_p10=float(np.quantile(by_pose, 0.1)),
        log_correlation=float(np.median(logs)),
        log_correlation_p10=float(np.quantile(logs, 0.1)),
        zone_correlation=[float(each) for each in by_zone],
        peak_error_m=float(np.median(error)),
        peak_error_p90_m=float(np.quantile(error, 0.9)),
        peak_near=float(np.mean(error < NEAR_M)),
        counts_near=float(np.mean(np.abs(ratio - 1) < COUNTS_WITHIN)),
    )


def correlations(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return Pearson's correlation of each row of two tables."""
    x = a - a.mean(axis=1, keepdims=True)
    y = b - b.mean(axis=1, keepdims=True)
    return (x * y).sum(axis=1) / np.sqrt((x**2).sum(axis=1) * (y**2).sum(axis=1))


def first_peaks(counts: np.ndarray) -> np.ndarray:
    """Return the place of the first peak of histograms along the last axis, in bins.

    It is the first local maximum that has a tenth of the largest count or more, refined by the
    parabola through the logarithms of the maximum and its neighbors. A histogram without a local
    maximum has its place at the largest count.
    """
    # Find the first peak
    left = counts[..., 1:-1] >= counts[..., :-2]
    right = counts[..., 1:-1] > counts[..., 2:]
    high = counts[..., 1:-1] >= PEAK * counts.max(axis=-1, keepdims=True)
    peak = left & right & high
    largest = np.clip(counts.argmax(axis=-1), 1, counts.shape[-1] - 2)
    k = np.where(peak.any(axis=-1), peak.argmax(axis=-1) + 1, largest)

    # Refine it by a parabola
    logs = np.log(np.maximum(counts, 1e-3))
    before, at, after = (
        np.take_along_axis(logs, (k + offset)[..., None], axis=-1)[..., 0] for offset in (-1, 0, 1)
    )
    curvature = before - 2 * at + after
    safe = np.where(curvature < 0, curvature, -1.0)
    return k + np.clip(0.5 * (before - after) / safe, -0.5, 0.5)
