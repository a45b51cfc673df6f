"""Numbers of the public tests, which change from term to term and are equal for all students.

    inputs = Inputs(__file__)  # in a file of an assignment's tests/
    WIDTH = inputs.number("width", 0.05, low=0.04, high=0.08)

The rubric's `term` chooses the numbers. Term 0 uses the numbers that are written in the tests. Any
other term draws each number from its range. The draw depends only on the term and the name of the
number, so tests and probes get the same numbers in any order.
"""

import hashlib
from pathlib import Path

import numpy as np

from .. import rubric


class Inputs:
    """Numbers of one assignment; `file` is any file in the assignment's folder `tests/`."""

    def __init__(self, file: str) -> None:
        self._term = rubric.read(Path(file).resolve().parents[1]).term

    def number(self, name: str, first: float, *, low: float, high: float) -> float:
        """Return a number from `low` to `high`, rounded to four digits; `first` in term 0."""
        if self._term == 0:
            return first
        return float(f"{self._generator(name).uniform(low, high):.4g}")

    def integer(self, name: str, first: int, *, low: int, high: int) -> int:
        """Return an integer from `low` to `high`, both included; `first` in term 0."""
        if self._term == 0:
            return first
        return int(self._generator(name).integers(low, high, endpoint=True))

    def _generator(self, name: str) -> np.random.Generator:
        return np.random.default_rng(_hash(f"{self._term} {name}"))


def seed_of(term: int) -> int:
    """Return the number that a term adds to the seeds of all tests; 0 for term 0."""
    return _hash(str(term)) % (1 << 30) if term else 0


def _hash(text: str) -> int:
    """Return an integer of 64 bits that depends on a text."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
