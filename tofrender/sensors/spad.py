"""Arrays of single-photon avalanche diodes (SPAD): time stamps and histograms of photons."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import RATES
from ..runtime import checks
from .photon_rates import Rates, by_blocks
from .readout import Readout
from .spad_parameters import SpadParameters

# Photons per pixel and cycle above which a warning is issued
MAX_RATE = 50.0


@dataclass(frozen=True, kw_only=True)
class Spad(SpadParameters):
    """SPAD array with time-correlated single-photon counting (TCSPC).

    The stages are: photons (Poisson distributed; the detection efficiency is part of the rates),
    detection with dead time, also of afterpulses and crosstalk, macro pixels, jitter, and the
    time-to-digital converter (TDC). Times are resolved to the bins of the rates. A dead time covers
    whole bins. With a dead time, a bin detects at most once per cycle. Afterpulses cause further
    afterpulses. Crosstalk reaches one of four neighbors and causes no further crosstalk, which is
    correct to first order in its probability. Only detected avalanches cause afterpulses.

    Args:
        mode: "first_photon": armed at the start of a cycle, for one detection. "multi_hit": armed
            at the start of a cycle, and again after the dead time. "free_running": the dead time
            continues in the next cycle, which starts where the window ends.
        dead_time_s: Dead time [s], shorter than the window. Not allowed for "first_photon".
        paralysable: Whether photons within the dead time prolong it.
        afterpulse_probability: Probability of an afterpulse after the dead time, up to 0.9.
        afterpulse_time_s: Mean time from the end of the dead time to the afterpulse [s].
        crosstalk_probability: Probability of a simultaneous avalanche in a neighbor, up to 0.9.
        jitter: A `Response` or pulse that delays time stamps, None without jitter.
        tdc_bits: The TDC has 2^bits codes, and later stamps are lost. None for as many codes as the
            window contains.
        tdc_lsb_s: Width of a code [s], a whole number of bins. None for one bin.
        tdc_dnl: Differential nonlinearity: standard deviation of the codes' widths, in codes.
        macro_pixel: (rows, columns) of SPADs that share a TDC. They must divide the film.
        coincidence: Number of avalanches in a macro pixel that are required for a detection.
        coincidence_window_s: Time within which they must occur [s], 0 for the same bin.
        hot_fraction: Fraction of hot pixels, up to 0.9.
        hot_rate_hz: Additional dark counts of hot pixels [1/s].
        device_seed: Seed of hot pixels and of the widths of codes.

    Raises:
        ValueError: A value is out of range, or a parameter has no effect.
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

        Two methods exist. Counts are sampled from their exact distribution, if the detector is
        armed at the start of each cycle and has no paralysis, afterpulses, crosstalk or macro
        pixels. The cost of this method hardly depends on `cycles`. Otherwise photons are simulated
        one by one, in chunks of cycles, with about 150 MB per thread. Each row has its own random
        numbers, so that the result does not depend on chunks of the film. Too many photons per
        cycle cause a warning.

        Args:
            rates: A Dataset of `expected_photons`, or an array (y, x, bin) of photons per pixel,
                bin and cycle, at least 0, that starts at the path length 0. If the rates are lazy
                (Dask), the result is lazy, too.
            cycles: Laser cycles, at least 1.
            seed: Seed of the random numbers.
            bin_width_opl: Width of the bins [m], for an array.

        Returns:
            A Dataset with `counts` (y, x, bin), `cycles`, and the nominal centers of the codes as
            the coordinate opl [m]. Counts are int64, so that sums of counts do not overflow.

        Raises:
            ValueError: The rates are invalid, or their bins and pixels are not compatible with the
                dead time, the TDC or the macro pixels.
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
        """Compute the expectation of `histogram`, float64.

        In mode "free_running", it is the expectation of the stationary state. Afterpulses,
        crosstalk and macro pixels do not have a closed form and are refused.
        """
        for name, value in self.interactions().items():
            checks.require(name, value, False, "left out for expected")
        readout = Readout(self, Rates(rates, cycles, bin_width_opl, MAX_RATE))
        return self._counts(readout, readout.expected, np.float64)

    def interactions(self) -> dict[str, Any]:
        """Return the parameters in use for which `expected` has no closed form."""
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

        Arguments and errors are as for `histogram`. Lazy rates are computed. A photon needs about
        100 bytes.

        Returns:
            A Dataset along "photon": row `y` and column `x` from 0, `cycle`, TDC code `bin`, and
            the nominal center of the code `opl` [m].

        Example:
            >>> table = Spad().photons(np.full((1, 1, 4), 0.1), 1000, bin_width_opl=0.1)
            >>> sorted(table.data_vars), bool(table["cycle"].to_index().is_unique)
            (['bin', 'cycle', 'opl', 'x', 'y'], True)
        """
        # Simulate the columns
        readout = Readout(self, Rates(rates, cycles, bin_width_opl, MAX_RATE), seed)
        values = np.asarray(readout.rates.values)
        parts = by_blocks(readout.table, values, *readout.rows, None, None)
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        columns.append(readout.centers[columns[3]])

        # Describe the result
        named = zip(("y", "x", "cycle", "bin", "opl"), columns, strict=True)
        attrs = readout.rates.result("photons", (), 0, "1").attrs | readout.attrs
        attrs["cycles"] = cycles
        return xr.Dataset({name: ("photon", column) for name, column in named}, attrs=attrs)

    def _counts(self, readout: Readout, function: Any, dtype: Any) -> xr.Dataset:
        """Apply a function of the readout to all blocks, and describe its counts."""
        values = readout.rates.values
        shape = readout.shape

        def counted(block: Any) -> np.ndarray:
            found = function(block)
            cycles = readout.rates.cycles
            fits = dtype is np.float64 or found.max(initial=0) < 1 << 32
            checks.require("cycles", cycles, fits, "fewer, for counts of a bin below 2^32")
            return found.astype(dtype)

        counts = by_blocks(counted, values, *readout.rows, shape, dtype)
        found = readout.rates.result(
            "counts",
            ("y", "x", "bin"),
            counts,
            "1",
            self.macro_pixel,
            opl=("bin", readout.centers, {"units": "m"}),
        )
        return found.assign_attrs(readout.attrs)
