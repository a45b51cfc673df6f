"""Run functions in turn and compare their times pair by pair."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

Row = tuple[str, float, float | None]
"""A figure: name, value, target."""


@dataclass
class Times:
    """Times of one function [s], one entry a run.

    Attributes:
        wall: Wall-clock times.
        cpu: Times of all threads of the process; steadier on a shared machine.
    """

    wall: np.ndarray
    cpu: np.ndarray

    def ratio(self, other: Times) -> tuple[float, float]:
        """Median over the runs of this time over the other's: wall, cpu."""
        return float(np.median(self.wall / other.wall)), float(np.median(self.cpu / other.cpu))

    def rows(
        self,
        other: Times,
        name: str,
        wall: float | None = None,
        cpu: float | None = None,
        factor: float = 1.0,
    ) -> list[Row]:
        """This time over the other's, times a factor, as two rows with these targets."""
        ratios = self.ratio(other)
        return [
            (f"{name}: wall", factor * ratios[0], wall),
            (f"{name}: cpu", factor * ratios[1], cpu),
        ]


def in_turn(functions: Mapping[str, Callable[[], object]], runs: int) -> dict[str, Times]:
    """Call all functions once to warm up, then all of them `runs` times, A B C A B C ..."""
    for function in functions.values():
        function()
        dr.sync_thread()
    wall = {name: [] for name in functions}
    cpu = {name: [] for name in functions}
    for _ in range(runs):
        for name, function in functions.items():
            start = time.perf_counter(), time.process_time()
            function()
            dr.sync_thread()
            wall[name].append(time.perf_counter() - start[0])
            cpu[name].append(time.process_time() - start[1])
    return {name: Times(np.array(wall[name]), np.array(cpu[name])) for name in functions}


def noise(
    functions: dict[str, Callable[[int], np.ndarray]], runs: int
) -> tuple[dict[str, float], dict[str, Times]]:
    """Variance over seeds, mean over pixels, and times."""
    images: dict[str, list[np.ndarray]] = {name: [] for name in functions}

    def draw(name: str) -> None:
        images[name].append(functions[name](len(images[name])))

    times = in_turn({name: partial(draw, name) for name in functions}, max(runs, 4))
    variance = {name: float(np.var(s[1:], axis=0, ddof=1).mean()) for name, s in images.items()}
    return variance, times


def trace(scene: mi.Scene, spp: int, **options: Any) -> Callable[[], object]:
    """A render by `mi.render` whose result stays on the device."""
    return lambda: dr.eval(mi.render(scene, spp=spp, **options))
