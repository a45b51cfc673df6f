"""Dead time as a Markov chain of the bins until the SPAD is armed, and photon by photon."""

from __future__ import annotations

import numpy as np


def armed_detections(rates: np.ndarray, dead: int, paralysable: bool, periodic: bool) -> np.ndarray:
    """State w is the number of bins until the detector is armed, 0 to `dead`."""
    rates = np.asarray(rates, np.float64)
    found = np.empty(rates.shape)
    for pixel, own in enumerate(rates):
        steps = [_step(p, dead, paralysable) for p in -np.expm1(-own)]
        state = np.eye(dead + 1)[0]
        if periodic:
            cycle = np.linalg.multi_dot([np.eye(dead + 1), *steps, np.eye(dead + 1)])
            # The stationary state is the left eigenvector of 1: all but one equation, and the sum
            system = np.vstack([(cycle.T - np.eye(dead + 1))[1:], np.ones(dead + 1)])
            state = np.linalg.solve(system, np.eye(dead + 1)[dead])
        for k, step in enumerate(steps):
            found[pixel, k] = state[0] * -np.expm1(-own[k])
            state = state @ step
    return found


def _step(p: float, dead: int, paralysable: bool) -> np.ndarray:
    """Transitions from a bin to the next, if a photon has the probability p."""
    step = np.zeros((dead + 1, dead + 1))
    for wait in range(dead + 1):
        restarts = p if wait == 0 or paralysable else 0.0
        step[wait, dead] += restarts
        step[wait, max(wait - 1, 0)] += 1 - restarts
    return step


def sample_counts(
    rng: np.random.Generator, rates: np.ndarray, cycles: int, dead: int
) -> np.ndarray:
    """The summed rate up to the next photon is exponential; repeat after each detection."""
    rates = np.asarray(rates, np.float64)
    bins = rates.shape[1]
    found = np.zeros(rates.shape, np.int64)
    for pixel, own in enumerate(rates):
        sums = np.append(0, np.cumsum(own))
        armed = np.zeros(cycles, int)
        while armed.size:
            until = sums[armed] + rng.exponential(size=armed.size)
            at = np.searchsorted(sums[1:], until)
            at = at[at < bins]
            found[pixel] += np.bincount(at, minlength=bins)
            armed = at + 1 + dead
            armed = armed[armed < bins]
    return found
