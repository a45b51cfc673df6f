"""Correlation cameras (iToF, AMCW). Parameters that are not allowed raise a ValueError."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ..analysis.unwrapping import MAX_WRAPS, unambiguous_range, unwrap
from ..runtime import checks
from ..signals.phasors import phasor_parts
from ..signals.units import SPEED_OF_LIGHT, check_below_limit, check_frequencies
from .cameras import Camera
from .correlation import correlation, phasor_of_taps, sample_taps
from .rates import Rates


@dataclass(frozen=True, kw_only=True)
class Itof(Camera):
    """Correlation camera whose N taps integrate light, demodulated at the phases 2 pi k / N.

    Of S photoelectrons with the phase phi = 2 pi f opl / c, and B of `background`, tap k has

        m_k = S / N g(phi - 2 pi k / N) + B / N,    g(a) = 1 + M (cos a + sum of a_h cos(h a))

    in the mean, shot noise (Poisson) and read noise, saturates, and is digitised. The phase is that
    of sum m_k exp(+2 pi i k / N) (Lange and Seitz, IEEE J. Quantum Electronics 37, 2001): with four
    taps, harmonics add arg(1 + a_3 exp(-4i phi) + a_5 exp(4i phi)).

    Args:
        frequencies_hz: Modulation frequencies [Hz], a frame for each; or one.
        taps: Number N of taps, from 3 to 64.
        contrast: Modulation contrast M in (0, 1].
        harmonics: Amplitudes a_2, a_3, ... with g >= 0; 1 / h^2, odd h, for two rectangles.
        read_noise: Standard deviation of a tap's read noise [electrons].
        full_well: Capacity of a tap [electrons], None for no saturation.
        adc_bits: Bits of a converter for 0 to the full well, which keeps noise below 0 (by a black
            level); None for no quantisation.

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
        frequencies, _ = check_frequencies(self.frequencies_hz, "frequencies_hz")
        object.__setattr__(self, "frequencies_hz", tuple(frequencies))
        checks.integer("taps", self.taps, 3, 64)
        checks.number("contrast", self.contrast, positive=True, high=1)
        harmonics = checks.finite("harmonics", checks.real_array("harmonics", self.harmonics))
        checks.shape("harmonics", harmonics, harmonics.ndim == 1, "(n,)")
        object.__setattr__(self, "harmonics", tuple(harmonics.tolist()))
        sensitivity = correlation(np.linspace(0, 2 * np.pi, 721), self.contrast, self.harmonics)
        bright = sensitivity.min() >= -1e-9
        checks.require("harmonics", self.harmonics, bright, "so small that no light is negative")
        checks.number("read_noise", self.read_noise, unit="electrons", low=0, high=1e9)
        if self.full_well is not None:
            checks.number("full_well", self.full_well, unit="electrons", positive=True)
        if self.adc_bits is not None:
            checks.integer("adc_bits", self.adc_bits, 1, 32)
            checks.require("full_well", None, self.full_well is not None, "given with adc_bits")

    def _expected(self, rates: Rates) -> xr.Dataset:
        check_below_limit(self.frequencies_hz, rates.width)
        centres = rates.edges[:-1] + rates.width / 2
        phases = 2 * np.pi / SPEED_OF_LIGHT * np.outer(self.frequencies_hz, centres)
        steps = 2 * np.pi * np.arange(self.taps) / self.taps
        angles = phases[:, None] - steps[:, None]
        waves = correlation(angles, self.contrast, self.harmonics)
        ambient = rates.dataset["background"].values
        modulated = np.asarray(rates.values) - ambient[..., None]
        taps = np.tensordot(waves, modulated, axes=(2, 2)) + ambient * centres.size
        taps, dims = np.maximum(taps * rates.cycles / self.taps, 0), ("frequency", "tap", "y", "x")
        return rates.result("taps", dims, taps, "electrons", frequency=list(self.frequencies_hz))

    def _noisy(self, rng: np.random.Generator, expected: xr.Dataset) -> xr.Dataset:
        means = expected["taps"].values
        full = np.inf if self.full_well is None else self.full_well
        taps = sample_taps(rng, means, self.read_noise, full)
        saturated = (taps >= full).any(axis=(0, 1))
        if self.adc_bits is not None:
            step = full / ((1 << self.adc_bits) - 1)
            taps = np.rint(taps / step) * step
        taps = expected["taps"].copy(data=taps)
        return expected.assign(taps=taps, saturated=(("y", "x"), saturated))

    def depth(self, frames: xr.Dataset, max_depth: float | None = None) -> xr.Dataset:
        """Compute amplitude, phase and depth from `frames` or `expected` of this camera.

        Several frequencies are unwrapped, by `tofrender.unwrap` up to `max_depth` [m], by
        default the largest that it takes.

        Returns:
            A Dataset: `amplitude` [electrons] and `phase` [rad] in (-pi, pi] (frequency, y, x),
            `depth` and `residual` [m] (y, x) as of `unwrap`; NaN where a tap was saturated. With
            one frequency the depth is in [0, c / 2f), as of `tofrender.phasor_parts`.
        """
        shape = (len(self.frequencies_hz), self.taps)
        own = isinstance(frames, xr.Dataset) and "taps" in frames and frames["taps"].ndim == 4
        own = own and frames["taps"].shape[:2] == shape
        own = own and np.array_equal(frames.get("frequency", []), self.frequencies_hz)
        allowed = f"a Dataset with {shape} frames and taps, of this camera's frequencies"
        checks.require("frames", frames, own, allowed)
        if shape[0] == 1:
            checks.require("max_depth", max_depth, max_depth is None, "None with one frequency")
        taps = frames["taps"].values.astype(np.float64)
        if "saturated" in frames:
            taps[:, :, frames["saturated"].values] = np.nan
        phasor: Any = phasor_of_taps(taps.swapaxes(0, 1), self.contrast)
        amplitude, phase, depths = phasor_parts(phasor.real, phasor.imag, self.frequencies_hz)
        depth = depths[0], 0 * depths[0]
        if len(self.frequencies_hz) > 1:
            lit = np.nan_to_num(amplitude)
            limit = MAX_WRAPS * unambiguous_range(max(self.frequencies_hz))
            limit = min(limit, unambiguous_range(self.frequencies_hz))
            max_depth = limit if max_depth is None else max_depth
            depth = unwrap(phase, self.frequencies_hz, max_depth, amplitudes=lit)
        found = {"amplitude": amplitude, "phase": phase, "depth": depth[0], "residual": depth[1]}
        dims = ("frequency", "y", "x")
        images = {name: (dims[-image.ndim :], image) for name, image in found.items()}
        return frames.drop_vars(frames.data_vars).assign(images)
