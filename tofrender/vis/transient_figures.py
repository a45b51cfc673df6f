"""A transient image with its time axis and first pixel, and axes for figures of it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ..labels import LIGHT, TRANSIENT, bins_of, intensity, read, read_array, require_consecutive
from ..rendering.cubes import Cube, Place
from ..rendering.dataset import DIMS, QUANTITIES
from ..runtime import checks, plots
from ..signals.color import luminance
from ..signals.units import ns_to_opl, opl_to_ns

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass
class Transient:
    """A transient image with its time axis and the index of its first pixel."""

    values: Cube
    """Light (height, width, bins, channels), with 1 or 3 channels."""
    start_opl: float
    bin_width_opl: float
    x0: int = 0
    y0: int = 0
    quantity: str = "radiance per bin"

    def __post_init__(self) -> None:
        """Raise a ValueError if a value has a wrong type, shape or range."""
        self.values = _cube("values", self.values)
        self.start_opl = checks.meters("start_opl", self.start_opl)
        self.bin_width_opl = checks.meters("bin_width_opl", self.bin_width_opl, positive=True)
        for name in ("x0", "y0"):
            checks.integer(name, getattr(self, name), -checks.MAX_SIZE, checks.MAX_SIZE)
        checks.instance("quantity", self.quantity, str, "text")

    @classmethod
    def of(
        cls,
        data: Any,
        start_opl: float | None = None,
        bin_width_opl: float | None = None,
        quantity: str | None = None,
    ):
        """Read a result of `render`, or an array with its time axis. Stokes vectors become S0."""
        first = (0, 0)
        if quantity is not None:
            checks.one_of("quantity", quantity, QUANTITIES)
        if isinstance(data, xr.Dataset):
            film = read_light(data)
            width = bins_of(film, "data").bin_width_opl
            start = float(film["opl"].values[0] - width / 2)
            start_opl = start if start_opl is None else start_opl
            bin_width_opl = width if bin_width_opl is None else bin_width_opl
            first = int(film["x"][0]), int(film["y"][0])
            quantity = quantity or f"{film.attrs['quantity']} [{typeset(film.attrs['units'])}]"
            data = film["transient"]
        elif isinstance(data, xr.DataArray) and set(data.dims) == set(DIMS["transient"]):
            data = read_array(data, LIGHT, "data")
        rest: Any = start_opl, bin_width_opl, *first, quantity or cls.quantity
        return cls(_cube("data", data), *rest)

    @property
    def bins(self) -> int:
        """Number of bins."""
        return self.values.shape[2]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width."""
        return self.values.shape[0], self.values.shape[1]

    @property
    def opl(self) -> np.ndarray:
        """Bin centers [m]."""
        return self.start_opl + (np.arange(self.bins) + 0.5) * self.bin_width_opl

    def label(self, index: int) -> str:
        """Format time and path length at the center of a bin, with digits that distinguish bins."""
        opl = float(self.opl[index])
        width = self.bin_width_opl
        in_ns, in_m = (max(2, 1 - math.floor(math.log10(w))) for w in (opl_to_ns(width), width))
        return f"t = {opl_to_ns(opl):.{in_ns}f} ns   OPL = {opl:.{in_m}f} m"

    def pixel(self, x: Any, y: Any) -> np.ndarray:
        """Return the response (bins, channels) of the pixel (x, y)."""
        height, width = self.size
        column = checks.integer("x", x, self.x0, self.x0 + width - 1) - self.x0
        row = checks.integer("y", y, self.y0, self.y0 + height - 1) - self.y0
        return self.values.read((row, column))

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge in pixels, for `imshow`."""
        height, width = self.size
        return (self.x0 - 0.5, self.x0 + width - 0.5, self.y0 + height - 0.5, self.y0 - 0.5)

    def lights(self) -> Iterator[tuple[Place, np.ndarray]]:
        """Yield pieces of the luminance (rows, columns, bins), with their slices.

        Values that are negative or not finite are 0.
        """
        for slices, values in self.values.pieces():
            light = luminance(values)
            lit = np.isfinite(light) & (light > 0)
            yield slices[:3], np.where(lit, light, np.float32(0))

    def brightest(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the sum of the light over bins, and the time of the brightest bin [ns].

        The time is the center of the bin. Without light, the time is NaN.
        """
        energy = np.zeros(self.size)
        most = np.zeros(self.size)
        peak_ns = np.full(self.size, np.nan)
        centers = opl_to_ns(self.opl)
        for (*pixels, bins), light in self.lights():
            here = tuple(pixels)
            energy[here] += light.sum(axis=2)

            # Is a bin of this piece brighter than all earlier bins?
            brightest = light.argmax(axis=2)
            value = np.take_along_axis(light, brightest[..., None], axis=2)[..., 0]
            more = value > most[here]
            most[here][more] = value[more]
            peak_ns[here][more] = centers[bins][brightest[more]]
        return energy, peak_ns

    def sums(self, *waves: np.ndarray) -> list[np.ndarray]:
        """Return sums over bins (height, width) of the light, and of its product with each wave."""
        types = [np.result_type(wave, np.float64) for wave in (np.float64(0), *waves)]
        sums = [np.zeros(self.size, dtype) for dtype in types]
        for (*pixels, bins), light in self.lights():
            sums[0][tuple(pixels)] += light.sum(axis=2)
            for total, wave in zip(sums[1:], waves, strict=True):
                total[tuple(pixels)] += light @ wave[bins]
        return sums


