"""Photons of a SPAD array one by one: arrival, dead time, afterpulses, crosstalk, coincidence.

Times are keys, pixel * pixel_stride + cycle * cycle_stride + bin. Gaps between pixels, and between
cycles that start armed, are longer than the dead time. One pass therefore treats a sorted row.

The cycles are simulated in chunks, so that memory does not grow with their number. The dead time of
free-running SPADs continues in the next chunk. A chunk then starts with the avalanches that still
block the detector, and with the afterpulses that have not happened yet.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from .photon_rates import Block, generator
from .spad_parameters import SpadParameters

# Expected avalanches of a row of SPADs in a chunk of cycles
CHUNK = 1 << 20

# Photons per pixel and cycle if chunks must not depend on the rates
NOMINAL = 1.0

# Stream of random numbers
AFTERPULSES = 4


class Pending(NamedTuple):
    """Pending avalanches of a chunk: pixels, and times [bins] from the start of the next chunk."""

    pixel: np.ndarray
    time: np.ndarray


NOTHING = Pending(np.zeros(0, np.int64), np.zeros(0, np.int64))


class KeyLayout:
    """Keys of a row of pixels.

    Args:
        shape: Numbers of pixels, cycles and bins.
        dead: Number of bins that a detection blocks, None without a dead time.
        window: Window of coincidence [bins].
        free: Whether the dead time continues in the next cycle. Otherwise cycles start armed.
    """

    def __init__(self, shape: tuple[int, int, int], dead: int | None, window: int, free: bool):
        self.width, self.cycles, self.bins = shape
        self.dead = dead
        self.window = window
        self.free = free
        gap = max(dead or 0, window) + 1
        self.cycle_stride = self.bins + (0 if free else gap)

        # Avalanches of the chunk before are in the gap before a pixel
        self.pixel_stride = self.cycles * self.cycle_stride + 2 * gap

    def chunk(self, cycles: int) -> KeyLayout:
        """Return the layout of a chunk with this number of cycles."""
        return KeyLayout((self.width, cycles, self.bins), self.dead, self.window, self.free)

    def chunks(self, per_cycle: float) -> Iterator[tuple[int, KeyLayout]]:
        """Cut the cycles into chunks, for so many expected avalanches of a row in a cycle.

        Yields:
            The first cycle of a chunk, and the layout of its cycles.
        """
        most_keys = (1 << 61) // (self.width * (self.cycle_stride + 1))
        step = int(np.clip(CHUNK / max(per_cycle, 1e-9), 1, min(self.cycles, most_keys)))
        for first in range(0, self.cycles, step):
            yield first, self.chunk(min(step, self.cycles - first))

    def parts(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pixel, cycle and bin of keys."""
        pixel = keys // self.pixel_stride
        keys = keys - pixel * self.pixel_stride
        cycle = keys // self.cycle_stride
        return pixel, cycle, keys - cycle * self.cycle_stride

    def keys_of(self, pending: Pending) -> np.ndarray:
        """Return the keys of pending avalanches of the previous chunk."""
        return pending.pixel * self.pixel_stride + pending.time

    def pending_after(self, keys: np.ndarray, bins: int) -> Pending:
        """Return the avalanches in the last `bins` bins, which can affect the next chunk.

        Args:
            keys: Keys of all avalanches of this chunk.
            bins: Number of bins before the end of the chunk.
        """
        pixel = keys // self.pixel_stride
        time = keys - pixel * self.pixel_stride - self.cycles * self.bins
        last = (time >= -bins) & (time < 0)
        return Pending(pixel[last], time[last])


def arrivals(rng: np.random.Generator, rates: np.ndarray, layout: KeyLayout) -> np.ndarray:
    """Sample sorted keys of the photons of a row (pixel, bin), with Poisson numbers of photons."""
    counts = rng.poisson(rates * layout.cycles)
    first = np.arange(layout.width)[:, None] * layout.pixel_stride + np.arange(layout.bins)
    keys = np.repeat(first.ravel(), counts.ravel())
    keys += rng.integers(layout.cycles, size=keys.size) * layout.cycle_stride
    keys.sort()
    return keys


