"""The case `warps`: time of our warps relative to Mitsuba's, and time of a chi-square test."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import drjit as dr
import mitsuba as mi

from tofrender.sampling import independent, warp_case

from .timing import Row, Times, in_turn

ALPHA = 0.3
NAMES = (
    "tent",
    "uniform_disk",
    "uniform_sphere",
    "uniform_hemisphere",
    "cosine_hemisphere",
    "beckmann",
)


def _warp(warp: Callable, *numbers: object) -> None:
    """Warp numbers, and evaluate the result."""
    dr.eval(warp(*numbers))


def _both(times: dict[str, Times], name: str) -> Times:
    """Add the times of both calls of a function."""
    first = times[name]
    second = times[f"{name} again"]
    return Times(first.wall + second.wall, first.cpu + second.cpu)


def warps(runs: int, quick: bool) -> list[Row]:
    """Compare the time of ten million samples with Mitsuba's warp of the same name."""
    count = 100_000 if quick else 10_000_000
    sample = independent(count)
    dr.eval(sample)
    rows: list[Row] = []
    for name in NAMES:
        parameter = {"alpha": ALPHA} if name == "beckmann" else {}
        case = warp_case(name, **parameter)
        theirs = getattr(mi.warp, f"square_to_{name}")
        ours = partial(_warp, case.sample, sample)
        mitsubas = partial(_warp, theirs, sample, *parameter.values())

        # Dr.Jit alternates between two sets of buffers, and one set can be twice as fast
        functions = {"A": ours, "B": mitsubas, "B again": mitsubas, "A again": ours}
        times = in_turn(functions, 5 * runs)
        what = f"{name}, {count:.0e} samples, over mi.warp"
        rows += _both(times, "A").rows(_both(times, "B"), what, 1.5, 1.5)

    # Measure a chi-square test
    samples = 20_000 if quick else 1_000_000
    case = warp_case("beckmann", alpha=ALPHA)
    times = in_turn({"test": partial(case.test, samples=samples)}, runs)
    seconds = float(sorted(times["test"].wall)[runs // 2])
    return [*rows, (f"chi-square test, {samples:.0e} samples [s]", seconds, None)]
