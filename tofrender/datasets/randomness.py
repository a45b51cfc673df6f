"""Random numbers of data sets: hashes of seed, record, attempt, name and index.

The i-th number of a quantity in a record is (n + 1/2) / 2^52. Here n is the first 52 bits of the
SHA-256 of the text `tofrender/SEED/RECORD/ATTEMPT/NAME/I`. The number does not depend on the
machine, on versions of libraries, or on other draws and their order.
"""

import hashlib
from dataclasses import dataclass

from ..runtime import checks

BITS = 52  # Bits of n. A float has one bit more, so that n + 1/2 is exact


@dataclass(frozen=True)
class Source:
    """Random numbers of one quantity in one record."""

    seed: int  # seed of the data set
    record: int  # number of the record
    name: str  # name of the quantity
    attempt: int = 0  # number of earlier draws of the same record

    def number(self, index: int = 0) -> float:
        """Return the number with an index, in (0, 1).

        Example:
            >>> Source(0, 17, "lamp").number() == Source(0, 17, "lamp").number()
            True
            >>> Source(0, 17, "lamp").number() == Source(0, 18, "lamp").number()
            False
        """
        return ((self._digest(index) >> (256 - BITS)) + 0.5) / (1 << BITS)

    def integer(self) -> int:
        """Return an integer in [0, 2^32), for the seed of a render."""
        return self._digest(0) >> 224 & checks.MAX_SEED

    def _digest(self, index: int) -> int:
        """Return the SHA-256 for an index as an integer of 256 bits."""
        text = f"tofrender/{self.seed}/{self.record}/{self.attempt}/{self.name}/{index}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest())
