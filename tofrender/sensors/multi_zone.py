"""Multi-zone time-of-flight sensors: zones of the field of view, each with one histogram.

The chips of this kind (TMF8820, VL53L5CX and others) have a laser and an array of single-photon
avalanche diodes behind one lens. Groups of diodes are zones, and the chip counts the photons of a
zone in bins of time.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import xarray as xr
from scipy.special import ndtr

from ..labels import POSES, intensity, read, require_consecutive
from ..runtime import checks
from ..runtime.tables import known_keys, read_toml, table
from ..signals.pulses import KnotPulse, SampledPulse
from .photon_rates import generator

FOLDER = Path(__file__).parent / "presets"
MULTI_ZONE_PRESETS = ("tmf8820",)
MOST_ZONES = 4096


@dataclass(frozen=True, eq=False)
class MultiZone:
    """Sensor with several zones and one photon histogram for each.

    A pixel of a render with the radiance L_f in the bin f, at the path length c_f, and with the
    tangents (x, y) of its direction, gives zone z the signal

        S_z(f) = sum over pixels of L_f cos^4 times the integral of w_z over the pixel,
        w_z(x, y) = e((x - x_z) / W) e((y - y_z) / H),

    where e is 1 inside the zone's rectangle and 0 outside, blurred by a Gaussian. Optical crosstalk
    spreads a fraction of all signals over all zones, and the expected counts of bin k are

        n_z(k) = floor_z + gain_z sum over f of [C(b_{k+1} - c_f) - C(b_k - c_f)] T_z(f),
        T_z(f) = S_z(f) + crosstalk sum over y of S_y(f),     b_k = start_z + k width,

    with the cumulative distribution C of the pulse. The light is integrated over a bin once.

    Args:
        centers: Centers of the zones, tangents (x / z, y / z) in the sensor's frame, (zones, 2).
        sizes: Widths and heights of the zones, differences of tangents, (zones, 2).
        gains: Counts per unit of signal of each zone [1 / (W m^-2)], (zones,), above 0.
        starts_opl: Path length at which bin 0 of each zone starts [m], (zones,).
        floors: Counts of each zone in each bin without light, (zones,), at least 0.
        pulse: Pulse of the laser and response of the detector together: a `SampledPulse` as
            measured, or a `KnotPulse`.
        bins: Number of time bins.
        bin_width_opl: Width of a bin, path length [m].
        blur: Standard deviation of the blurred edges of zones [tangent], 0 for sharp edges.
        shift: Shift of all zones [tangents].
        scale: Scale of all zones about the sensor's axis, before the shift, each above 0.
        crosstalk: Fraction of the sum of all signals that each zone receives, 0 to 1.

    Example:
        >>> sensor = MultiZone.preset("tmf8820")
        >>> sensor.centers.shape, sensor.bins
        ((9, 2), 128)
    """

    centers: np.ndarray
    sizes: np.ndarray
    gains: np.ndarray
    starts_opl: np.ndarray
    floors: np.ndarray
    pulse: SampledPulse
    bins: int
    bin_width_opl: float
    blur: float = 0.0
    shift: np.ndarray | tuple[float, float] = (0.0, 0.0)
    scale: np.ndarray | tuple[float, float] = (1.0, 1.0)
    crosstalk: float = 0.0

    def __post_init__(self) -> None:
        # Check the arrays
        centers = checks.real_array("centers", self.centers, np.float64)
        is_list = centers.ndim == 2 and 1 <= len(centers) <= MOST_ZONES
        checks.shape("centers", centers, is_list, f"(zones, 2), with 1 to {MOST_ZONES} zones")
        zones = len(centers)
        shapes: dict[str, tuple[int, ...]] = {"centers": (zones, 2), "sizes": (zones, 2)}
        shapes |= dict.fromkeys(("gains", "starts_opl", "floors"), (zones,))
        shapes |= {"shift": (2,), "scale": (2,)}
        for name, shape in shapes.items():
            array = checks.real_array(name, getattr(self, name), np.float64)
            array = checks.finite(name, array)
            checks.shape(name, array, array.shape == shape, str(shape))
            object.__setattr__(self, name, array)

        # Check the ranges
        for name in ("sizes", "gains", "scale"):
            array = getattr(self, name)
            checks.require(name, float(array.min()), array.min() > 0, "above 0")
        checks.require("floors", float(self.floors.min()), self.floors.min() >= 0, "0 or more")
        checks.instance("pulse", self.pulse, SampledPulse, "a SampledPulse or a KnotPulse")
        object.__setattr__(self, "bins", checks.integer("bins", self.bins, 1, checks.MAX_BINS))
        width = checks.width("bin_width_opl", self.bin_width_opl)
        object.__setattr__(self, "bin_width_opl", width)
        object.__setattr__(self, "blur", checks.number("blur", self.blur, low=0, high=1))
        crosstalk = checks.number("crosstalk", self.crosstalk, low=0, high=1)
        object.__setattr__(self, "crosstalk", crosstalk)

    @classmethod
    def preset(cls, name: str) -> MultiZone:
        """Return a sensor of the package, "tmf8820"."""
        checks.one_of("name", name, MULTI_ZONE_PRESETS)
        return cls.from_file(FOLDER / f"{name}.toml")

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> MultiZone:
        """Read a sensor from a TOML file. Its keys are the arguments of the class.

        `pulse` is a table with `opl` and `values` of a `KnotPulse`, or with `values`, `start_opl`
        and `bin_width_opl` of a `SampledPulse`.
        """
        # Check the keys of the sensor
        given = table("sensor", read_toml("path", path)[0])
        names = [each.name for each in fields(cls)]
        known_keys("sensor", given, names)
        for name in names[:8]:
            if name not in given:
                raise ValueError(f"path = {path}: sensor.{name} is missing")

        # Check the keys of the pulse
        pulse = table("sensor.pulse", given.pop("pulse"))
        is_knots = "opl" in pulse
        needed = ("opl", "values") if is_knots else ("values", "start_opl", "bin_width_opl")
        known_keys("sensor.pulse", pulse, needed)
        for name in needed:
            if name not in pulse:
                raise ValueError(f"path = {path}: sensor.pulse.{name} is missing")
        made = KnotPulse(**pulse) if is_knots else SampledPulse(**pulse)
        return cls(pulse=made, **given)

    def expected(self, renders: Annotated[xr.Dataset, POSES]) -> xr.Dataset:
        """Return the expected counts of all zones and bins.

        Args:
            renders: A Dataset of `render_poses` with a perspective camera, "radiance per bin", and
                without a pulse. Channels are averaged. Its bins should be at most a quarter as wide
                as the sensor's bins, because light counts at the centers of bins.

        Returns:
            A Dataset with `counts (pose, zone, bin)`.

        Raises:
            ValueError: The argument is not such a Dataset.
        """
        light = Light.of(renders)
        signal = self.crossed(np.einsum("zyx,pyxf->pzf", self.weights(light), light.radiance))
        counts = self.binned(self.responses(light.opl), signal)
        return self._labeled(counts, renders)

    def measure(self, renders: Annotated[xr.Dataset, POSES], seed: int = 0) -> xr.Dataset:
        """Return counts with photon noise, see `expected` for the argument and the result."""
        found = self.expected(renders)
        drawn = generator(seed).poisson(found["counts"].values)
        return found.assign(counts=found["counts"].copy(data=drawn)).assign_attrs(seed=seed)

    def weights(self, light: Light) -> np.ndarray:
        """Return the weights of pixels in each zone, (zones, y, x)."""
        low = self.scale * (self.centers - self.sizes / 2) + self.shift
        high = self.scale * (self.centers + self.sizes / 2) + self.shift
        across = _overlaps(light.edges_x, low[:, 0], high[:, 0], self.blur)
        down = _overlaps(light.edges_y, low[:, 1], high[:, 1], self.blur)
        return across[:, None, :] * down[:, :, None] * light.cos4

    def crossed(self, signal: np.ndarray) -> np.ndarray:
        """Add optical crosstalk to signals of zones, (poses, zones, ...)."""
        return signal + self.crosstalk * signal.sum(axis=1, keepdims=True)

    def responses(self, opl: np.ndarray) -> np.ndarray:
        """Return the fraction of light of a path length [m] in each bin, (zones, bins, opl)."""
        steps = self.bin_width_opl * np.arange(self.bins + 1)
        edges = self.starts_opl[:, None] + steps
        offsets = edges[:, :, None] - opl
        return np.diff(_cumulative(self.pulse, offsets), axis=1)

    def binned(self, responses: np.ndarray, signal: np.ndarray) -> np.ndarray:
        """Return counts (poses, zones, bins) of signals (poses, zones, opl)."""
        # Batches of products of matrices are much faster than a general sum over indices
        by_zone = np.ascontiguousarray(signal.transpose(1, 2, 0))
        light = np.matmul(responses, by_zone).transpose(2, 0, 1)
        return self.floors[:, None] + self.gains[:, None] * light

    def _labeled(self, counts: np.ndarray, renders: xr.Dataset) -> xr.Dataset:
        """Create a Dataset of counts (pose, zone, bin)."""
        coords = {name: renders[name] for name in ("pose",) if name in renders.coords}
        attrs = {"quantity": "counts", "units": "1", "bin_width_opl": self.bin_width_opl}
        attrs |= {"scene": renders.attrs.get("scene", "")}
        return xr.Dataset({"counts": (("pose", "zone", "bin"), counts)}, coords, attrs)


@dataclass(frozen=True, eq=False)
class Light:
    """Light of renders as a multi-zone sensor needs it, read from a Dataset of `render_poses`."""

    # Radiance (poses, y, x, opl) [W m^-2 sr^-1]
    radiance: np.ndarray

    # Centers of the bins [m]
    opl: np.ndarray

    # Tangents of the pixels' edges, (width + 1,) and (height + 1,)
    edges_x: np.ndarray
    edges_y: np.ndarray

    # cos^4 of the angle between the pixels' centers and the axis, (y, x)
    cos4: np.ndarray

    @classmethod
    def of(cls, renders: Any) -> Light:
        """Check a Dataset and read its light."""
        renders = read(renders, POSES, "renders")
        require_consecutive(renders, "renders")
        if not {"tan_x", "tan_y"} <= set(renders.variables):
            raise ValueError(
                "renders: expected a Dataset of render_poses with a perspective camera, which has "
                "the coordinates tan_x and tan_y"
            )
        quantity = renders.attrs.get("quantity")
        checks.require("quantity", quantity, quantity == "radiance per bin", "radiance per bin")
        pulse = renders.attrs.get("pulse", "none")
        if pulse != "none":
            raise ValueError(
                f"renders have the pulse {pulse}. Render without a pulse, the sensor has its own"
            )

        # Average channels of the intensity
        film = intensity(renders["transient"], "renders").mean("channel", dtype=np.float64)

        # Geometry of the pixels
        tan_x = renders["tan_x"].values
        tan_y = renders["tan_y"].values
        cos4 = 1 / (1 + tan_x**2 + tan_y[:, None] ** 2) ** 2
        opl = np.asarray(renders["opl"].values, np.float64)
        return cls(
            radiance=np.ascontiguousarray(film.values),
            opl=opl,
            edges_x=_edges("x", tan_x),
            edges_y=_edges("y", tan_y),
            cos4=cos4,
        )


def _edges(axis: str, centers: np.ndarray) -> np.ndarray:
    """Return the edges of pixels from their evenly spaced centers."""
    checks.shape(f"tan_{axis}", centers, centers.size > 1, "of 2 pixels or more")
    step = (centers[-1] - centers[0]) / (centers.size - 1)
    return centers[0] + step * (np.arange(centers.size + 1) - 0.5)


def _overlaps(edges: np.ndarray, low: np.ndarray, high: np.ndarray, blur: float) -> np.ndarray:
    """Integrate blurred boxes from `low` to `high` over pixels; returns (zones, pixels)."""
    rising = _ramp(edges - low[:, None], blur)
    falling = _ramp(edges - high[:, None], blur)
    return np.abs(np.diff(rising - falling, axis=1))


def _ramp(x: np.ndarray, blur: float) -> np.ndarray:
    """Integrate a step at 0 that is blurred by a Gaussian; without blur this is max(x, 0)."""
    if blur == 0:
        return np.maximum(x, 0.0)
    z = x / blur
    density = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    return x * ndtr(z) + blur * density


def _cumulative(pulse: SampledPulse, offsets: np.ndarray) -> np.ndarray:
    """Return the cumulative distribution of a pulse in double precision."""
    edges = pulse.start_opl + pulse.bin_width_opl * np.arange(pulse.density.size + 1)
    mass = np.concatenate([[0.0], np.cumsum(pulse.density * pulse.bin_width_opl)])
    return np.interp(offsets, edges, mass / mass[-1])
