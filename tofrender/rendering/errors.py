"""Standard errors from the scatter of batches of samples with independent seeds.

Parts of one low-discrepancy point set are not independent. Their mean has less noise than the
scatter of the parts suggests, so the scatter would overestimate the error. Therefore each batch has
its own seed. The standard error describes the mean of these batches. This mean is slightly noisier
than the same number of samples from one point set.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ..samplers.padded_sobol import mix

# Number of batches, if the number of samples is a multiple of it
BATCHES = 16

# Smallest number of batches
LEAST_BATCHES = 4

# Number of values that are processed together, so that temporary arrays stay small
ROWS = 1 << 22


def batches_of(spp: int) -> int:
    """Return the number of batches for `spp` samples per pixel."""
    found = math.gcd(spp, BATCHES)
    if found < LEAST_BATCHES:
        raise ValueError(f"spp = {spp}: must be a multiple of {LEAST_BATCHES} with errors")
    return found


def seed_of(seed: int, first: int, batch: int) -> mi.UInt32:
    """Return the seed of a batch.

    Args:
        seed: Seed of the render.
        first: Samples per pixel that precede the work item.
        batch: Index of the batch.
    """
    own = mix(mix(mi.UInt32(seed), mi.UInt32(first)), mi.UInt32(batch + 1))

    # Use one kernel for all seeds
    dr.make_opaque(own)
    return own


class Scatter:
    """Running mean and scatter of named arrays, by the algorithm of B. P. Welford (1962).

    Attributes:
        count: Number of arrays that were added for each name.
        means: Means of the arrays, by name.
        squares: Sums of squared distances to the means, by name.
    """

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.count = 1
        self.means = arrays
        self.squares = {name: np.zeros_like(array) for name, array in arrays.items()}

    def add(self, arrays: dict[str, np.ndarray]) -> None:
        """Add one array for each name."""
        self.count += 1
        for name, array in arrays.items():
            mean = self.means[name]
            square = self.squares[name]

            # Update the mean, then the sum of squares with the distances to both means
            for lines in _lines(array):
                off = array[lines] - mean[lines]
                mean[lines] += off / np.float32(self.count)
                square[lines] += off * (array[lines] - mean[lines])

    def errors(self) -> dict[str, np.ndarray]:
        """Return the standard errors of the means. The arrays of `squares` are overwritten."""
        scale = np.float32(1 / (self.count * (self.count - 1)))
        for square in self.squares.values():
            np.sqrt(np.multiply(square, scale, out=square), out=square)
        return {f"{name}_error": square for name, square in self.squares.items()}

    def state(self) -> dict[str, np.ndarray]:
        """Return the complete state as arrays, for `restored`."""
        return {"batches": np.array(self.count)} | {
            f"{what}.{name}": array
            for what, arrays in (("mean", self.means), ("square", self.squares))
            for name, array in arrays.items()
        }

    @classmethod
    def restored(cls, state: dict[str, np.ndarray]) -> Scatter | None:
        """Return the scatter of a `state`, or None if the state contains no arrays."""
        if "batches" not in state:
            return None

        # Collect the arrays, named as in "mean.transient"
        both: dict[str, dict[str, np.ndarray]] = {"mean": {}, "square": {}}
        for key, array in state.items():
            what, _, name = key.partition(".")
            if what in both:
                both[what][name] = array
        found = cls(both["mean"])
        found.count = int(state["batches"])
        found.squares = both["square"]
        return found


class Halves(Scatter):
    """Mean of two halves of the samples, and their difference, which measures the noise."""

    def add(self, arrays: dict[str, np.ndarray]) -> None:
        """Add the second half. The arrays are overwritten."""
        self.count += 1
        for name, second in arrays.items():
            # Reuse the memory of the second half: first the difference, then half of it
            self.squares[name] = np.subtract(self.means[name], second, out=second)
            second *= np.float32(0.5)
            self.means[name] -= second

    def errors(self) -> dict[str, np.ndarray]:
        """Return half of the difference between the transients of the two halves."""
        return {"half_difference": self.squares["transient"]}


def _lines(array: np.ndarray) -> list[slice]:
    """Return slices of the first axis that contain about `ROWS` values each."""
    step = max(1, ROWS // max(1, array[:1].size))
    return [slice(k, k + step) for k in range(0, len(array), step)]
