"""Gated cameras and streak cameras with noise. Parameters out of range raise a ValueError."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import xarray as xr
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.special import erf

from ..analysis.rebinning import sums_between
from ..labels import RATES, require_consecutive
from ..runtime import checks
from ..signals.units import SPEED_OF_LIGHT
from .photon_rates import Rates, generator


class Camera:
    """Base class of cameras, with their expectation and simulation.

    Subclasses define two methods.
    """

    # Convert rates to the expected Dataset
    _expected: Any

    # Add noise to the expected Dataset, with given random numbers
    _noisy: Any

    def expected(
        self,
        rates: Annotated[Any, RATES],
        cycles: int = 1,
        *,
        bin_width_opl: Any = None,
    ) -> xr.Dataset:
        """Compute the expectation of `frames`, float64, before saturation and quantization."""
        return self._expected(Rates(rates, cycles, bin_width_opl))

    def frames(
        self,
        rates: Annotated[Any, RATES],
        cycles: int,
        seed: int = 0,
        *,
        bin_width_opl: Any = None,
    ) -> xr.Dataset:
        """Simulate the output of the camera. Arguments and errors are as for `Spad.histogram`.

        The number of `cycles` in a frame is the exposure time times the repetition rate. Lazy rates
        are computed.

        Returns:
            A Dataset of photoelectrons. A `GatedCamera` has `images` (delay_opl, y, x). A
            `StreakCamera` has `images` (y, sweep, x) over the row of the slit and the path length
            [m]. `Itof` has `taps` (frequency, tap, y, x), and the mask `saturated` (y, x) of pixels
            with a full tap.
        """
        rng = generator(seed)
        expected = self.expected(rates, cycles, bin_width_opl=bin_width_opl)
        return self._noisy(rng, expected).assign_attrs(sensor_seed=seed)


@dataclass(frozen=True, kw_only=True)
class Multiplier(Camera):
    """Camera that multiplies electrons, with gain noise (`excess_noise`) and `read_noise`."""

    excess_noise: float = 1.0
    read_noise: float = 0.0

    def __post_init__(self) -> None:
        checks.number("excess_noise", self.excess_noise, low=1, high=100)
        checks.number("read_noise", self.read_noise, unit="electrons", low=0, high=1e9)

    def _noisy(self, rng: np.random.Generator, expected: xr.Dataset) -> xr.Dataset:
        # Rounding may make expectations negative
        means = np.maximum(expected["images"].values, 0)
        found = rng.poisson(means)

        # Add the noise of multiplication and readout
        more = self.excess_noise - 1
        noisy = rng.gamma(found / more, more) if more else found
        noisy = noisy + rng.normal(0, self.read_noise, found.shape)
        return expected.assign(images=expected["images"].copy(data=noisy))


@dataclass(frozen=True, kw_only=True)
class GatedCamera(Multiplier):
    """Camera that integrates the light that arrives while its gate is open.

    A gate of width w opens at the delay d. It transmits the fraction

        g(t) = e + (1 - e) [erf((t - d) / (sqrt(2) s)) - erf((t - d - w) / (sqrt(2) s))] / 2

    of the light at the path length t, averaged over each bin. Photoelectrons n are Poisson
    distributed with the mean m. Multiplication (gamma distributed around n with the shape
    n / (F - 1)) increases their variance to F m.

    Args:
        delays_opl: Path lengths d at which the gate opens [m], shape (n,).
        width_s: Width w of the gate [s].
        edge_s: Standard deviation s of the gate's edges [s], 0 for sharp edges.
        extinction: Fraction e of the light that the closed gate transmits, from 0 to 1.
        excess_noise: Excess noise factor F, from 1 to 100. It is 2 for an EMCCD, 1.6 for
            intensifiers.
        read_noise: Standard deviation of the read noise [electrons at the photocathode].

    Example:
        >>> camera = GatedCamera(delays_opl=[2.0], width_s=1e-9)
        >>> images = camera.expected(np.full((1, 1, 100), 0.5), 100, bin_width_opl=0.1)["images"]
        >>> round(images.item(), 4)
        149.8962
    """

    delays_opl: Any
    width_s: float
    edge_s: float = 0.0
    extinction: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.number("width_s", self.width_s, unit="seconds", positive=True, high=1)
        checks.number("edge_s", self.edge_s, unit="seconds", low=0, high=1)
        checks.number("extinction", self.extinction, low=0, high=1)
        delays = checks.finite("delays_opl", checks.real_array("delays_opl", self.delays_opl))
        checks.shape("delays_opl", delays, delays.ndim == 1 and delays.size, "(n,)")
        object.__setattr__(self, "delays_opl", tuple(delays.tolist()))

    def _edge(self, opl: np.ndarray) -> np.ndarray:
        """Integrate an edge at 0 up to the path length `opl` [m]."""
        s = max(self.edge_s * SPEED_OF_LIGHT, 1e-12)
        z = opl / (np.sqrt(2) * s)
        return 0.5 * (opl + opl * erf(z) + s * np.sqrt(2 / np.pi) * np.exp(-z * z))

    def _expected(self, rates: Rates) -> xr.Dataset:
        # Transmission of the gate, averaged over each bin
        ends = rates.edges - np.array(self.delays_opl)[:, None]
        opened = self._edge(ends) - self._edge(ends - self.width_s * SPEED_OF_LIGHT)
        gates = self.extinction + (1 - self.extinction) * np.diff(opened) / rates.width

        # Integrate the light over all bins
        images = np.tensordot(gates, np.asarray(rates.values), axes=(1, 2)) * rates.cycles
        delays = {"delay_opl": ("delay_opl", list(self.delays_opl), {"units": "m"})}
        return rates.result("images", ("delay_opl", "y", "x"), images, "electrons", **delays)


@dataclass(frozen=True, kw_only=True)
class StreakCamera(Multiplier):
    """Streak tube: electrons from a slit of the image are swept over a screen with time.

    Args:
        sweep_opl: Path length per pixel of the screen along the sweep [m].
        slit_rows: Number of rows of the image that the slit integrates, odd.
        slit_width: Width of the slit's image along the sweep [screen pixels], odd.
        spread_sweep: Standard deviation of the point spread along the sweep [screen pixels].
        spread_slit: Standard deviation of the point spread along the slit [pixels].
        excess_noise: As for `GatedCamera`.
        read_noise: As for `GatedCamera`.

    Example:
        >>> camera = StreakCamera(sweep_opl=0.2, spread_sweep=1.0)
        >>> screens = camera.frames(np.full((3, 8, 50), 0.1), 1000, bin_width_opl=0.1)
        >>> dict(screens["images"].sizes)
        {'y': 3, 'sweep': 25, 'x': 8}
    """

    sweep_opl: float
    slit_rows: int = 1
    slit_width: int = 1
    spread_sweep: float = 0.0
    spread_slit: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.width("sweep_opl", self.sweep_opl)
        for name in ("slit_rows", "slit_width"):
            size = checks.integer(name, getattr(self, name), 1, 999)
            checks.require(name, size, size % 2, "odd")
        for name in ("spread_sweep", "spread_slit"):
            checks.number(name, getattr(self, name), unit="pixels", low=0, high=1e4)

    def _expected(self, rates: Rates) -> xr.Dataset:
        # Slit and point spread reach into neighboring pixels
        require_consecutive(rates.dataset, "rates")

        # Distribute the light over the pixels of the sweep
        bins = rates.values.shape[2]
        step = self.sweep_opl / rates.width
        checks.require("sweep_opl", self.sweep_opl, step <= bins, "at most the window")
        edges = np.minimum(np.arange(int(bins / step + 1e-9) + 1) * step, bins)
        light: Any = sums_between(np.asarray(rates.values), edges).transpose(0, 2, 1) * rates.cycles

        # Integrate over the slit, and blur
        light = uniform_filter1d(light, self.slit_rows, axis=0, mode="constant") * self.slit_rows
        light = uniform_filter1d(light, self.slit_width, axis=1, mode="constant")
        for spread, along in ((self.spread_sweep, 1), (self.spread_slit, 2)):
            if spread:
                light = gaussian_filter1d(light, spread, axis=along, mode="constant", truncate=6)
        centers = rates.edges[0] + (np.arange(light.shape[1]) + 0.5) * self.sweep_opl
        sweep = {"sweep": ("sweep", centers, {"units": "m"})}
        found = rates.result("images", ("y", "sweep", "x"), light, "electrons", **sweep)
        return found.assign_attrs(bin_width_opl=self.sweep_opl)
