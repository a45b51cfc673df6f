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
from ..signals.polarization import STOKES, stokes_count
from ..signals.units import SPEED_OF_LIGHT, check_frequencies
from .image import box_by_default, image_film, stokes_channels

if TYPE_CHECKING:
    from ..signals.pulses import Pulse
    from .exposure import Exposure
    from .recording import PhasorRecording


class PhasorHDRFilm(mi.Film):
    """A film that stores phasors instead of time bins (plugin `phasor_hdr_film`).

    The phasor at the frequency f is P(f) = sum of L exp(+i 2 pi f opl / c) over all light, with
    I = Re P and Q = Im P. It is summed path by path, so it includes light of all path lengths at
    full temporal resolution.

    | parameter | default | meaning |
    |---|---|---|
    | `frequencies_hz` | | list as text, e.g. "20e6, 50e6" [Hz]; memory limits the number |
    | `wl_mean` | 100 | mean wavelength w [m] of mitransient's choice of frequencies |
    | `wl_sigma` | 1000 | width s [m] of mitransient's choice of frequencies |
    | `temporal_bins` | 4096 | number of bins of mitransient's choice of frequencies |
    | `bin_width_opl` | 0.003 | width of these bins [m] |
    | `start_opl` | 0 | path length with phase 0 [m] |
    | `width`, ... `rfilter` | | size, crop and filter as in other films; box by default |

    Without `frequencies_hz`, the film uses mitransient's choice: the frequencies of a Fourier
    transform over these bins that are between c / w - c / (2 s) and c / w + c / (2 s).

    `develop()` returns `(steady, phasors)`. The shape of the phasors is (height, width,
    frequencies, 2) in monochromatic variants and (height, width, frequencies, 2, 3) in others, with
    I and Q along the axis of length 2. In polarized variants, the last axis has 4 or 12 channels,
    for S0, S1, S2 and S3.

    mitransient's film of the same name has the opposite sign of Q, supports monochromatic variants
    only, and can include the frequency 0, which is the steady image.

    Limitations: the film supports this package's integrators only, because it does not have the
    method `add_transient_data`.

    Example:
        >>> film = mi.load_dict({"type": "phasor_hdr_film", "frequencies_hz": "20e6, 50e6"})
        >>> film.frequencies_hz
        (20000000.0, 50000000.0)
    """

    def __init__(self, props: mi.Properties) -> None:
        # Read the parameters
        box_by_default(props)
        text = props.get("frequencies_hz", None)
        mean = checks.meters("wl_mean", props.get("wl_mean", 100.0), positive=True)
        sigma = checks.meters("wl_sigma", props.get("wl_sigma", 1000.0), positive=True)
        width = parameter(props, "bin_width_opl", 0.003)
        bins = checks.integer("temporal_bins", props.get("temporal_bins", 4096), 2, checks.MAX_BINS)
        super().__init__(props)
        self.start_opl = parameter(props, "start_opl", 0.0)

        # The given frequencies, or mitransient's choice
        self.frequencies_hz = (
            _of_wavelengths(mean, sigma, bins, width) if text is None else parse_frequencies(text)
        )
        self._steady: mi.Film | None = None

    def recording(self, exposure: Exposure) -> PhasorRecording:
        """Return the recording of an integrator's light on this film, see `films.recording`."""
        from .recording import PhasorRecording  # Editions may leave it out

        return PhasorRecording(self, exposure)

    def base_channels_count(self) -> int:
        """Return the number of channels of a color: 1 in monochromatic variants, otherwise 3."""
        return 1 if mi.is_monochromatic else 3

    def prepare(self, aovs: Sequence[str]) -> int:
        """Create an empty image with channels for all phasors.

        Returns:
            The number of channels of the image.
        """
        colors = "L" if mi.is_monochromatic else "RGB"
        stokes = STOKES if mi.is_polarized else ("",)
        axes = product(range(len(self.frequencies_hz)), "IQ", stokes, colors)
        names = [f"{part}{k:03d}{component}.{color}" for k, part, component, color in axes]
        self._steady = image_film(self)
        return self._steady.prepare([*aovs, *stokes_channels(), *names])

    def clear(self) -> None:
        """Clear the film."""
        self.steady.clear()

    @property
    def steady(self) -> mi.Film:
        """The image, an `hdrfilm`, with channels of phasors after the channels of color.

        Raises:
            RuntimeError: If `prepare` has not been called.
        """
        if self._steady is None:
            raise RuntimeError("phasor_hdr_film: the film is empty. Call prepare() or render first")
        return self._steady

    def develop(self, raw: bool = False) -> tuple[mi.TensorXf, mi.TensorXf]:
        """Return the steady image and the phasors, with shapes as described for the class.

        Args:
            raw: Whether the sums are not divided by the weights of the reconstruction filter. The
                last channel of the steady image then contains these weights.
        """
        image = self.steady.develop(raw=raw)
        channels = self.base_channels_count() * stokes_count()
        count = len(self.frequencies_hz)
        extra = image.shape[2] - 2 * count * channels
        shape = (*image.shape[:2], count, 2) + (() if channels == 1 else (channels,))
        steady = image[:, :, :extra]
        phasors = image[:, :, extra:]
        return steady, mi.TensorXf(phasors.array, shape)

    def to_string(self) -> str:
        """Return the film's parameters as text."""
        return (
            f"PhasorHDRFilm[\n  size = {self.size()},\n  crop_size = {self.crop_size()},\n"
            f"  frequencies_hz = {self.frequencies_hz},\n  start_opl = {self.start_opl}\n]"
        )

    def factors(self, pulse: Pulse | None) -> np.ndarray:
        """Return a complex factor of each phasor: phase of `start_opl` times pulse's transform."""
        shifts = [-2 * math.pi * f * self.start_opl / SPEED_OF_LIGHT for f in self.frequencies_hz]
        pulses = [fourier_transform(pulse, f) for f in self.frequencies_hz]
        return np.array([np.exp(1j * s) * p for s, p in zip(shifts, pulses, strict=True)])


