"""Problem a2.fog: scattering and absorption in fog, and polarizers."""

from __future__ import annotations

import numpy as np


def absorb(
    transient_data: np.ndarray, mu_a: float, start_opl: float, bin_width_opl: float
) -> np.ndarray:
    """Compute the bins for absorbing fog from the bins for fog that only scatters.

    Light of the length s is weaker by the factor exp(-mu_a s). Assume that the light of a bin is
    spread evenly over the lengths of the bin.

    Args:
        transient_data: Radiance per bin, shape (height, width, bins, channels). Bin k covers
            start_opl + k bin_width_opl to start_opl + (k + 1) bin_width_opl.
        mu_a: Absorption [1/m], 0 or more.
        start_opl: Start of the first bin [m].
        bin_width_opl: Width of a bin [m].

    Returns:
        Radiance per bin, an array of the same shape.
    """
    raise NotImplementedError("a2.fog: absorb")


def sample_turn(xi: np.ndarray, g: float) -> np.ndarray:
    """Sample cosines of scattering angles: Henyey and Greenstein's phase function.

    Args:
        xi: Uniform random numbers in [0, 1], both ends included.
        g: Mean of the cosine, between -1 and 1, 0 included.

    Returns:
        Cosines in [-1, 1] of the angles between the directions before and after, one for each `xi`,
        with the density (1 - g²) / (2 (1 + g² - 2 g cos)^1.5).
    """
    raise NotImplementedError("a2.fog: sample_turn")


def wander(
    random: np.random.Generator, mu_s: float, g: float, opl: float, count: int
) -> np.ndarray:
    """Positions of photons in infinite fog after a path length.

    All photons start at the origin along +z. They scatter after distances t with the density
    mu_s exp(-mu_s t), by angles of `sample_turn`, with a uniform azimuth around their direction.

    Args:
        random: Source of all random numbers.
        mu_s: Scattering [1/m], 0 or more; 0 is clear air.
        g: Mean cosine of the scattering angle.
        opl: Path length from the start [m].
        count: Number of photons.

    Returns:
        Positions [m], shape (count, 3).
    """
    raise NotImplementedError("a2.fog: wander")


def through_polarizer(stokes: np.ndarray, angle: float) -> np.ndarray:
    """Light behind an ideal linear polarizer.

    Args:
        stokes: Stokes vectors (S0, S1, S2, S3) in the last axis, shape (..., 4).
        angle: Angle of the polarizer's axis [rad]; 0 transmits all light with S1 = S0, and π/4
            transmits all light with S2 = S0.

    Returns:
        Stokes vectors, an array of the same shape.
    """
    raise NotImplementedError("a2.fog: through_polarizer")
