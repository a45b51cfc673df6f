"""Histograms of photons with their time axis: as arrays, DataArrays or Datasets."""

from typing import Any

import numpy as np
import xarray as xr
from scipy import ndimage

from ..labels import COUNTS, PIXELS, bins_of, by_pixel, read, read_array
from ..runtime import checks
from .jitter import kernel
from .photon_rates import AXIS, at_least_0
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
    """Apply a function of arrays (..., bin); a DataArray keeps its axes and coordinates.

    The function gets the bins of a DataArray by rising path length.
    """
    if not isinstance(values, xr.DataArray):
        return function(values)
    time = bin_dimension(name, values)
    order = np.arange(values.sizes[time])
    if _has_places(values, time) and values.sizes[time] > 1:
        centers = _places(values, time)
        order = np.argsort(centers, kind="stable")
        bins_of(xr.DataArray(centers[order], {"opl": centers[order]}, "opl"), name)
    last = values.transpose(..., time)
    found = last.copy(data=function(last.values[..., order])[..., np.argsort(order)])
    return found.transpose(*values.dims)


class PhotonHistogram:
    """Counts of pixels in bins of a known place.

    Attributes:
        n: Counts (y, x, bin), at least 0.
        start: Start of the first bin [m].
        width: Width of the bins [m].
        pixels: Coordinates y and x of labeled counts.
        given: Labeled counts in the order in which a user has passed them; None for arrays.
    """

    def __init__(self, counts: Any, start_opl: Any, bin_width_opl: Any) -> None:
        self.pixels: dict[str, Any] = {}
        self.given: xr.Dataset | None = None
        axis = dict(zip(AXIS, (start_opl, bin_width_opl), strict=True))
        if isinstance(counts, xr.Dataset | xr.DataArray):
            for name, value in axis.items():
                checks.require(name, value, value is None, "None for labeled counts")
            self.given = _as_dataset(counts)
            found = read(self.given, COUNTS, "counts")
            bins = bins_of(found, "counts", "bin")
            self.start = bins.start_opl
            self.width = bins.bin_width_opl
            self.pixels = {name: found[name].values for name in ("y", "x")}
            counts = found["counts"].values
        else:
            self.start = checks.meters(AXIS[0], start_opl)
            self.width = checks.width(AXIS[1], bin_width_opl)
        self.n = at_least_0("counts", counts)
        whole = self.n.ndim == 3 and self.n.size > 0
        checks.shape("counts", self.n, whole, "(y, x, bin)")

    def of_pixels(self, name: str, values: Any) -> np.ndarray:
        """Return numbers of at least 0 for the pixels of these counts.

        Args:
            name: Name of the parameter, for messages.
            values: A number, or numbers (y, x). An array has the order of the rows and columns of
                the counts, as a user has passed them. A DataArray is found by its labels.
        """
        if isinstance(values, xr.DataArray) and not values.ndim:
            values = values.item()
        elif self.given is not None:
            values = by_pixel(values, self.given, name)
        elif isinstance(values, xr.DataArray):
            values = read_array(values, PIXELS, name).values
        known = at_least_0(name, values)
        pixels = self.n.shape[:2]
        checks.shape(name, known, known.shape in ((), pixels), f"a number or {pixels}")
        return known


def _as_dataset(labeled: xr.Dataset | xr.DataArray) -> xr.Dataset:
    """Return counts as they are in a result of `Spad.histogram`.

    Axes of records of data sets have a prefix. The attributes of a record describe the film, not
    the sensor. Therefore the width of its bins comes from the coordinate alone.
    """
    values: Any = labeled
    if isinstance(labeled, xr.Dataset):
        name = "counts" if "counts" in labeled else f"{SENSOR}counts"
        if name not in labeled:
            return labeled
        values = labeled[name]
        if not any(str(dim).startswith(SENSOR) for dim in values.dims):
            return labeled
    time = bin_dimension("counts", values)
    if not _has_places(values, time) or values.sizes[time] < 2:
        raise ValueError(
            "counts: the DataArray needs a coordinate opl with two bins or more. Pass its Dataset, "
            "or its values with start_opl and bin_width_opl"
        )
    centers = _places(values, time)
    names = {dim: str(dim).removeprefix(SENSOR) for dim in values.dims} | {time: "bin"}
    coordinates: dict[str, Any] = {
        names[dim]: values[dim].values for dim in values.dims if dim != time
    }
    coordinates["opl"] = ("bin", centers)
    dims = [names[dim] for dim in values.dims]
    width = float(np.ptp(centers)) / (centers.size - 1)
    return xr.Dataset({"counts": (dims, values.values)}, coordinates, {AXIS[1]: width})


def _has_places(values: xr.DataArray, time: str) -> bool:
    """Return whether a DataArray has a coordinate along its time axis."""
    return "opl" in values.coords or time in values.coords


def _places(values: xr.DataArray, time: str) -> np.ndarray:
    """Return the centers of the bins [m], from the coordinate of a DataArray."""
    name = "opl" if "opl" in values.coords else time
    return np.asarray(values[name].values, np.float64)


class _Centered:
    """A distribution that is shifted by `by` [m], so that its mean is in the bin around 0."""

    def __init__(self, whole: Any, width: float) -> None:
        self.whole = whole
        self.by = round(float(whole.mean()) / width) * width

    def cdf(self, opl: Any) -> Any:
        return self.whole.cdf(opl + self.by)

    def pdf(self, opl: Any) -> Any:
        return self.whole.pdf(opl + self.by)

    def ppf(self, part: Any) -> Any:
        return self.whole.ppf(part) - self.by


class Returns(PhotonHistogram):
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
