"""Probes: functions that the tests call with a submission, in the submission's process."""

from __future__ import annotations

import numpy as np
from scipy import stats

from tofrender.course.judge import trials
from tofrender.sensors.response import Response, distribution


def kept(function, *arrays, **options):
    """Result of a function, and whether its arrays are as they were."""
    before = [array.copy() for array in arrays]
    found = np.asarray(function(*arrays, **options))
    same = all(np.array_equal(a, b) for a, b in zip(arrays, before, strict=True))
    return {"found": found, "kept": same}


# ----------------------------------------------------------------------------------- pile-up


def first_photon(theirs, rates):
    return kept(theirs.first_photon, rates)


def coates(theirs, counts, cycles):
    return kept(theirs.coates, counts, cycles=cycles)


def coates_variance(theirs, rates, cycles):
    return kept(theirs.coates_variance, rates, cycles=cycles)


def defines(theirs, name):
    """Load a name of the submission; a failure contains the reason."""
    getattr(theirs, name)


def try_pile_up(theirs, name, text):
    """Result of the student's test for a solution of a4.pile_up."""
    return trials.verdict(theirs.check_pile_up, trials.load(name, text))


# --------------------------------------------------------------------------------- dead time


def armed_detections(theirs, rates, dead, paralysable, periodic):
    return kept(
        theirs.armed_detections, rates, dead=dead, paralysable=paralysable, periodic=periodic
    )


def sample_counts(theirs, rates, cycles, dead, seed):
    """Counts, and whether they are equal for equal seeds and different for different seeds."""
    before = rates.copy()
    first, again, other = (
        np.asarray(theirs.sample_counts(np.random.default_rng(s), rates, cycles, dead))
        for s in (seed, seed, seed + 1)
    )
    return {
        "found": first,
        "kept": np.array_equal(rates, before),
        "whole": first.dtype.kind in "iu",
        "repeats": np.array_equal(first, again) and not np.array_equal(first, other),
    }


def repeated_counts(theirs, rates, cycles, dead, calls, seed):
    """Counts of several calls with one generator, shape (call, pixel, bin)."""
    rng = np.random.default_rng(seed)
    return np.array([theirs.sample_counts(rng, rates, cycles, dead) for _ in range(calls)])


# ------------------------------------------------------------------------------------ jitter


def delays(sigma_s, tail_s):
    return distribution("response", Response(sigma_s, tail_s))


def kernel(theirs, sigma_s, tail_s, width, **tail):
    return np.asarray(theirs.kernel(delays(sigma_s, tail_s), width, **tail))


def kernel_of_early_delays(theirs, scale, width, tail):
    """Masses of a distribution of SciPy with a tail on the early side."""
    return np.asarray(theirs.kernel(stats.gumbel_l(0.0, scale), width, tail))


def add_jitter(theirs, detections, masses, periodic):
    return kept(theirs.add_jitter, detections, masses, periodic=periodic)


def repeated_lags(theirs, masses, size, calls, seed):
    """Lags of several calls with one generator, shape (call, stamp)."""
    rng = np.random.default_rng(seed)
    return np.array([theirs.sample_jitter(rng, masses, size) for _ in range(calls)])


def sample_jitter(theirs, masses, size, seed):
    first, again, other = (
        np.asarray(theirs.sample_jitter(np.random.default_rng(s), masses, size))
        for s in (seed, seed, seed + 1)
    )
    return {
        "found": first,
        "whole": first.dtype.kind in "iu",
        "repeats": np.array_equal(first, again) and not np.array_equal(first, other),
    }


# ------------------------------------------------------------------------------------- depth


def depth_bound(theirs, signal, background, sigma_s, tail_s, width):
    response = Response(sigma_s, tail_s)
    return np.asarray(theirs.depth_bound(signal, background, response, width))


def estimate_depth(theirs, counts, sigma_s, tail_s, method, width, start=0.0):
    """Depth and its standard deviation."""
    before = counts.copy()
    given = {} if method is None else {"method": method}
    response = Response(sigma_s, tail_s)
    found = theirs.estimate_depth(counts, response, start_opl=start, bin_width_opl=width, **given)
    names = ("depth", "depth_std")
    arrays = {name: np.asarray(found[name], np.float64) for name in names}
    return arrays | {"kept": np.array_equal(counts, before)}


# -------------------------------------------------------------------------------------- iToF


def expected_taps(theirs, signal, background, phase, contrast, **options):
    return np.asarray(theirs.expected_taps(signal, background, phase, contrast, **options))


def sample_taps(theirs, means, seed, **options):
    before = means.copy()
    first, again, other = (
        np.asarray(theirs.sample_taps(np.random.default_rng(s), means, **options))
        for s in (seed, seed, seed + 1)
    )
    return {
        "found": first,
        "kept": np.array_equal(means, before),
        "repeats": np.array_equal(first, again) and not np.array_equal(first, other),
    }


def repeated_taps(theirs, means, calls, seed, read_noise):
    """Electrons of several calls with one generator, shape (call, ...)."""
    rng = np.random.default_rng(seed)
    return np.array([theirs.sample_taps(rng, means, read_noise) for _ in range(calls)])


def demodulate(theirs, taps, contrast):
    before = taps.copy()
    amplitude, phase = theirs.demodulate(taps, contrast)
    return {
        "amplitude": np.asarray(amplitude),
        "phase": np.asarray(phase),
        "kept": np.array_equal(taps, before),
    }


def phase_deviation(theirs, signal, background, contrast, **options):
    return np.asarray(theirs.phase_deviation(signal, background, contrast, **options))


def multipath_phase_error(theirs, ratio, difference):
    return np.asarray(theirs.multipath_phase_error(ratio, difference))
