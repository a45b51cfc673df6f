"""Problem a2.pulse_checks: a test of pulses."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np


def check_pulse(pulse) -> None:
    """Raise an AssertionError, with or without a message, if `pulse` breaks this contract.

    A pulse of any shape, symmetric or not, a few millimeters to a few meters wide, has

    - `support`: (first, last) offset [m] beyond which at most 1e-4 of all energy lies;
    - `eval(t)`: its density [1/m] at the offsets `t` [m], never negative, with the integral 1;
    - `cdf(t)`: the integral of `eval` up to `t`, from 0 to 1;
    - `sample(xi)`: for uniform random numbers `xi` in [0, 1], both ends included, the pair of
      offsets [m], with the density `eval` and always finite, and their weights: a Dr.Jit array, not
      a Python number, of ones.

    `t` and `xi` are `mi.Float` arrays, and so are the results. Correct pulses fulfill the contract
    only to single precision, and may use `xi` in any way that gives the distribution.

    Args:
        pulse: An object, not a class.
    """
    raise NotImplementedError("a2.pulse_checks: check_pulse")
