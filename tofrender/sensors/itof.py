"""Correlation cameras (iToF, AMCW). Parameters out of range raise a ValueError."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..analysis.unwrapping import MAX_WRAPS, unambiguous_range, unwrap
from ..labels import TAPS, read
from ..runtime import checks
from ..signals.phasors import phasor_parts
from ..signals.units import SPEED_OF_LIGHT, check_below_limit, check_frequencies
from .cameras import Camera
from .photon_rates import Rates
from .taps import correlation, phasor_of_taps, sample_taps


@dataclass(frozen=True, kw_only=True)
class Itof(Camera):
    """Correlation camera with N taps, which demodulate light at the phases 2 pi k / N.

    For S photoelectrons with the phase phi = 2 pi f opl / c, and B photoelectrons of `background`,
    the mean of tap k is

        m_k = S / N g(phi - 2 pi k / N) + B / N,    g(a) = 1 + M (cos a + sum of a_h cos(h a))

    Shot noise (Poisson) and read noise are added. Then the tap saturates and is digitized. The
    estimated phase is the angle of sum m_k exp(+2 pi i k / N) (Lange and Seitz, IEEE J. Quantum
    Electronics 37, 2001). With four taps, harmonics cause the error
    arg(1 + a_3 exp(-4i phi) + a_5 exp(4i phi)).

    Args:
        frequencies_hz: Modulation frequencies [Hz], one frame for each, or a single frequency.
        taps: Number N of taps, from 3 to 64.
        contrast: Modulation contrast M in (0, 1].
        harmonics: Amplitudes a_2, a_3, ... with g >= 0. Two rectangles have 1 / h^2 for odd h.
        read_noise: Standard deviation of a tap's read noise [electrons].
        full_well: Capacity of a tap [electrons], None without saturation.
        adc_bits: Bits of a converter from 0 to the full well, None without quantization. Noise
            below 0 is kept, as with a black level.

    Example:
        >>> camera = Itof(frequencies_hz=(20e6, 50e6), contrast=0.7)
        >>> rates = np.eye(60)[40].reshape(1, 1, 60)  # At 20.25 m of path
        >>> frames = camera.frames(rates, cycles=10**6, seed=1, bin_width_opl=0.5)
        >>> round(camera.depth(frames)["depth"].item(), 1)
        10.1
    """

    frequencies_hz: Any
    taps: int = 4
    contrast: float = 0.5
    harmonics: tuple[float, ...] = ()
    read_noise: float = 0.0
    full_well: float | None = None
    adc_bits: int | None = None

    def __post_init__(self) -> None:
        # Signal
        frequencies, _ = check_frequencies(self.frequencies_hz, "frequencies_hz")
        object.__setattr__(self, "frequencies_hz", tuple(frequencies))
        checks.integer("taps", self.taps, 3, 64)
        checks.number("contrast", self.contrast, positive=True, high=1)
        harmonics = checks.finite("harmonics", checks.real_array("harmonics", self.harmonics))
        checks.shape("harmonics", harmonics, harmonics.ndim == 1, "(n,)")
        object.__setattr__(self, "harmonics", tuple(harmonics.tolist()))

        # Sensitivity must not be negative
        sensitivity = correlation(np.linspace(0, 2 * np.pi, 721), self.contrast, self.harmonics)
        bright = sensitivity.min() >= -1e-9
        checks.require("harmonics", self.harmonics, bright, "so small that no light is negative")

        # Noise
        checks.number("read_noise", self.read_noise, unit="electrons", low=0, high=1e9)
        if self.full_well is not None:
            checks.number("full_well", self.full_well, unit="electrons", positive=True)
        if self.adc_bits is not None:
            checks.integer("adc_bits", self.adc_bits, 1, 32)
            checks.require("full_well", None, self.full_well is not None, "given with adc_bits")

    def _expected(self, rates: Rates) -> xr.Dataset:
        # Phase of each bin
        check_below_limit(self.frequencies_hz, rates.width)
        centers = rates.edges[:-1] + rates.width / 2
        phases = 2 * np.pi / SPEED_OF_LIGHT * np.outer(self.frequencies_hz, centers)
        steps = 2 * np.pi * np.arange(self.taps) / self.taps
        angles = phases[:, None] - steps[:, None]
        waves = correlation(angles, self.contrast, self.harmonics)

        # Integrate modulated light and constant background
        ambient = rates.dataset["background"].values
        modulated = np.asarray(rates.values) - ambient[..., None]
        taps = np.tensordot(waves, modulated, axes=(2, 2)) + ambient * centers.size
        taps = np.maximum(taps * rates.cycles / self.taps, 0)
        dims = ("frequency", "tap", "y", "x")
        frames = {"frequency": list(self.frequencies_hz), "tap": np.arange(self.taps)}
        return rates.result("taps", dims, taps, "electrons", **frames)

    def _noisy(self, rng: np.random.Generator, expected: xr.Dataset) -> xr.Dataset:
        # Add noise, and saturate
        means = expected["taps"].values
        full = np.inf if self.full_well is None else self.full_well
        taps = sample_taps(rng, means, self.read_noise, full)
        saturated = (taps >= full).any(axis=(0, 1))

        # Digitize
        if self.adc_bits is not None:
            step = full / ((1 << self.adc_bits) - 1)
            taps = np.rint(taps / step) * step
        taps = expected["taps"].copy(data=taps)
        return expected.assign(taps=taps, saturated=(("y", "x"), saturated))

    def depth(
        self, frames: Annotated[xr.Dataset, TAPS], max_depth: float | None = None
    ) -> xr.Dataset:
        """Compute amplitude, phase and depth from `frames` or `expected` of this camera.

        Several frequencies are unwrapped by `tofrender.unwrap` up to `max_depth` [m], which is by
        default the largest supported depth.

        Returns:
            A Dataset with `amplitude` [electrons] and `phase` [rad] in (-pi, pi], (frequency, y,
            x), and `depth` and `residual` [m], (y, x), as from `unwrap`. They are NaN if a tap was
            saturated, also in a single exposure of a sum. With one frequency, the depth is in
            [0, c / 2f), as from `tofrender.phasor_parts`.
        """
        # Read the frames. In a sum of exposures, `saturated` contains counts
        frames = self._in_order(read(frames, TAPS, "frames"))
        if len(self.frequencies_hz) == 1:
            checks.require("max_depth", max_depth, max_depth is None, "None with one frequency")
        taps = frames["taps"].values.astype(np.float64)
        if "saturated" in frames:
            saturated = frames["saturated"].values != 0
            taps[:, :, saturated] = np.nan

        # Compute the phase
        phasor: Any = phasor_of_taps(taps.swapaxes(0, 1), self.contrast)
        amplitude, phase, depths = phasor_parts(phasor.real, phasor.imag, self.frequencies_hz)
        depth = depths[0], 0 * depths[0]

        # Unwrap several frequencies
        if len(self.frequencies_hz) > 1:
            lit = np.nan_to_num(amplitude)
            limit = MAX_WRAPS * unambiguous_range(max(self.frequencies_hz))
            limit = min(limit, unambiguous_range(self.frequencies_hz))
            max_depth = limit if max_depth is None else max_depth
            depth = unwrap(phase, self.frequencies_hz, max_depth, amplitudes=lit)

        # Describe the result
        found = {"amplitude": amplitude, "phase": phase, "depth": depth[0], "residual": depth[1]}
        dims = ("frequency", "y", "x")
        images = {name: (dims[-image.ndim :], image) for name, image in found.items()}
        return frames.drop_vars([*frames.data_vars, "tap"], errors="ignore").assign(images)

    def _in_order(self, frames: xr.Dataset) -> xr.Dataset:
        """Require all taps and frequencies of this camera, and return them in order."""
        shape = (len(self.frequencies_hz), self.taps)
        given = frames["frequency"].values
        is_complete = frames["taps"].shape[:2] == shape and "frequency" in frames.coords
        is_complete = is_complete and np.array_equal(np.sort(given), np.sort(self.frequencies_hz))
        is_complete = is_complete and np.array_equal(frames["tap"], np.arange(self.taps))
        if not is_complete:
            raise ValueError(
                f"frames: the axes frequency and tap must have {shape[0]} and {shape[1]} entries, "
                "of this camera's frequencies. Pass all frames of this camera"
            )
        if np.array_equal(given, self.frequencies_hz):
            return frames
        return frames.sel(frequency=list(self.frequencies_hz))
