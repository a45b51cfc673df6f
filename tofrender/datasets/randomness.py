"""Random numbers of data sets: hashes of seed, record, attempt, name and index, nothing else.

The i-th number of a quantity in a record is (n + 1/2) / 2^52, where n is the first 52 bits of the
SHA-256 of the text `tofrender/SEED/RECORD/ATTEMPT/NAME/I`: the same on every machine and with every
version of every library, whatever else is drawn, in whatever order.
"""

import hashlib
from dataclasses import dataclass

from ..runtime import checks

BITS = 52  # Bits of n: one fewer than a float has, which then holds n + 1/2 exactly


@dataclass(frozen=True)
class Source:
    """The random numbers of one quantity in one record."""

    seed: int  # of the data set
    record: int  # number of the record
    name: str  # of the quantity
    attempt: int = 0  # how many times the record was drawn before

    def number(self, index: int = 0) -> float:
        """The number `index`, inside (0, 1).

        Example:
            >>> Source(0, 17, "lamp").number() == Source(0, 17, "lamp").number()
            True
            >>> Source(0, 17, "lamp").number() == Source(0, 18, "lamp").number()
            False
        """
        return ((self._digest(index) >> (256 - BITS)) + 0.5) / (1 << BITS)

    def integer(self) -> int:
        """An integer in [0, 2^32), a seed for a render."""
        return self._digest(0) >> 224 & checks.MAX_SEED

    def _digest(self, index: int) -> int:
        text = f"tofrender/{self.seed}/{self.record}/{self.attempt}/{self.name}/{index}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest())
