"""Answers that are wrong by a constant factor: find the factor, and name the usual mistake.

    ratios = {"π": "divide by 4π²", "1/cos": Ratio(1 / cos, "the cosine is missing")}
    expect.close(answer, expected, "radiance", ratios=ratios)

A constant of `FACTORS` is a small mistake, so the test still gives a fraction of its points. This
needs several different numbers, so that the factor cannot be a coincidence.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

FRACTION = 0.5  # fraction of a test's points that an answer with a constant factor gets
# Count of different numbers with the same factor that excludes a coincidence. Numbers are
# different if their distance exceeds the tolerance.
MIN_NUMBERS = 3
# Constants that are often forgotten, or applied twice
FACTORS = {
    "-1": -1.0,
    "2": 2.0,
    "1/2": 0.5,
    "4": 4.0,
    "1/4": 0.25,
    "π": np.pi,
    "1/π": 1 / np.pi,
    "π²": np.pi**2,
    "1/π²": np.pi**-2,
    "2π": 2 * np.pi,
    "1/2π": 0.5 / np.pi,
    "4π": 4 * np.pi,
    "1/4π": 0.25 / np.pi,
    "π/2": np.pi / 2,
    "2/π": 2 / np.pi,
    "√2": 2**0.5,
    "1/√2": 2**-0.5,
}


@dataclass(frozen=True)
class Ratio:
    """Ratio of a wrong answer to the correct one, for a known mistake."""

    values: Any  # the ratio, a number or one value per element
    hint: str  # description of the mistake


Ratios = Mapping[str, str | Ratio]
"""Hints by the name of a factor in `FACTORS`, and `Ratio`s by any other name."""


def find(
    expected: np.ndarray,
    agrees: Callable[[Any], bool],
    ratios: Ratios | None,
    means: np.ndarray,
    tolerance: float,
) -> tuple[str, str, float] | None:
    """Find a factor between an answer and the correct values that is equal for all elements.

    Args:
        expected: The correct values.
        agrees: Function that compares the answer with other values.
        ratios: Hints, and ratios of known mistakes.
        means: Mean of `expected` over the seeds; `expected` itself for a deterministic answer.
        tolerance: Largest difference that noise or rounding explains.

    Returns:
        Name of the factor, hint, and fraction of the points that the answer gets. None if no
        factor fits, or more than one.
    """
    # Try all factors
    ratios = ratios or {}
    known = {name: each.values for name, each in ratios.items() if isinstance(each, Ratio)}
    with np.errstate(all="ignore"):
        names = [name for name, value in (FACTORS | known).items() if agrees(expected * value)]
    if len(names) != 1:
        return None

    # Can the agreement be a coincidence?
    name = names[0]
    gaps = np.diff(np.sort(means[np.abs(means) > tolerance]))
    different = np.sum(gaps > tolerance) + 1
    fraction = FRACTION if different >= MIN_NUMBERS and name not in known else 0.0

    hint = ratios.get(name, "")
    return name, hint.hint if isinstance(hint, Ratio) else hint, fraction
