"""Histograms of photons with their time axis: as arrays, DataArrays or Datasets."""

from typing import Any

import numpy as np
import xarray as xr
from scipy import ndimage

from ..runtime import checks
from .jitter import kernel
from .rates import AXIS, DIMS, at_least_0, axis_of, axis_of_centers
from .response import distribution

BIN_DIMS = ("bin", "opl")
TAIL = 1e-3  # Part of the response at each end that no return includes
SENSOR = "sensor_"  # Prefix of the axes of a sensor in a record of a data set


def bin_dimension(name: str, values: xr.DataArray) -> str:
    """Return the name of the time axis of a DataArray, a parameter of this name."""
    found = [str(dim) for dim in values.dims if str(dim).removeprefix(SENSOR) in BIN_DIMS]
    if len(found) != 1:
        raise ValueError(
            f"{name} has the axes {tuple(values.dims)}. Pass a DataArray with one time axis, "
            "named bin or opl"
        )
    return found[0]


def along_bins(name: str, function: Any, values: Any) -> Any:
    """Apply a function of arrays (..., bin); a DataArray keeps its axes and coordinates."""
    if not isinstance(values, xr.DataArray):
        return function(values)
    last = values.transpose(..., bin_dimension(name, values))
    found = last.copy(data=function(last.values))
    return found.transpose(*values.dims)


class Histogram:
    """Counts of pixels in bins of a known place.

    Attributes:
        n: Counts (y, x, bin), at least 0.
        start: Start of the first bin [m].
        width: Width of the bins [m].
        pixels: Coordinates y and x of labelled data.
    """

    def __init__(self, counts: Any, start_opl: Any, bin_width_opl: Any) -> None:
        self.pixels: dict[str, Any] = {}
        axis = dict(zip(AXIS, (start_opl, bin_width_opl), strict=True))
        if isinstance(counts, xr.Dataset | xr.DataArray):
            counts, self.start, self.width = self._read(counts)
            for name, value in axis.items():
                checks.require(name, value, value is None, "None for labelled counts")
        else:
            self.start = checks.metres(AXIS[0], start_opl)
            self.width = checks.width(AXIS[1], bin_width_opl)
        self.n = at_least_0("counts", counts)
        whole = self.n.ndim == 3 and self.n.size > 0
        checks.shape("counts", self.n, whole, "(y, x, bin)")

    def _read(self, labelled: xr.Dataset | xr.DataArray) -> tuple[Any, float, float]:
        """Return the counts (y, x, bin), and start and width [m] of the bins."""
        if isinstance(labelled, xr.Dataset):
            whole = "counts" in labelled and set(AXIS) <= set(labelled.attrs)
            checks.require("counts", labelled, whole, "a Dataset of Spad.histogram")
            start, width = axis_of(labelled)
            values = labelled["counts"]
        else:
            values = labelled
            start, width = _axis_of_array(values)

        # Axes of records of data sets have a prefix
        time = bin_dimension("counts", values)
        plain = {dim: str(dim).removeprefix(SENSOR) for dim in values.dims} | {time: "bin"}
        right = sorted(plain.values()) == sorted(DIMS)
        checks.require("counts", values.dims, right, "a DataArray of (y, x, bin)")
        self.pixels = {
            axis: np.asarray(values[dim].values) for dim, axis in plain.items() if axis != "bin"
        }
        order = [next(dim for dim in plain if plain[dim] == axis) for axis in DIMS]
        return values.transpose(*order).values, start, width


def _axis_of_array(values: xr.DataArray) -> tuple[float, float]:
    """Return start and width of the bins [m] of a DataArray, from its coordinate."""
    time = bin_dimension("counts", values)
    name = "opl" if "opl" in values.coords else time
    if name not in values.coords or values.sizes[time] < 2:
        raise ValueError(
            "counts: the DataArray needs a coordinate opl with two bins or more. Pass its Dataset, "
            "or its values with start_opl and bin_width_opl"
        )
    return axis_of_centers(values[name].values)


class _Centered:
    """A distribution about the middle of the bin nearest to its mean, which is `by` [m] from 0."""

    def __init__(self, whole: Any, width: float) -> None:
        self.whole = whole
        self.by = round(float(whole.mean()) / width) * width

    def cdf(self, opl: Any) -> Any:
        return self.whole.cdf(opl + self.by)

    def pdf(self, opl: Any) -> Any:
        return self.whole.pdf(opl + self.by)

    def ppf(self, part: Any) -> Any:
        return self.whole.ppf(part) - self.by


class Returns(Histogram):
    """Histogram in which returns have a known response.

    Attributes:
        response: Distribution of the delays of a return [m], around 0.
        masses: Parts of a return in bins at the lags.
        lags: Lags [bins] from the middle of a return.
        start: Start of the first bin [m], less the delay of the response.
    """

    def __init__(self, counts: Any, response: Any, start_opl: Any, bin_width_opl: Any) -> None:
        super().__init__(counts, start_opl, bin_width_opl)
        self.response = _Centered(distribution("response", response), self.width)
        self.start -= self.response.by

        # The response must be shorter than the window
        bins = self.n.shape[2]
        low, high = self.response.ppf([TAIL, 1 - TAIL])
        allowed = f"shorter than {bins} bins"
        checks.require("response", response, high - low < bins * self.width, allowed)
        self.masses = kernel(self.response, self.width, TAIL)
        self.lags = np.arange(self.masses.size) - self.masses.size // 2
        checks.require("response", response, self.lags.size < bins, allowed)

    def correlate(self, weights: np.ndarray) -> np.ndarray:
        """Correlate the counts with weights at the lags."""
        return ndimage.correlate1d(self.n, weights, mode="constant")

    def split(self, peak: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the counts around peaks, the signal among them, and the background per bin."""
        inside = around(self.n, peak, self.lags)
        total = inside.sum(axis=-1)
        background = (self.n.sum(axis=-1) - total) / (self.n.shape[2] - self.lags.size)
        return inside, np.maximum(total - background * self.lags.size, 0), background


def around(values: np.ndarray, peak: Any, lags: np.ndarray) -> np.ndarray:
    """Return values (..., lag) of (..., bin) at these lags from each peak, 0 beyond the window."""
    at = np.asarray(peak)[..., None] + lags
    inside = (at >= 0) & (at < values.shape[-1])
    return np.take_along_axis(values, np.where(inside, at, 0), axis=-1) * inside