def parse_frequencies(value: Any) -> tuple[float, ...]:
    """Convert a number, a sequence of numbers, or text with commas to a tuple of frequencies [Hz].

    Raises:
        ValueError: If a frequency is out of range.

    Example:
        >>> parse_frequencies("20e6, 50e6")
        (20000000.0, 50000000.0)
    """
    if isinstance(value, str):
        value = [_number(part) for part in value.split(",") if part.strip()]
    frequencies, _ = check_frequencies(value, "frequencies_hz")
    return tuple(frequencies)


def _number(text: str) -> float | str:
    """Convert text to a number, or return the text if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return text.strip()


def fourier_transform(pulse: Pulse | None, frequency_hz: float) -> complex:
    """Return the factor of a phasor by a pulse p: the integral of p(t) exp(+i 2 pi f t / c).

    Args:
        pulse: The pulse, or None for an instant with the factor 1.
        frequency_hz: The frequency f [Hz].

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
    centers = 0.5 * (edges[1:] + edges[:-1])
    turns = 2 * math.pi * frequency_hz / SPEED_OF_LIGHT
    return complex(np.sum(mass * np.exp(1j * turns * centers)) / np.sum(mass))


def _of_wavelengths(mean: float, sigma: float, bins: int, width: float) -> tuple[float, ...]:
    """Return the frequencies [Hz] that mitransient chooses for a Morlet wavelet.

    Args:
        mean: Mean wavelength [m].
        sigma: Width of the wavelet [m].
        bins: Number of bins of the Fourier transform.
        width: Width of a bin [m].
    """
    length = bins * width
    low = max(1, math.floor(length / mean - 0.5 * length / sigma))
    high = min(bins // 2, math.ceil(length / mean + 0.5 * length / sigma))
    return parse_frequencies([k / length * SPEED_OF_LIGHT for k in range(low, max(low, high) + 1)])
