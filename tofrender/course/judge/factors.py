"""Answers that are right but for one factor: which it is, and what is usually forgotten then.

    ratios = {"π": "divide by 4π²", "1/cos": Ratio(1 / cos, "the cosine is missing")}
    expect.close(came, wanted, "radiance", ratios=ratios)

A constant of `FACTORS` leaves a part of the points, if it cannot be chance: the mistake is a small
one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

SHARE = 0.5
"""Share of a test's points for an answer that is right but for a constant of `FACTORS`."""
LEAST = 3
"""Different numbers that are off by the same rational factor, for it to be one mistake."""
FACTORS = {
    "-1": -1.0,
    **{"2": 2.0, "1/2": 0.5, "4": 4.0, "1/4": 0.25},
    **{"π": np.pi, "1/π": 1 / np.pi, "π²": np.pi**2, "1/π²": np.pi**-2},
    **{"2π": 2 * np.pi, "1/2π": 0.5 / np.pi, "4π": 4 * np.pi, "1/4π": 0.25 / np.pi},
    **{"π/2": np.pi / 2, "2/π": 2 / np.pi, "√2": 2**0.5, "1/√2": 2**-0.5},
}
"""Constants that are forgotten, or counted twice."""


@dataclass(frozen=True)
class Ratio:
    """A factor that a known mistake brings about.

    Attributes:
        values: The factor, element by element.
        hint: The mistake.
    """

    values: Any
    hint: str


Ratios = Mapping[str, str | Ratio]
"""Hints by a name of `FACTORS`, or by a name of its own with a `Ratio`."""


@dataclass(frozen=True)
class Found:
    """The factor between what came and what is right.

    Attributes:
        name: Its name.
        hint: What is usually forgotten then, "" if nothing is known.
        share: Share of the test's points that is left.
    """

    name: str
    hint: str
    share: float


def find(wanted: np.ndarray, agrees: Callable[[Any], bool], ratios: Ratios | None) -> Found | None:
    """The one factor with which `wanted` is what came.

    Args:
        wanted: What is right.
        agrees: Whether what came agrees with an array instead.
        ratios: Hints, and further factors.

    Returns:
        None if none does, or several do, so that the answer does not tell which.
    """
    ratios = ratios or {}
    own = {name: each.values for name, each in ratios.items() if isinstance(each, Ratio)}
    with np.errstate(all="ignore"):
        names = [name for name, value in (FACTORS | own).items() if agrees(wanted * value)]
    if len(names) != 1:
        return None
    name = names[0]
    hint = ratios.get(name, "")
    # 2 may be chance in one number, π is not
    sure = any(sign in name for sign in "π√") or np.unique(wanted[wanted != 0]).size >= LEAST
    share = SHARE if sure and name not in own else 0.0
    return Found(name, hint.hint if isinstance(hint, Ratio) else hint, share)
