"""Readout of SPAD arrays: time stamps with jitter and TDC codes, and their histograms."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..analysis.rebinning import sums_between
from ..labels import require_consecutive
from ..runtime import checks
from ..signals.units import SPEED_OF_LIGHT
from .dead_time import armed_detections, sample_counts
from .events import KeyLayout, detections
from .jitter import add_jitter, kernel, sample_jitter
from .photon_rates import Block, Rates, generator
from .pile_up import first_photon
from .response import distribution
from .spad_parameters import SpadParameters

# Rows that are simulated together
ROWS = 8

# Streams of random numbers, next to the stream of photons
_HOT = 1
_STAMPS = 2
_TDC = 3


class Readout:
    """Readout of a SPAD array for certain rates, with the seed of its noise.

    Args:
        spad: The SPAD array.
        rates: The rates.
        seed: Seed of the random numbers.

    Attributes:
        shape: Shape of results (y, x, code).
        rows: Number of rows that are simulated together, and of neighboring rows that they need.
        centers: Nominal centers of the codes [m].
        attrs: Attributes of results.
    """

    def __init__(self, spad: SpadParameters, rates: Rates, seed: int = 0) -> None:
        self.spad = spad
        self.rates = rates
        self.seed = seed
        self.bin_s = rates.width / SPEED_OF_LIGHT

        # Crosstalk and macro pixels need neighboring pixels
        if spad.crosstalk_probability or spad.macro_pixel != (1, 1):
            require_consecutive(rates.dataset, "rates")
        height, width, bins = rates.values.shape
        tall, wide = spad.macro_pixel
        whole = height % tall == width % wide == 0
        allowed = f"numbers that divide the film of {height} x {width} pixels"
        checks.require("macro_pixel", spad.macro_pixel, whole, allowed)
        self.rows = -(-ROWS // tall) * tall, int(spad.crosstalk_probability > 0)

        # Time axis of the simulation
        dead = rates.bins_of("dead_time_s", spad.dead_time_s) if spad.dead_time_s else None
        dead = bins if spad.mode == "first_photon" else dead
        window = rates.bins_of("coincidence_window_s", spad.coincidence_window_s)
        free = spad.mode == "free_running"
        self.layout = KeyLayout((width, rates.cycles, bins), dead, window, free)

        # Width of the TDC's codes, in bins
        merged = (spad.tdc_lsb_s or self.bin_s) / self.bin_s
        self.merged = round(merged)
        whole = 1 <= self.merged <= bins and abs(merged - self.merged) < 1e-6 * merged
        checks.require("tdc_lsb_s", spad.tdc_lsb_s, whole, f"a multiple of {self.bin_s:g} s, a bin")

        # Edges of the codes, with their nonlinearity
        full = bins // self.merged if spad.tdc_bits is None else 1 << spad.tdc_bits
        codes = min(full, bins // self.merged)
        widths = generator(spad.device_seed, _TDC).normal(1, spad.tdc_dnl, full).clip(0.01)
        edges = np.cumsum(np.append(0, widths / widths.mean())) * self.merged
        self.edges = np.minimum(edges[: codes + 1], bins)
        self.shape = (height // tall, width // wide, codes)
        width = self.merged * rates.width
        self.centers = rates.edges[0] + (np.arange(codes) + 0.5) * width

        # Jitter
        jitter = spad.jitter and distribution("jitter", spad.jitter)
        if jitter:
            fits = np.abs(jitter.ppf([1e-6, 1 - 1e-6])).max() < bins * rates.width
            checks.require("jitter", spad.jitter, fits, "shorter than the window")
        self.masses = jitter and kernel(jitter, rates.width)

        # Describe the sensor
        given = {f"spad_{name}": value for name, value in vars(spad).items()}
        plain = {k: v if isinstance(v, int | float) else str(v) for k, v in given.items()}
        self.attrs = plain | {"bin_width_opl": width, "sensor_seed": seed}

        # Must photons be simulated one by one?
        chained = spad.dead_time_s > 0 and (spad.paralysable or free)
        caused = spad.afterpulse_probability + spad.crosstalk_probability > 0
        self.one_by_one = chained or caused or spad.macro_pixel != (1, 1)

    def histogram(self, block: Block) -> np.ndarray:
        """Simulate counts (y, x, code) of a block."""
        block = self._with_hot_pixels(block)
        if self.one_by_one:
            found = np.zeros((len(block.inner) // self.spad.macro_pixel[0], *self.shape[1:]), int)
            for row, pixel, _, code in self._stamps(block):
                found[row] += self._bincount(pixel, code)
            return found
        return np.array([self._counts(block.values[k], block.first + k) for k in block.inner])

    def expected(self, block: Block) -> np.ndarray:
        """Return the expectation of `histogram` for photons that do not interact."""
        values = self._with_hot_pixels(block).values
        return np.array([self._probabilities(v) for v in values]) * self.layout.cycles

    def table(self, block: Block) -> list[np.ndarray]:
        """Simulate the time stamps of a block, as columns row, pixel, cycle and code."""
        first = (block.first + block.inner.start) // self.spad.macro_pixel[0]
        stamps = self._stamps(self._with_hot_pixels(block))
        rows = [(np.full(pixel.size, first + row), pixel, *more) for row, pixel, *more in stamps]
        columns = [np.concatenate(parts).astype(np.int32) for parts in zip(*rows, strict=True)]

        # Chunks of cycles follow each other in each row; sort by pixel, and keep the order of time
        order = np.lexsort((columns[1], columns[0]))
        return [column[order] for column in columns]

    def _probabilities(self, rates: np.ndarray) -> np.ndarray:
        """Return the expected stamps per cycle (x, code) for rates (x, bin)."""
        # Detections, by mode and dead time
        found = rates
        dead = self.layout.dead
        free = self.layout.free
        if self.spad.mode == "first_photon":
            found = first_photon(rates)
        elif dead is not None:
            found = armed_detections(rates, dead, self.spad.paralysable, free)

        # Jitter and TDC
        if self.masses is not None:
            found = add_jitter(found, self.masses, free)
        return sums_between(found, self.edges)

    def _counts(self, rates: np.ndarray, row: int) -> np.ndarray:
        """Sample counts (x, code) of a row from their distribution."""
        # Without dead time, counts are Poisson distributed
        rng = generator(self.seed, row)
        layout = self.layout
        if layout.dead is None:
            return rng.poisson(self._probabilities(rates) * layout.cycles)

        # First photons are multinomial, with one more class for cycles without a stamp
        if self.spad.mode == "first_photon":
            p = np.pad(self._probabilities(rates), ((0, 0), (0, 1)))
            p[:, -1] = np.maximum(1 - p.sum(axis=1), 0)
            p /= p.sum(axis=1, keepdims=True)
            return rng.multinomial(layout.cycles, p)[:, :-1]

        # Otherwise, sample the detections
        counts = sample_counts(rng, rates, layout.cycles, layout.dead)
        if self.masses is None and not self.spad.tdc_dnl:
            return sums_between(counts, self.edges).astype(np.int64)

        # Read out each detection
        pixel, bins = np.divmod(np.repeat(np.arange(counts.size), counts.ravel()), layout.bins)
        return self._bincount(*self._read_out(rng, pixel, 0 * pixel, bins)[::2])

    def _stamps(self, block: Block) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
        """Simulate the stamps of a block, chunk by chunk of the cycles.

        Yields:
            Row of (macro) pixels in the block, and pixel, cycle and code of its stamps.
        """
        tall = self.spad.macro_pixel[0]
        first_row = block.first + block.inner.start
        rows = range(len(block.inner) // tall)
        random = {row: generator(self.seed, first_row + row * tall, _STAMPS) for row in rows}
        found = detections(self.spad, block, self.layout, self.seed, self.bin_s)
        for row, first_cycle, chunk, keys in found:
            pixel, cycle, bins = chunk.parts(keys)
            yield row, *self._read_out(random[row], pixel, first_cycle + cycle, bins)

    def _read_out(
        self, rng: Any, pixel: Any, cycle: Any, bins: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Convert detections to pixel, cycle and TDC code, by jitter and TDC."""
        # Jitter; free-running cycles follow each other
        if self.masses is not None:
            bins = bins + sample_jitter(rng, self.masses, bins.size)
            if self.layout.free:
                cycle = (cycle + bins // self.layout.bins) % self.layout.cycles
                bins %= self.layout.bins

        # Convert bins to codes. Stamps outside the codes are lost
        code = bins // self.merged
        if self.spad.tdc_dnl:
            code = np.searchsorted(self.edges, bins + rng.random(bins.size), side="right") - 1
        kept = (code >= 0) & (code < self.shape[2]) & (bins < self.layout.bins)
        return pixel[kept], cycle[kept], code[kept]

    def _bincount(self, pixel: np.ndarray, code: np.ndarray) -> np.ndarray:
        """Count the codes of each pixel, and return the histogram (x, code) of a row."""
        _, width, codes = self.shape
        return np.bincount(pixel * codes + code, minlength=width * codes).reshape(width, codes)

    def _with_hot_pixels(self, block: Block) -> Block:
        """Convert rates to double precision, and add the dark counts of hot pixels."""
        values = np.array(block.values, np.float64)
        for k in range(len(values)) if self.spad.hot_fraction else ():
            rng = generator(self.spad.device_seed, block.first + k, _HOT)
            hot = rng.random(values.shape[1]) < self.spad.hot_fraction
            values[k, hot] += self.spad.hot_rate_hz * self.bin_s
        return block._replace(values=values)
