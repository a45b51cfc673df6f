"""Numbers of the public tests: other ones in each term, equal for all students.

    inputs = Inputs(__file__)  # in a file of an assignment's tests/
    WIDTH = inputs.number("width", 0.05, low=0.04, high=0.08)

The rubric's `term` chooses them. Term 0 has those that are written in the tests; any other draws
from the range, by the name alone, so that tests and probes agree and no order matters.
"""

import hashlib
from pathlib import Path

import numpy as np

from .. import rubric


class Inputs:
    """Numbers of one assignment, by a file of its folder `tests/`."""

    def __init__(self, file: str) -> None:
        self._term = rubric.read(Path(file).resolve().parents[1]).term

    def number(self, name: str, first: float, *, low: float, high: float) -> float:
        """Number from `low` to `high` of four digits; `first` in term 0."""
        if self._term == 0:
            return first
        return float(f"{self._generator(name).uniform(low, high):.4g}")

    def integer(self, name: str, first: int, *, low: int, high: int) -> int:
        """Integer from `low` to `high`; `first` in term 0."""
        if self._term == 0:
            return first
        return int(self._generator(name).integers(low, high, endpoint=True))

    def _generator(self, name: str) -> np.random.Generator:
        return np.random.default_rng(_drawn(f"{self._term} {name}"))


def seed_of(term: int) -> int:
    """Offset of a term to the seeds of all tests, 0 for term 0."""
    return _drawn(str(term)) % (1 << 30) if term else 0


def _drawn(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")
