"""Part of the check, with its results, sizes and time limit."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

LIGHT_LENGTH_M = 6.0
"""Length of the time window of the Cornell box [m], with any number of bins."""


@dataclass(frozen=True)
class Sizes:
    """Sizes of what the parts render.

    Attributes:
        timed_film: Width, height and number of bins of films that are timed.
        timed_spp: Samples per pixel of renders that are timed.
        runs: Number of renders per median time.
        timed_scenes: Number of scenes that are timed.
        compared_film: Width, height and number of bins of films that are compared.
        compared_spp: Samples per pixel of renders that are compared.
        compared_scenes: Number of scenes that are compared with LLVM.
        compared_cases: Number of tofbench's cases that are compared with their closed forms.
        seeds: Renders of each scene and each backend.
        depths: `max_depth` of the renders that are differentiated.
        loaded_scenes: Number of scenes that are loaded in one process.
    """

    timed_film: tuple[int, int, int]
    timed_spp: tuple[int, ...]
    runs: int
    timed_scenes: int
    compared_film: tuple[int, int, int]
    compared_spp: int
    compared_scenes: int
    compared_cases: int
    seeds: int
    depths: tuple[int, ...]
    loaded_scenes: int


FULL = Sizes(
    timed_film=(256, 256, 300),
    timed_spp=(64, 1024),
    runs=5,
    timed_scenes=6,
    compared_film=(48, 32, 300),
    compared_spp=256,
    compared_scenes=12,
    compared_cases=1000,  # All
    seeds=8,
    depths=(8, 64, 256),
    loaded_scenes=500,
)

SMALL = Sizes(
    timed_film=(16, 12, 30),
    timed_spp=(4, 16),
    runs=2,
    timed_scenes=1,
    compared_film=(8, 6, 30),
    compared_spp=16,
    compared_scenes=2,
    compared_cases=2,
    seeds=4,
    depths=(8, 64, 256),
    loaded_scenes=20,
)
"""Sizes for a machine without a GPU, on which the check is tested."""


@dataclass
class Part:
    """Results of one part, which stops when its time is over.

    Attributes:
        variant: The Mitsuba variant that is checked.
        sizes: Sizes of the renders.
        seconds: Time limit [s].
        file: File of the results so far; None to write none.
        results: Measured numbers, as JSON can store them.
        skipped: Measurements that are missing, with the reason.
        failed: Problems that were found.
    """

    variant: str
    sizes: Sizes
    seconds: float
    file: Path | None = None
    results: dict[str, Any] = field(default_factory=dict)
    skipped: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._end = time.monotonic() + self.seconds

    def left(self) -> float:
        """Time that is left [s]."""
        return self._end - time.monotonic()

    def each(self, items: Sequence[T]) -> Iterator[T]:
        """Yield items while there is time for another item as slow as the slowest so far.

        The other items are reported as skipped.
        """
        longest_s = 0.0
        for position, item in enumerate(items):
            if self.left() <= longest_s:
                left_out = ", ".join(str(each) for each in items[position:])
                self.skipped.append(f"{left_out}: no time left")
                break
            start = time.monotonic()
            yield item
            longest_s = max(longest_s, time.monotonic() - start)
            self.save()

    def require(self, condition: bool, problem: str) -> None:
        """Report a problem if a condition is not met."""
        if not condition:
            self.failed.append(problem)

    def save(self) -> None:
        """Write the results so far, which remain if the process ends here."""
        if self.file is None:
            return
        text = {"results": self.results, "skipped": self.skipped, "failed": self.failed}
        self.file.write_text(json.dumps(text), encoding="utf-8")
