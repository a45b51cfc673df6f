"""Error bars from the scatter of batches of samples, each with points of its own.

Parts of one even point set are no independent draws: together they are evener than apart, and
their scatter would tell too large an error. So each batch has its own seed. That costs some of the
evenness: the error bar is that of what is returned, which is a little noisier than the same number
of samples in one point set.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ..samplers.padded_sobol import mix

BATCHES, LEAST_BATCHES = 16, 4
"""Batches of a render, if its number of samples can be divided by so many, and at least."""

ROWS = 1 << 22  # Values that are worked on at a time


def batches_of(spp: int) -> int:
    """Number of batches of so many samples per pixel."""
    found = math.gcd(spp, BATCHES)
    if found < LEAST_BATCHES:
        raise ValueError(f"spp = {spp}: must be a multiple of {LEAST_BATCHES} with errors")
    return found


def seed_of(seed: int, first: int, batch: int) -> mi.UInt32:
    """Seed of a batch of the samples that come after the `first` ones."""
    own = mix(mix(mi.UInt32(seed), mi.UInt32(first)), mi.UInt32(batch + 1))
    dr.make_opaque(own)  # One kernel for all seeds
    return own


class Scatter:
    """Mean and scatter of arrays of one shape, of which each is seen once (B. P. Welford, 1962).

    Attributes:
        count: How many of each name were added.
        means: Their means.
        squares: Sums of squared distances to the means.
    """

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.count, self.means = 1, arrays
        self.squares = {name: np.zeros_like(array) for name, array in arrays.items()}

    def add(self, arrays: dict[str, np.ndarray]) -> None:
        """Add one of each name; the arrays are used up."""
        self.count += 1
        for name, array in arrays.items():
            mean, square = self.means[name], self.squares[name]
            for lines in _lines(array):
                off = array[lines] - mean[lines]
                mean[lines] += off / np.float32(self.count)
                square[lines] += off * (array[lines] - mean[lines])

    def errors(self) -> dict[str, np.ndarray]:
        """Standard errors of the means, in the memory of the scatter, which is gone afterwards."""
        scale = np.float32(1 / (self.count * (self.count - 1)))
        for square in self.squares.values():
            np.sqrt(np.multiply(square, scale, out=square), out=square)
        return {f"{name}_error": square for name, square in self.squares.items()}

    def state(self) -> dict[str, np.ndarray]:
        """All of it as arrays, for `restored`."""
        return {"batches": np.array(self.count)} | {
            f"{what}.{name}": array
            for what, arrays in (("mean", self.means), ("square", self.squares))
            for name, array in arrays.items()
        }

    @classmethod
    def restored(cls, state: dict[str, np.ndarray]) -> Scatter | None:
        """The scatter of a `state`, None of one in which nothing was added."""
        if "batches" not in state:
            return None
        both: dict[str, dict[str, np.ndarray]] = {"mean": {}, "square": {}}
        for key, array in state.items():
            what, _, name = key.partition(".")
            if what in both:
                both[what][name] = array
        found = cls(both["mean"])
        found.count, found.squares = int(state["batches"]), both["square"]
        return found


class Halves(Scatter):
    """Mean of two halves of each name, and half their difference: the noise of the mean."""

    def add(self, arrays: dict[str, np.ndarray]) -> None:
        """Add the second half; the arrays are used up."""
        self.count += 1
        for name, second in arrays.items():
            self.squares[name] = np.subtract(self.means[name], second, out=second)
            second *= np.float32(0.5)
            self.means[name] -= second

    def errors(self) -> dict[str, np.ndarray]:
        """Half the difference of the transients."""
        return {"half_difference": self.squares["transient"]}


def _lines(array: np.ndarray) -> list[slice]:
    """Slices of the first axis that hold a few values each."""
    step = max(1, ROWS // max(1, array[:1].size))
    return [slice(k, k + step) for k in range(0, len(array), step)]
