"""Arrays of single-photon avalanche diodes (SPAD): time stamps and histograms of photons."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import RATES
from ..runtime import checks
from .rates import Rates, by_blocks
from .readout import Readout
from .spad_parameters import SpadParameters

MAX_RATE = 50.0  # Photons per pixel and cycle


@dataclass(frozen=True, kw_only=True)
class Spad(SpadParameters):
    """SPAD array with time-correlated single-photon counting (TCSPC).

    The chain is: photons (Poisson; the detection efficiency is part of the rates) -> detection with
    dead time, of afterpulses and crosstalk, too -> macro pixels -> jitter -> time-to-digital
    converter (TDC). Time is resolved to the bins of the rates: a dead time covers whole bins, and
    with one a bin detects at most once per cycle. Afterpulses cause further ones; crosstalk goes to
    one of four neighbours and causes no more, which is right to first order in its probability.
    An avalanche causes an afterpulse only if it is detected.

    Args:
        mode: "first_photon": armed when a cycle starts, for one detection; "multi_hit": armed when
            a cycle starts, and again after the dead time; "free_running": the dead time goes on
            into the next cycle, which starts where the window ends.
        dead_time_s: Dead time [s], shorter than the window; 0 for none, and for "first_photon".
        paralysable: Whether photons within the dead time prolong it.
        afterpulse_probability: Probability of an afterpulse after the dead time, up to 0.9.
        afterpulse_time_s: Mean time from the end of the dead time to the afterpulse [s].
        crosstalk_probability: Probability of an avalanche in a neighbour, at once, up to 0.9.
        jitter: A `Response` or pulse that delays time stamps, None for none.
        tdc_bits: The TDC has 2^bits codes; later stamps are lost. None for as many as fit.
        tdc_lsb_s: Width of a code [s], a whole number of bins; None for one bin.
        tdc_dnl: Differential nonlinearity: standard deviation of the codes' widths, in codes.
        macro_pixel: (rows, columns) of SPADs that share a TDC; must divide the film.
        coincidence: Avalanches of a macro pixel that make a detection.
        coincidence_window_s: Time within which they must lie [s]; 0 for the same bin.
        hot_fraction: Part of the pixels that are hot, up to 0.9.
        hot_rate_hz: Dark counts of hot pixels beyond those of others [1/s].
        device_seed: Chooses hot pixels and widths of codes.

    Raises:
        ValueError: A value out of range, or a parameter that nothing depends on.

    Example:
        >>> rates = np.full((2, 3, 50), 0.02)  # Photons per bin and cycle
        >>> counts = Spad().histogram(rates, 10_000, seed=1, bin_width_opl=0.02)["counts"]
        >>> counts.dims, counts.dtype, bool(counts.sum("bin").max() < 10_000)
        (('y', 'x', 'bin'), dtype('int64'), True)
    """

    def histogram(
        self,
        rates: Annotated[Any, RATES],
        cycles: int,
        seed: int = 0,
        *,
        bin_width_opl: float | None = None,
    ) -> xr.Dataset:
        """Simulate histograms of time stamps.

        Cycles that start armed, without paralysis, afterpulses, crosstalk and macro pixels, are
        drawn from the exact distribution of their counts, at a cost that hardly depends on
        `cycles`; all else photon by photon. Rows have their own random numbers: chunks of the film
        change nothing. Photons are simulated in chunks of cycles, with about 150 MB per thread.
        More photons per cycle than the model is meant for make a warning.

        Args:
            rates: A Dataset of `expected_photons`, or photons per pixel, bin and cycle, at least 0,
                as an array (y, x, bin) that starts at the path length 0. If lazy (Dask), the result
                is, too.
            cycles: Laser cycles, at least 1.
            seed: Seed of the random numbers.
            bin_width_opl: Width of the bins [m], for an array.

        Returns:
            A Dataset with `counts` (y, x, bin), int64, so that sums of counts do not overflow, and
            `cycles`;
            nominal centres of the codes as the coordinate opl [m].

        Raises:
            ValueError: Wrong rates, or a dead time, TDC or macro pixels that do not fit them.
        """
        readout = Readout(self, Rates(rates, cycles, bin_width_opl, MAX_RATE), seed)
        return self._counts(readout, readout.histogram, np.int64)

    def expected(
        self,
        rates: Annotated[Any, RATES],
        cycles: int = 1,
        *,
        bin_width_opl: Any = None,
    ) -> xr.Dataset:
        """Compute the expectation of `histogram`, float64; for "free_running" the stationary one.

        Afterpulses, crosstalk and macro pixels have no closed form and are refused.
        """
        for name, value in self.interactions().items():
            checks.require(name, value, False, "left out for expected")
        readout = Readout(self, Rates(rates, cycles, bin_width_opl, MAX_RATE))
        return self._counts(readout, readout.expected, np.float64)

    def interactions(self) -> dict[str, Any]:
        """Parameters that are in use, and for which `expected` has no closed form."""
        names = "afterpulse_probability", "crosstalk_probability", "macro_pixel"
        given = {name: getattr(self, name) for name in names}
        return {name: value for name, value in given.items() if value not in (0, (1, 1))}

    def photons(
        self,
        rates: Annotated[Any, RATES],
        cycles: int,
        seed: int = 0,
        *,
        bin_width_opl: float | None = None,
    ) -> xr.Dataset:
        """Simulate a table of time stamps, sorted by row, pixel and time of detection.

        Arguments and errors are as for `histogram`; lazy rates are computed. A photon takes about
        100 bytes.

        Returns:
            A Dataset along "photon": row `y` and column `x` from 0, `cycle`, TDC code `bin`, and
            the code's nominal centre `opl` [m].

        Example:
            >>> table = Spad().photons(np.full((1, 1, 4), 0.1), 1000, bin_width_opl=0.1)
            >>> sorted(table.data_vars), bool(table["cycle"].to_index().is_unique)
            (['bin', 'cycle', 'opl', 'x', 'y'], True)
        """
        readout = Readout(self, Rates(rates, cycles, bin_width_opl, MAX_RATE), seed)
        values = np.asarray(readout.rates.values)
        parts = by_blocks(readout.table, values, *readout.rows, None, None)
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        columns.append(readout.centres[columns[3]])
        named = zip(("y", "x", "cycle", "bin", "opl"), columns, strict=True)
        attrs = readout.rates.result("photons", (), 0, "1").attrs | readout.attrs
        attrs["cycles"] = cycles
        return xr.Dataset({name: ("photon", column) for name, column in named}, attrs=attrs)

    def _counts(self, readout: Readout, function: Any, dtype: Any) -> xr.Dataset:
        values, shape = readout.rates.values, readout.shape

        def counted(block: Any) -> np.ndarray:
            found, cycles = function(block), readout.rates.cycles
            fits = dtype is np.float64 or found.max(initial=0) < 1 << 32
            checks.require("cycles", cycles, fits, "fewer, for counts of a bin below 2^32")
            return found.astype(dtype)

        counts = by_blocks(counted, values, *readout.rows, shape, dtype)
        given = ("counts", ("y", "x", "bin"), counts, "1", self.macro_pixel)
        found = readout.rates.result(*given, opl=("bin", readout.centres, {"units": "m"}))
        return found.assign_attrs(readout.attrs)