def detected(keys: np.ndarray, dead: int | None, paralysable: bool) -> np.ndarray:
    """Return a mask of the photons of sorted keys that are detected.

    A photon that follows the previous photon by more than the dead time is always detected. It is
    the head of a cluster. If the dead time is not paralysable, further photons of all clusters are
    searched at once.

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


class SpadRow:
    """Simulation of the photons and avalanches of a row of SPADs, chunk after chunk.

    Args:
        spad: The SPAD array.
        rates: Rates (pixel, bin).
        seed: Seed of the random numbers.
        row: Number of the row.
        bin_s: Width of the bins [s].
    """

    def __init__(
        self, spad: SpadParameters, rates: np.ndarray, seed: int, row: int, bin_s: float
    ) -> None:
        self.spad = spad
        self.rates = rates
        self.rng = generator(seed, row)
        self.afterpulse_rng = generator(seed, row, AFTERPULSES)
        self.mean_delay = spad.afterpulse_time_s / bin_s
        self.photons = np.zeros(0, np.int64)

        # Avalanches of the chunk before: photons alone, and all avalanches
        self.blocking_alone = NOTHING
        self.blocking = NOTHING
        self.waiting = NOTHING

    def arrive(self, layout: KeyLayout) -> None:
        """Sample the photons of a chunk."""
        self.photons = arrivals(self.rng, self.rates, layout)

    def crosstalk(self, layout: KeyLayout) -> dict[int, np.ndarray]:
        """Sample the avalanches that detected photons cause in neighbors, by relative row."""
        keys, before = self._with_blocking(self.photons, self.blocking_alone, layout)
        found = detected(keys, layout.dead, self.spad.paralysable)
        if layout.free and layout.dead is not None:
            blocking = keys if self.spad.paralysable else keys[found]
            self.blocking_alone = layout.pending_after(blocking, layout.dead)
        parents = keys[found & ~before]
        sources = parents[self.rng.random(parents.size) < self.spad.crosstalk_probability]
        side = self.rng.integers(4, size=sources.size)
        pixel = sources // layout.pixel_stride
        beside = [sources[(side == 0) & (pixel > 0)] - layout.pixel_stride]
        beside.append(sources[(side == 2) & (pixel < layout.width - 1)] + layout.pixel_stride)
        return {0: np.concatenate(beside), -1: sources[side == 1], 1: sources[side == 3]}

    def detect(self, more: list[np.ndarray], layout: KeyLayout) -> np.ndarray:
        """Return the sorted keys of detections among the photons and `more` avalanches."""
        keys = self.photons
        if more:
            keys = np.sort(np.concatenate([keys, *more]))
        if self.spad.afterpulse_probability:
            return self._detect_with_afterpulses(keys, layout)
        keys, before = self._with_blocking(keys, self.blocking, layout)
        found = detected(keys, layout.dead, self.spad.paralysable)
        if layout.free and layout.dead is not None:
            blocking = keys if self.spad.paralysable else keys[found]
            self.blocking = layout.pending_after(blocking, layout.dead)
        return keys[found & ~before]

    def _with_blocking(
        self, keys: np.ndarray, blocking: Pending, layout: KeyLayout
    ) -> tuple[np.ndarray, Any]:
        """Add avalanches of the previous chunk to sorted keys. Return keys and a mask of these."""
        if not blocking.pixel.size:
            return keys, np.False_
        keys = np.concatenate([layout.keys_of(blocking), keys])
        order = np.argsort(keys, kind="stable")
        return keys[order], order < blocking.pixel.size

    def _detect_with_afterpulses(self, keys: np.ndarray, layout: KeyLayout) -> np.ndarray:
        """Return sorted keys of detections among sorted keys and their afterpulses."""
        # Start with what the chunk before has left
        length = layout.cycles * layout.bins
        happens = self.waiting.time < length
        waiting = Pending(*(each[happens] for each in self.waiting))
        later = Pending(self.waiting.pixel[~happens], self.waiting.time[~happens] - length)
        blocking = layout.keys_of(self.blocking)
        roots = np.concatenate([keys, layout.keys_of(waiting), blocking])
        can_cause = np.arange(roots.size - blocking.size)

        # Draw the afterpulse that each avalanche would cause, if it were detected
        tree = [roots]
        parents = [np.full(roots.size, -1)]
        beyond = [(later.pixel, later.time, np.full(later.pixel.size, -1))]
        count = roots.size
        pixels = roots[: can_cause.size] // layout.pixel_stride
        while can_cause.size:
            causes = self.afterpulse_rng.random(can_cause.size) < self.spad.afterpulse_probability
            can_cause = can_cause[causes]
            pixels = pixels[causes]
            source = tree[-1][: causes.size][causes]
            delay = self.afterpulse_rng.exponential(self.mean_delay, source.size).astype(np.int64)
            delay += 0 if layout.dead is None else layout.dead + 1
            at = source - pixels * layout.pixel_stride
            if layout.free:
                inside = at + delay < length
                late = ~inside
                beyond.append((pixels[late], (at + delay)[late] - length, can_cause[late]))
            else:
                inside = at % layout.cycle_stride + delay < layout.bins
            tree.append((source + delay)[inside])
            parents.append(can_cause[inside])
            pixels = pixels[inside]
            can_cause = count + np.arange(pixels.size)
            count += pixels.size

        # Sort by time, and find which avalanches happen and are detected
        keys = np.concatenate(tree)
        parent = np.concatenate(parents)
        order = np.argsort(keys, kind="stable")
        place = np.empty(count, np.int64)
        place[order] = np.arange(count)
        keys = keys[order]
        parent = np.where(parent < 0, -1, place[parent])[order]
        happen, found = caused_and_detected(keys, parent, layout.dead, self.spad.paralysable)

        # Leave what the next chunk needs
        if layout.free:
            pixel, time, cause = (np.concatenate(each) for each in zip(*beyond, strict=True))
            comes = (cause < 0) | found[place[cause]]
            self.waiting = Pending(pixel[comes], time[comes])
            if layout.dead is not None:
                blocks = happen if self.spad.paralysable else found
                self.blocking = layout.pending_after(keys[blocks], layout.dead)
        found[place[roots.size - blocking.size : roots.size]] = False
        return keys[found]


def caused_and_detected(
    keys: np.ndarray, parent: np.ndarray, dead: int | None, paralysable: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Find which possible avalanches happen, and which of these are detected.

    An avalanche happens if the avalanche that causes it is detected. Causes are earlier, so that
    each repetition is right for longer after the first photon, until nothing changes.

    Args:
        keys: Sorted keys of possible avalanches.
        parent: Index of the avalanche that causes each; -1 for photons and crosstalk.
        dead: Dead time [bins], None for none.
        paralysable: Whether avalanches within the dead time prolong it.

    Example:
        >>> keys, parent = np.array([0, 4, 5, 9]), np.array([-1, 0, -1, 2])
        >>> happen, found = caused_and_detected(keys, parent, 3, False)
        >>> happen.tolist(), found.tolist()  # The afterpulse at 4 masks the photon at 5
        ([True, True, True, False], [True, True, False, False])
    """
    happen = parent < 0
    if dead is None or not keys.size:
        return np.ones(keys.size, bool), np.ones(keys.size, bool)

    # Between clusters, there is more than a dead time without any possible avalanche
    cluster = np.cumsum(np.diff(keys, prepend=keys[0]) > dead)
    afterpulses = np.flatnonzero(parent >= 0)
    causes = parent[afterpulses]
    found = np.zeros(keys.size, bool)
    again = np.arange(keys.size)
    while again.size:
        # Detect the avalanches of clusters that have changed
        found[again] = False
        again = again[happen[again]]
        found[again] = detected(keys[again], dead, paralysable)

        # Which afterpulses does this change?
        changed = afterpulses[happen[afterpulses] != found[causes]]
        happen[changed] = ~happen[changed]
        touched = np.zeros(cluster[-1] + 1, bool)
        touched[cluster[changed]] = True
        again = np.flatnonzero(touched[cluster]) if changed.size else changed
    return happen, found


