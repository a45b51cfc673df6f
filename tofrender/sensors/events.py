"""Photons of a SPAD array one by one: arrival, dead time, afterpulses, crosstalk, coincidence.

Times are keys, pixel * pixel_stride + cycle * cycle_stride + bin, with gaps between pixels, and
between cycles that start armed, longer than the dead time: one pass treats a whole sorted row.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from .rates import Block, generator

if TYPE_CHECKING:
    from .spad import Spad


class Layout:
    """Keys of a row of `shape` (pixels, cycles, bins), where cycles start armed unless `free`.

    A detection blocks `dead` bins after it, or, if None, none; `window` is that of coincidence.
    """

    def __init__(self, shape: tuple[int, int, int], dead: int | None, window: int, free: bool):
        self.width, self.cycles, self.bins = shape
        self.dead, self.window, self.free = dead, window, free
        gap = max(dead or 0, window) + 1
        self.cycle_stride = self.bins + (0 if free else gap)
        self.pixel_stride = self.cycles * self.cycle_stride + gap
        fits = self.width * self.pixel_stride < 1 << 62
        checks.require("cycles", self.cycles, fits, "fewer for so many pixels and bins")

    def parts(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixel, cycle and bin of keys."""
        pixel = keys // self.pixel_stride
        keys = keys - pixel * self.pixel_stride
        cycle = keys // self.cycle_stride
        return pixel, cycle, keys - cycle * self.cycle_stride

    def later(self, keys: np.ndarray, bins: np.ndarray) -> np.ndarray:
        """Keys later by these bins, without those after the end of the cycle, or of all cycles."""
        _, cycle, at = self.parts(keys)
        start, end = (cycle, self.cycles) if self.free else (0, 1)
        return (keys + bins)[start * self.bins + at + bins < end * self.bins]


def arrivals(rng: np.random.Generator, rates: np.ndarray, layout: Layout) -> np.ndarray:
    """Sorted keys of the photons of a row (pixel, bin): Poisson numbers, in random cycles."""
    counts = rng.poisson(rates * layout.cycles)
    first = np.arange(layout.width)[:, None] * layout.pixel_stride + np.arange(layout.bins)
    keys = np.repeat(first.ravel(), counts.ravel())
    keys += rng.integers(layout.cycles, size=keys.size) * layout.cycle_stride
    keys.sort()
    return keys


def detected(keys: np.ndarray, dead: int | None, paralysable: bool) -> np.ndarray:
    """Which photons of sorted keys find the detector armed.

    Those that follow another by more than the dead time do; from them, if not paralysable, all
    clusters are followed at once.

    Example:
        >>> keys = np.array([0, 2, 3, 5, 20])
        >>> [detected(keys, 2, paralysable).astype(int).tolist() for paralysable in (False, True)]
        [[1, 0, 1, 0, 1], [1, 0, 0, 0, 1]]
    """
    if dead is None or not keys.size:
        return np.ones(keys.size, bool)
    found = np.diff(keys, prepend=keys[0] - dead - 1) > dead
    heads = np.flatnonzero(found)
    ends = np.append(heads[1:], keys.size)
    inside = (ends - heads > 1) & (not paralysable)
    while inside.any():
        ends = ends[inside]
        heads = np.searchsorted(keys, keys[heads[inside]] + dead, side="right")
        inside = heads < ends
        found[heads[inside]] = True
    return found


def detections(spad: Spad, block: Block, layout: Layout, seed: int, bin_s: float) -> list:
    """Sorted keys of what each row of a block detects, or each row of macro pixels."""
    own, caused, rows = [], [], []
    for k, rates in enumerate(block.values):
        rng = generator(seed, block.first + k)
        own.append(arrivals(rng, rates, layout))
        if spad.crosstalk_probability or spad.afterpulse_probability:
            parents = own[k][detected(own[k], layout.dead, spad.paralysable)]
            caused.append(_caused(rng, spad, parents, layout, bin_s))
    for k in block.inner:
        more = [caused[k + d][-d] for d in (-1, 0, 1) if 0 <= k + d < len(caused)]
        keys = np.sort(np.concatenate([own[k], *more])) if more else own[k]
        rows.append(keys[detected(keys, layout.dead, spad.paralysable)])
    if spad.macro_pixel == (1, 1):
        return rows
    tall, wide = spad.macro_pixel
    for k in range(0, len(rows), tall):
        keys = np.concatenate(rows[k : k + tall])
        pixel = keys // layout.pixel_stride
        keys = np.sort(keys - (pixel - pixel // wide) * layout.pixel_stride)
        rows[k] = _coincident(keys, spad, layout)
    return rows[::tall]


def _caused(rng: Any, spad: Spad, parents: np.ndarray, layout: Layout, bin_s: float) -> dict:
    """Keys of avalanches that detections cause, by the row relative to theirs."""
    sources = parents[rng.random(parents.size) < spad.crosstalk_probability]
    side, pixel = rng.integers(4, size=sources.size), sources // layout.pixel_stride
    found = [sources[(side == 0) & (pixel > 0)] - layout.pixel_stride]
    found.append(sources[(side == 2) & (pixel < layout.width - 1)] + layout.pixel_stride)
    while parents.size:
        parents = parents[rng.random(parents.size) < spad.afterpulse_probability]
        delay = rng.exponential(spad.afterpulse_time_s / bin_s, parents.size).astype(np.int64)
        parents = layout.later(parents, delay + (0 if layout.dead is None else layout.dead + 1))
        found.append(parents)
    return {0: np.concatenate(found), -1: sources[side == 1], 1: sources[side == 3]}


def _coincident(keys: np.ndarray, spad: Spad, layout: Layout) -> np.ndarray:
    """Keys at which `coincidence` avalanches of a macro pixel lie within the window."""
    more = spad.coincidence - 1
    if more:
        keys = keys[more:][keys[more:] - keys[: max(0, keys.size - more)] <= layout.window]
        keys = keys[detected(keys, layout.window, paralysable=False)]
    if spad.mode == "first_photon":
        keys = keys[detected(keys, layout.dead, paralysable=False)]
    return keys
