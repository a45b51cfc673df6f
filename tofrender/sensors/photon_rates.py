"""Expected photons per pixel, bin and laser cycle, the input of all sensor models."""

import os
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from ..labels import RATES, Bins, bins_of, read
from ..runtime import checks
from ..signals.units import SPEED_OF_LIGHT

DIMS = ("y", "x", "bin")
AXIS = ("start_opl", "bin_width_opl")


class Rates:
    """Rates `values` (y, x, bin) that a sensor receives for some cycles, in bins with `edges` [m].

    Args:
        rates: Rates as for `Spad.histogram`.
        cycles: Number of laser cycles.
        bin_width_opl: Width of the bins [m] if the rates are an array.
        most: Photons per pixel and cycle above which a warning is issued.
    """

    def __init__(self, rates: Any, cycles: Any, bin_width_opl: Any, most: float = np.inf) -> None:
        self.cycles = checks.integer("cycles", cycles, 1, (1 << 31) - 1)

        # Read labeled rates, or label an array
        if isinstance(rates, xr.Dataset | xr.DataArray):
            checks.require(AXIS[1], bin_width_opl, bin_width_opl is None, "None for a Dataset")
            rates = read(rates, RATES, "rates")
            bins = bins_of(rates, "rates", "bin")
        else:
            values = checks.real_array("rates", rates)
            checks.shape("rates", values, values.ndim == 3 and values.size, "(y, x, bin)")
            bins = Bins(0.0, checks.width(AXIS[1], bin_width_opl), values.shape[2])
            attrs = {AXIS[0]: bins.start_opl, AXIS[1]: bins.bin_width_opl}
            arrays = {"rate": (DIMS, values), "background": (DIMS[:2], 0.0 * values[..., 0])}
            rates = xr.Dataset(arrays, attrs=attrs)
        self.dataset = rates
        self.values = rates["rate"].data

        # Check the values, lazily if they are lazy
        if hasattr(self.values, "dask"):
            whole = self.values.rechunk({2: -1})
            self.values = whole.map_blocks(check, most, dtype=whole.dtype)
        else:
            check(self.values, most)
        self.width = bins.bin_width_opl
        self.edges = bins.edges_opl

    def bins_of(self, name: str, time_s: float) -> int:
        """Convert a time [s] to whole bins. The time must be shorter than the window."""
        window = self.values.shape[2] * self.width / SPEED_OF_LIGHT
        checks.require(name, time_s, time_s < window, f"shorter than the window, {window:g} s")
        return round(time_s * SPEED_OF_LIGHT / self.width)

    def result(
        self, name: str, dims: Any, values: Any, units: str, step: Any = (1, 1), **coords: Any
    ) -> xr.Dataset:
        """Create a Dataset of a sensor's measurements.

        The number of cycles is a variable, so that it is correct in a sum of two Datasets.

        Args:
            name: Name of the measured variable.
            dims: Its axes.
            values: Its values.
            units: Its units.
            step: Number of pixels of the rates (y, x) per pixel of the sensor.
            **coords: Further coordinates.
        """
        pixels = {name: self.dataset[name][::n] for name, n in zip("yx", step, strict=True)}
        attrs = self.dataset.attrs | dict(zip(AXIS, (self.edges[0], self.width), strict=True))
        attrs |= {"quantity": name, "units": units}
        cycles = ((), np.int64(self.cycles), {"units": "1", "long_name": "laser cycles"})
        arrays = {name: (dims, values, {"units": units}), "cycles": cycles}
        return xr.Dataset(arrays, pixels | coords, attrs)


def at_least_0(name: str, values: Any, dtype: Any = np.float64) -> np.ndarray:
    """Check that numbers are finite and at least 0, and return them as an array of a type."""
    values = checks.finite(name, checks.real_array(name, values, dtype))
    if values.min(initial=0) < 0:
        raise ValueError(f"{name} = {values.min():g}: must be at least 0")
    return values


def check(values: np.ndarray, most: float) -> np.ndarray:
    """Return rates. Raise a ValueError for wrong rates, and warn of more than `most` per pixel."""
    at_least_0("rates", values, None)
    found = 0.0 if most == np.inf else float(values.sum(axis=2).max(initial=0))
    if found > most:
        warnings.warn(
            f"rates: {found:.3g} photons per cycle in a pixel. Above {most:g}, a detector is blind "
            "after the first bins, and its counts contain little information. Reduce the light",
            stacklevel=4,
        )
    return values


def generator(seed: int, *key: int) -> np.random.Generator:
    """Return random numbers of a part of a film, independent of how the film is divided.

    Args:
        seed: Seed of the sensor.
        *key: Numbers of the part, e.g. its row.
    """
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=key)))


class Block(NamedTuple):
    """Rates of some rows of a film, `inner`, and of their neighbors, starting at row `first`."""

    values: Any
    first: int
    inner: range


def by_blocks(
    function: Callable[[Block], Any], values: Any, rows: int, halo: int, shape: Any, dtype: Any
) -> Any:
    """Apply a function to blocks of rows with a halo, in threads, or lazily.

    Args:
        function: Function of a `Block`.
        values: Rates (y, x, bin).
        rows: Number of rows in a block.
        halo: Number of neighboring rows on each side.
        shape: Shape of the result, None for a list.
        dtype: Type of the result.

    Returns:
        An array (y, ...), or a list of the results of the blocks.
    """
    # Divide the film
    parts = []
    for start in range(0, len(values), rows):
        low = max(0, start - halo)
        stop = min(len(values), start + rows)
        parts.append(Block(values[low : stop + halo], low, range(start - low, stop - low)))

    # Lazy rates
    if hasattr(values, "dask"):
        import dask.array as da
        from dask.delayed import delayed

        tasks = [delayed(lambda *part: function(Block(*part)))(*part) for part in parts]
        sizes = [(len(part.inner) * shape[0] // len(values), *shape[1:]) for part in parts]
        return da.concatenate(map(da.from_delayed, tasks, sizes, [dtype] * len(parts)))

    # Otherwise use threads, in which NumPy's generators run at the same time
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = list(pool.map(function, parts))
    return found if shape is None else np.concatenate(found)