class MacroPixels:
    """Detections of a row of macro pixels, chunk after chunk."""

    def __init__(self, spad: SpadParameters) -> None:
        self.spad = spad
        self.recent = NOTHING
        self.blocking = NOTHING

    def detect(self, rows: list[np.ndarray], layout: KeyLayout) -> np.ndarray:
        """Return sorted keys of detections from the detections of the rows of SPADs."""
        if self.spad.macro_pixel == (1, 1):
            return rows[0]
        keys = np.concatenate(rows)
        pixel = keys // layout.pixel_stride
        keys = np.sort(keys - (pixel - pixel // self.spad.macro_pixel[1]) * layout.pixel_stride)
        if self.spad.coincidence > 1:
            keys = self._coincident(keys, layout)
        if self.spad.mode == "first_photon":
            keys = keys[detected(keys, layout.dead, paralysable=False)]
        return keys

    def _coincident(self, keys: np.ndarray, layout: KeyLayout) -> np.ndarray:
        """Return the keys of avalanches that complete a coincidence within the window."""
        # Avalanches of the chunk before count, but their own detections have been returned
        earlier = layout.keys_of(self.recent)
        every = np.concatenate([earlier, keys])
        order = np.argsort(every, kind="stable")
        every = every[order]
        is_new = order >= earlier.size
        more = self.spad.coincidence - 1
        first = every[: max(0, every.size - more)]
        enough = every[more:] - first <= layout.window
        hits = every[more:][enough & is_new[more:]]

        # The next detection follows after the window
        blocking = layout.keys_of(self.blocking)
        hits = np.concatenate([blocking, hits])
        order = np.argsort(hits, kind="stable")
        hits = hits[order]
        is_new = order >= blocking.size
        found = detected(hits, layout.window, paralysable=False)
        if layout.free:
            self.recent = layout.pending_after(every, layout.window)
            self.blocking = layout.pending_after(hits[found], layout.window)
        return hits[found & is_new]


def detections(
    spad: SpadParameters, block: Block, layout: KeyLayout, seed: int, bin_s: float
) -> Iterator[tuple[int, int, KeyLayout, np.ndarray]]:
    """Simulate the detections of a block, row by row of macro pixels and chunk by chunk of cycles.

    Yields:
        Number of the row of macro pixels in the block, first cycle and layout of the chunk, and
        sorted keys of what it detects.
    """
    tall = spad.macro_pixel[0]
    crosses = spad.crosstalk_probability > 0
    size = len(block.inner) if crosses else tall
    for start in range(block.inner.start, block.inner.stop, size):
        # Rows that cause crosstalk here are simulated, too
        inner = range(start, start + size)
        low, high = (0, len(block.values)) if crosses else (inner.start, inner.stop)
        rows = {
            k: SpadRow(spad, block.values[k], seed, block.first + k, bin_s)
            for k in range(low, high)
        }
        macro_pixels = {k: MacroPixels(spad) for k in inner[::tall]}

        # Chunks are the same in all blocks that need a row
        if crosses:
            per_cycle = NOMINAL * layout.width
        else:
            per_cycle = max(float(rows[k].rates.sum()) for k in inner)
        per_cycle /= 1 - spad.afterpulse_probability
        for first, chunk in layout.chunks(per_cycle):
            for row in rows.values():
                row.arrive(chunk)
            caused = {k: row.crosstalk(chunk) for k, row in rows.items()} if crosses else {}
            for k, macro_row in macro_pixels.items():
                found = []
                for each in range(k, k + tall):
                    near = [(each + d, -d) for d in (-1, 0, 1) if each + d in caused]
                    more = [caused[number][to] for number, to in near]
                    found.append(rows[each].detect(more, chunk))
                number = (k - block.inner.start) // tall
                yield number, first, chunk, macro_row.detect(found, chunk)
