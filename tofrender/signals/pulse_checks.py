"""Check that density, integral and samples of a pulse are consistent."""

from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

if TYPE_CHECKING:
    from .pulses import Pulse

POINTS = 4001  # Number of offsets where the density is evaluated
TOLERANCE = 5e-3  # Tolerance of energy fractions, for densities that jump between two offsets


def check_pulse(pulse: "Pulse") -> None:
    """Check that `eval`, `cdf`, `sample` and `support` of a pulse agree.

    The integral of the density over the support is compared with the cdf. The cdf at samples of
    evenly spaced random numbers must equal the random numbers.

    Raises:
        AssertionError: If two of the methods do not agree.

    Example:
        >>> from tofrender.signals.pulses import GaussianPulse
        >>> check_pulse(GaussianPulse(width_opl=0.05))
    """
    # Is the density valid?
    first, last = pulse.support
    t = np.linspace(first, last, POINTS)
    density = np.array(pulse.eval(mi.Float(t)), float)
    cdf = np.array(pulse.cdf(mi.Float(t)), float)
    assert np.isfinite(density).all(), "a density is a number"
    assert density.min() >= 0, "a density is never negative"

    # Is the cdf the integral of the density?
    steps = np.diff(t) * (density[1:] + density[:-1]) / 2
    energy = np.append(0.0, np.cumsum(steps))
    assert abs(energy[-1] - 1) < TOLERANCE, f"the density integrates to {energy[-1]:.4g}, not to 1"
    far = np.abs(cdf - energy).max()
    assert far < TOLERANCE, f"the cdf is {far:.3g} off the integral of the density"

    # Do samples follow the density?
    xi = (np.arange(POINTS) + 0.5) / POINTS
    offsets, weight = pulse.sample(mi.Float(xi))
    assert dr.is_array_v(weight), "weights are an array of Dr.Jit"
    assert np.abs(np.array(weight) - 1).max() < TOLERANCE, "offsets have the weight 1"
    below = np.sort(np.array(pulse.cdf(mi.Float(offsets))))
    far = np.abs(below - xi).max()
    assert far < TOLERANCE, f"samples are {far:.3g} of the energy off the density"

    # Are samples finite at both ends of the random numbers?
    ends = np.array(pulse.sample(mi.Float([0.0, 1.0]))[0])
    assert np.isfinite(ends).all(), f"offsets at the ends are {ends}"
