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
"""Name, value and target of a figure."""


@dataclass
class Times:
    """Times of a function in several runs [s].

    Attributes:
        wall: Wall-clock times.
        cpu: CPU times of all threads of the process, which vary less on a shared machine.
    """

    wall: np.ndarray
    cpu: np.ndarray

    def ratio(self, other: Times) -> tuple[float, float]:
        """Return the median ratios of wall-clock time and CPU time to other times."""
        return float(np.median(self.wall / other.wall)), float(np.median(self.cpu / other.cpu))

    def rows(
        self,
        other: Times,
        name: str,
        wall: float | None = None,
        cpu: float | None = None,
        factor: float = 1.0,
    ) -> list[Row]:
        """Return two rows with the ratios of times, multiplied by a factor, and their targets."""
        ratios = self.ratio(other)
        return [
            (f"{name}: wall", factor * ratios[0], wall),
            (f"{name}: cpu", factor * ratios[1], cpu),
        ]


def in_turn(functions: Mapping[str, Callable[[], object]], runs: int) -> dict[str, Times]:
    """Measure functions in alternation, A B C A B C, so that the load of the machine is shared."""
    # Call each function once to compile it
    for function in functions.values():
        function()
        dr.sync_thread()

    # Measure the runs
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
    """Return the variance over seeds (mean over pixels), and the times."""
    images: dict[str, list[np.ndarray]] = {name: [] for name in functions}

    def draw(name: str) -> None:
        images[name].append(functions[name](len(images[name])))

    times = in_turn({name: partial(draw, name) for name in functions}, max(runs, 4))
    variance = {name: float(np.var(s[1:], axis=0, ddof=1).mean()) for name, s in images.items()}
    return variance, times


def trace(scene: mi.Scene, spp: int, **options: Any) -> Callable[[], object]:
    """Return a function that renders by `mi.render`. The result stays on the device."""
    return lambda: dr.eval(mi.render(scene, spp=spp, **options))
