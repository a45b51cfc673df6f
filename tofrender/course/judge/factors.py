"""Answers that are right but for one factor: find it, and name the usual mistake.

    ratios = {"π": "divide by 4π²", "1/cos": Ratio(1 / cos, "the cosine is missing")}
    expect.close(came, wanted, "radiance", ratios=ratios)

A constant of `FACTORS` leaves a part of the points, if it cannot be chance: the mistake is a small
one.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

FRACTION = 0.5  # fraction of a test's points for such an answer
LEAST = 3  # numbers, farther apart than the noise, that are off by a factor for it to be sure
# Constants that are forgotten, or counted twice
FACTORS = {
    "-1": -1.0,
    **{"2": 2.0, "1/2": 0.5, "4": 4.0, "1/4": 0.25},
    **{"π": np.pi, "1/π": 1 / np.pi, "π²": np.pi**2, "1/π²": np.pi**-2},
    **{"2π": 2 * np.pi, "1/2π": 0.5 / np.pi, "4π": 4 * np.pi, "1/4π": 0.25 / np.pi},
    **{"π/2": np.pi / 2, "2/π": 2 / np.pi, "√2": 2**0.5, "1/√2": 2**-0.5},
}


@dataclass(frozen=True)
class Ratio:
    """Factor that a known mistake brings about."""

    values: Any  # the factor, element by element
    hint: str  # the mistake


Ratios = Mapping[str, str | Ratio]
"""Hints by a name of `FACTORS`, or by a name of its own with a `Ratio`."""


def find(
    wanted: np.ndarray,
    agrees: Callable[[Any], bool],
    ratios: Ratios | None,
    means: np.ndarray,
    tolerance: float,
) -> tuple[str, str, float] | None:
    """Name, hint and fraction of the points of the only factor with which `wanted` agrees.

    `means` are those of `wanted` over seeds; noise or rounding explains differences of `tolerance`.
    """
    ratios = ratios or {}
    own = {name: each.values for name, each in ratios.items() if isinstance(each, Ratio)}
    with np.errstate(all="ignore"):
        names = [name for name, value in (FACTORS | own).items() if agrees(wanted * value)]
    if len(names) != 1:
        return None
    name, hint = names[0], ratios.get(names[0], "")
    apart = np.diff(np.sort(means[np.abs(means) > tolerance])) > tolerance
    fraction = FRACTION if apart.sum() + 1 >= LEAST and name not in own else 0.0
    return name, hint.hint if isinstance(hint, Ratio) else hint, fraction