def typeset(units: str) -> str:
    """Write the exponents of units as superscripts.

    Example:
        >>> typeset("W m^-2 sr^-1")
        'W m⁻² sr⁻¹'
    """
    return re.sub(r"\^(-?\d+)", lambda found: plots.superscript(int(found[1])), units)


def _cube(name: str, data: Any) -> Cube:
    """Return real numbers as a cube (height, width, bins, channels)."""
    given = Cube.of(name, data)
    cube = given.view((..., None)) if len(given.shape) == 3 else given
    valid = len(cube.shape) == 4 and cube.shape[3] in (1, 3) and 0 not in cube.shape
    one = "(height, width, bins)"
    allowed = f"{one} or {one[:-1]}, channels) with 1 or 3 channels last"
    checks.shape(name, given, valid, allowed)
    return cube


def read_light(data: Any) -> xr.Dataset:
    """Read the parameter `data` of a figure, a film without gaps. Return S0 of Stokes vectors."""
    film = intensity(read(data, TRANSIENT, "data"), "data")
    require_consecutive(film, "data")
    for name in ("quantity", "units"):
        checks.instance(f"data: attribute {name}", film.attrs.get(name), str, "text")
    return film


def pixel_axes(axes: Axes) -> None:
    """Label both axes in whole pixels."""
    axes.set_xlabel("x [pixel]")
    axes.set_ylabel("y [pixel]")
    plots.few_ticks(axes, integer=True)


def map_axes(axes: Axes, values: Any, **options: Any) -> Any:
    """Draw values (height, width) with `imshow`, hatch NaN, and return the image."""
    axes.patch.set(**plots.HATCH, linewidth=0)
    pixel_axes(axes)
    return axes.imshow(values, interpolation="nearest", **options)


def time_axes(axes: Axes, sequence: Transient) -> None:
    """Label time below, path length above and the quantity on the left, after drawing."""
    # Quantity, with a factor for large and small numbers
    axes.set_xlabel("time [ns]")
    factor, formatter = plots.tick_scale(max(map(abs, axes.get_ylim())))
    axes.yaxis.set_major_formatter(formatter)
    quantity = plots.label_with_factor(sequence.quantity, factor)
    figure: Any = axes.get_figure(root=True)
    narrow = figure.get_figwidth() < plots.COLUMN
    axes.set_ylabel(quantity.replace(" [", "\n[") if narrow else quantity)
    axes.set_xlim(opl_to_ns(sequence.opl[0]), opl_to_ns(sequence.opl[-1]) + 1e-9)
    axes.grid(alpha=0.3)
    axes.locator_params(axis="x", nbins=7)

    # Path length
    above = axes.secondary_xaxis("top", functions=(ns_to_opl, opl_to_ns))
    above.set_xlabel("optical path length [m]")


def picture_aspect(height: float, width: float, low: float, high: float) -> float:
    """Return height over width, clamped to [low, high] so that a figure is readable."""
    return min(high, max(low, height / width))


def explain_hatch(figure: Figure, mask: np.ndarray, dark: bool = False) -> None:
    """Explain the hatch of pixels below a figure. The hatch of `tonemap` is dark."""
    if mask.any():
        handle = plots.hatch_patch("not finished" if dark else plots.NO_VALUE, dark)
        figure.legend(handles=[handle], loc="outside lower center", frameon=False)
