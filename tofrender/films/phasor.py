"""Film plugin `phasor_hdr_film`: a steady image and phasors at a list of frequencies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.settings import parameter
from ..signals.polarisation import STOKES, stokes_count
from ..signals.units import SPEED_OF_LIGHT, check_frequencies
from .image import box_by_default, image_film, stokes_channels

if TYPE_CHECKING:
    from ..signals.pulses import Pulse
    from .exposure import Exposure
    from .recording import PhasorRecording


class PhasorHDRFilm(mi.Film):
    """A film that stores phasors instead of time bins (plugin `phasor_hdr_film`).

    The phasor at the frequency f is P(f) = sum of L exp(+i 2 pi f opl / c) over all light. It is
    summed path by path: no window cuts it off, and no bin blurs it. I = Re P, Q = Im P.

    | parameter | default | meaning |
    |---|---|---|
    | `frequencies_hz` | | list as text, e.g. "20e6, 50e6" [Hz]; as many as fit into memory |
    | `wl_mean`, `wl_sigma` | 100, 1000 | mitransient's choice of wavelengths [m], without a list: |
    | `temporal_bins` | 4096 | those that a Fourier transform of so many bins |
    | `bin_width_opl` | 0.003 | of this width [m] has between c / wl_mean -+ c / (2 wl_sigma) |
    | `start_opl` | 0 | path length of phase 0 [m] |
    | `width`, ... `rfilter` | | size, crop and filter as of any film; box by default |

    `develop()` returns `(steady, phasors)`; phasors has the shape (height, width, frequencies, 2)
    in monochromatic variants, (height, width, frequencies, 2, 3) in others, with I and Q along the
    axis of length 2. In polarised variants, the last axis has 4 or 12 channels: those of S0, S1, S2
    and S3.

    mitransient's film of this name differs in the sign of Q, takes monochromatic variants only, and
    can hold the frequency 0, which is the steady image.

    Limitations: our integrators only; it has no `add_transient_data` for others.

    Example:
        >>> film = mi.load_dict({"type": "phasor_hdr_film", "frequencies_hz": "20e6, 50e6"})
        >>> film.frequencies_hz
        (20000000.0, 50000000.0)
    """

    def __init__(self, props: mi.Properties) -> None:
        box_by_default(props)
        text = props.get("frequencies_hz", None)
        mean = checks.metres("wl_mean", props.get("wl_mean", 100.0), positive=True)
        sigma = checks.metres("wl_sigma", props.get("wl_sigma", 1000.0), positive=True)
        width = parameter(props, "bin_width_opl", 0.003)
        bins = checks.integer("temporal_bins", props.get("temporal_bins", 4096), 2, checks.MAX_BINS)
        super().__init__(props)
        self.start_opl = parameter(props, "start_opl", 0.0)
        self.frequencies_hz = (
            _of_wavelengths(mean, sigma, bins, width) if text is None else parse_frequencies(text)
        )
        self._steady: mi.Film | None = None

    def recording(self, exposure: Exposure) -> PhasorRecording:
        """Return how an integrator's light is recorded, see `films.recording`."""
        from .recording import PhasorRecording  # Student editions may not have it

        return PhasorRecording(self, exposure)

    def base_channels_count(self) -> int:
        """Channels of the steady image without weight."""
        return 1 if mi.is_monochromatic else 3

    def prepare(self, aovs: Sequence[str]) -> int:
        """Make an empty image with channels for all phasors."""
        colours = "L" if mi.is_monochromatic else "RGB"
        stokes = STOKES if mi.is_polarized else ("",)
        axes = product(range(len(self.frequencies_hz)), "IQ", stokes, colours)
        names = [f"{part}{k:03d}{component}.{colour}" for k, part, component, colour in axes]
        self._steady = image_film(self)
        return self._steady.prepare([*aovs, *stokes_channels(), *names])

    def clear(self) -> None:
        """Clear the film."""
        self.steady.clear()

    @property
    def steady(self) -> mi.Film:
        """The image, an `hdrfilm`, with the phasors behind its colours; needs `prepare`."""
        if self._steady is None:
            raise RuntimeError("phasor_hdr_film: is empty; call prepare() first, or render")
        return self._steady

    def develop(self, raw: bool = False) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Return the steady image and the phasors, whose shapes the class tells.

        `raw` sums are not divided by the filter's weights, with which `steady` then ends.
        """
        image = self.steady.develop(raw=raw)
        colours = self.base_channels_count() * stokes_count()
        count = len(self.frequencies_hz)
        extra = image.shape[2] - 2 * count * colours
        shape = (*image.shape[:2], count, 2) + (() if colours == 1 else (colours,))
        steady, phasors = image[:, :, :extra], image[:, :, extra:]
        return steady, mi.TensorXf(phasors.array, shape)

    def to_string(self) -> str:
        """The film's parameters."""
        return (
            f"PhasorHDRFilm[\n  size = {self.size()},\n  crop_size = {self.crop_size()},\n"
            f"  frequencies_hz = {self.frequencies_hz},\n  start_opl = {self.start_opl}\n]"
        )

    def factors(self, pulse: Pulse | None) -> np.ndarray:
        """Return the factor of each phasor: the phase of `start_opl`, and the light's pulse."""
        shifts = [-2 * math.pi * f * self.start_opl / SPEED_OF_LIGHT for f in self.frequencies_hz]
        pulses = [fourier_transform(pulse, f) for f in self.frequencies_hz]
        return np.array([np.exp(1j * s) * p for s, p in zip(shifts, pulses, strict=True)])


def parse_frequencies(value: Any) -> tuple[float, ...]:
    """Parse one or more frequencies [Hz]: a number, a sequence of numbers, or text with commas.

    Example:
        >>> parse_frequencies("20e6, 50e6")
        (20000000.0, 50000000.0)
    """
    if isinstance(value, str):
        value = [_number(part) for part in value.split(",") if part.strip()]
    frequencies, _ = check_frequencies(value, "frequencies_hz")
    return tuple(frequencies)


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip()


def fourier_transform(pulse: Pulse | None, frequency_hz: float) -> complex:
    """Integral of p(t) exp(+i 2 pi f t / c): what a pulse does to a phasor.

    Example:
        >>> from tofrender import GaussianPulse
        >>> abs(fourier_transform(GaussianPulse(0.3), 100e6)) < 0.83
        True
    """
    if pulse is None:
        return 1.0 + 0.0j
    low, high = pulse.support
    edges = np.linspace(low, high, 4097)
    mass = np.diff(np.array(pulse.cdf(mi.Float(edges)), dtype=np.float64))
    centres = 0.5 * (edges[1:] + edges[:-1])
    turns = 2 * math.pi * frequency_hz / SPEED_OF_LIGHT
    return complex(np.sum(mass * np.exp(1j * turns * centres)) / np.sum(mass))


def _of_wavelengths(mean: float, sigma: float, bins: int, width: float) -> tuple[float, ...]:
    """Frequencies [Hz] that mitransient picks for a Morlet wavelet of these wavelengths [m]."""
    length = bins * width
    low = max(1, math.floor(length / mean - 0.5 * length / sigma))
    high = min(bins // 2, math.ceil(length / mean + 0.5 * length / sigma))
    return parse_frequencies([k / length * SPEED_OF_LIGHT for k in range(low, max(low, high) + 1)])
