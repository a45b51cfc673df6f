"""Closed forms of photon counting and correlation, in NumPy and SciPy alone. Lengths in meters."""

from __future__ import annotations

import itertools
import math

import numpy as np
from formulas import SPEED_OF_LIGHT, cdf, deviations, in_groups, kernel, pdf, returns

__all__ = ["SPEED_OF_LIGHT", "cdf", "deviations", "in_groups", "kernel", "pdf", "returns"]


# ----------------------------------------------------------------------------------- pile-up


def along_bins(values, function):
    """Apply a function of a list to the last axis."""
    values = np.asarray(values, float)
    rows = [function(row.tolist()) for row in values.reshape(-1, values.shape[-1])]
    return np.array(rows).reshape(values.shape)


def first_photon(rates):
    """exp(-sum before) (1 - exp(-rate))."""

    def row(rates):
        return [
            math.exp(-math.fsum(rates[:k])) * -math.expm1(-rate) for k, rate in enumerate(rates)
        ]

    return along_bins(rates, row)


def coates(counts, cycles):
    """-log(1 - counts / armed cycles); infinite when the last detects, 0 after that."""

    def row(counts):
        found = []
        for k, count in enumerate(counts):
            armed = cycles - math.fsum(counts[:k])
            share = count / armed if armed else 0.0
            found.append(-math.log1p(-share) if share < 1 else math.inf)
        return found

    return along_bins(counts, row)


def coates_variance(rates, cycles):
    """(exp(rate) - 1) / (cycles exp(-sum before))."""

    def row(rates):
        return [
            math.expm1(rate) / (cycles * math.exp(-math.fsum(rates[:k])))
            for k, rate in enumerate(rates)
        ]

    return along_bins(rates, row)


# --------------------------------------------------------------------------------- dead time


def by_patterns(rates, dead, paralysable=False):
    """Mean detections and second moments of one cycle, over all patterns of bins with photons."""
    p = -np.expm1(-np.asarray(rates, float))
    mean = np.zeros(p.size)
    second = np.zeros((p.size, p.size))
    for pattern in itertools.product((False, True), repeat=p.size):
        weight = np.where(pattern, p, 1 - p).prod()
        armed = 0
        found = np.zeros(p.size)
        for k, photon in enumerate(pattern):
            if photon and k >= armed:
                found[k] = 1
            if photon and (k >= armed or paralysable):
                armed = k + dead + 1
        mean += weight * found
        second += weight * np.outer(found, found)
    return mean, second


def free_running(rates, dead):
    """Detections per cycle of a non-paralyzable SPAD: the chain of its detections (Rapp 2019)."""
    rates = np.asarray(rates, float)
    bins = rates.size
    whole = rates.sum()
    chain = np.zeros((bins, bins))
    waits = np.zeros(bins)
    for s in range(bins):
        before = 0.0
        for wait in range(bins):
            x = (s + 1 + dead + wait) % bins
            p = math.exp(-before) * -math.expm1(-rates[x]) / -math.expm1(-whole)
            chain[s, x] += p
            waits[s] += p * (1 + dead + wait)
            before += rates[x]
        waits[s] += bins * math.exp(-whole) / -math.expm1(-whole)  # whole cycles without photons
    stationary = np.full(bins, 1 / bins)
    for _ in range(4000):
        stationary = 0.5 * (stationary + stationary @ chain)
    return stationary * bins / (stationary @ waits)


def paralysable_running(rates, dead):
    """A bin detects if it has a photon, and none of the dead bins before it has."""
    rates = np.asarray(rates, float)
    found = []
    for k, rate in enumerate(rates):
        before = sum(rates[(k - j) % rates.size] for j in range(1, dead + 1))
        found.append(-math.expm1(-rate) * math.exp(-before))
    return np.array(found)


# ------------------------------------------------------------------------------------ jitter


def jittered(detections, masses, periodic):
    """Each detection goes to bins around it."""
    detections = np.asarray(detections, float)
    bins = detections.shape[-1]
    reach = len(masses) // 2
    found = np.zeros(detections.shape)
    for k, lag in itertools.product(range(bins), range(-reach, reach + 1)):
        if periodic or 0 <= k + lag < bins:
            found[..., (k + lag) % bins] += masses[reach + lag] * detections[..., k]
    return found


# ------------------------------------------------------------------------------------- depth


def depth_bound(signal, background, sigma_s, tail_s, width):
    """1 / (2 sqrt(sum (S dP/dt)² / (S P + b)))."""
    signal, background = np.broadcast_arrays(signal, background)
    far = SPEED_OF_LIGHT * (8 * sigma_s + 40 * tail_s)
    reach = int(far / width) + 2
    edges = (np.arange(-reach, reach + 2) - 0.5) * width
    masses, slopes = (np.diff(each(edges, sigma_s, tail_s)) for each in (cdf, pdf))
    means = signal[..., None] * masses + background[..., None]
    terms = (signal[..., None] * slopes) ** 2 / np.where(means > 1e-290, means, np.inf)
    with np.errstate(divide="ignore"):
        return 0.5 / np.sqrt(terms.sum(axis=-1))


def matched(counts, sigma_s, tail_s, width):
    """Depths at the maximum of the matched filter, by a parabola through three of its values."""
    counts = np.asarray(counts, float)
    reach = int(SPEED_OF_LIGHT * (5 * sigma_s + 12 * tail_s) / width) + 1
    masses = kernel(reach, sigma_s, tail_s, width)
    found = np.empty(counts.shape[:-1])
    for where in np.ndindex(found.shape):
        score = np.correlate(np.pad(counts[where], reach), masses, mode="valid")
        k = int(score.argmax())
        low, top, high = score[k - 1 : k + 2]
        found[where] = (k + 0.5 + 0.5 * (low - high) / (low - 2 * top + high)) * width / 2
    return found


# -------------------------------------------------------------------------------------- iToF


def expected_taps(signal, background, phase, contrast, taps=4, harmonics=()):
    """S / N (1 + M (cos a + a_2 cos 2a + ...)) + B / N at a = phase - 2 pi k / N."""
    signal, background, phase = np.broadcast_arrays(signal, background, phase)
    rows = []
    for k in range(taps):
        a = phase - 2 * math.pi * k / taps
        waves = sum(h * np.cos(n * a) for n, h in enumerate((1.0, *harmonics), 1))
        rows.append(signal / taps * (1 + contrast * waves) + background / taps)
    return np.array(rows)


def phase_deviation(signal, background, contrast, taps, read_noise):
    """sqrt(2 (S + B + N σ²)) / (S M)."""
    signal = np.asarray(signal, float)
    return np.sqrt(2 * (signal + background + taps * read_noise**2)) / (signal * contrast)


def multipath_phase_error(ratio, difference):
    """Angle of 1 + ratio exp(i difference)."""
    return np.angle(1 + np.asarray(ratio) * np.exp(1j * np.asarray(difference)))
