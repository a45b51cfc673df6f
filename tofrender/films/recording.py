"""Recordings of light on each kind of film.

| recording | film | measurement |
|---|---|---|
| `BinRecording` | `transient_hdr_film` | energy in each time bin |
| `MitransientRecording` | mitransient's film of this name | time bins, with fewer features |
| `PhasorRecording` | `phasor_hdr_film` | phasors |
| `PictureRecording` | all other films | one weighted sum |

A film selects its recording by a method `recording(exposure)`. No other module distinguishes kinds
of films.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import memory
from ..signals.polarization import components, scaled, stokes_count
from .accumulation import Accumulation, BinAccumulation, first_image
from .channels import channels_of, kept, to_rgb
from .contribution import CameraSample
from .exposure import BINS, PHASORS, PICTURE, Exposure, profile
from .histogram import MAX_ADDED, TAKEN_COPIES
from .image import require_resolved, stokes_channels
from .phasor_sum import PhasorSum
from .splats import Splats
from .sums import Radiance, Splat, Weighted
from .time_bins import TimeBins

Channels = tuple[list[mi.Float], list[mi.Float]]
"""Channels of samples before the image's weight channel, and channels after it."""

PHASOR_COPIES = 9.0  # Peak memory of a phasor image and its results, in multiples of the image
USE_OUR_FILM = f"Use this package's {BINS}"


def recording(film: mi.Film, exposure: Exposure) -> Recording:
    """Return the recording of an exposure on a film.

    Raises:
        TypeError, ValueError: If the film does not support the exposure.
    """
    if hasattr(film, "recording"):
        return film.recording(exposure)
    if hasattr(film, "add_transient_data"):
        return MitransientRecording(film, exposure)
    return PictureRecording(film, exposure)


def warn_not_finite(count: int, stacklevel: int = 4) -> None:
    """Warn of contributions that were dropped because they were not finite."""
    if count:
        warnings.warn(
            f"{count} contributions of paths were not finite and were dropped. Check the lights, "
            "materials and textures of the scene for infinite values",
            stacklevel=stacklevel,
        )


class Recording:
    """Writes the light of a render to a film.

    The function `steps` calls `prepare` once, and then in each step `measurement` and `channels`
    for all samples, and `accumulation.update_image`. The attribute `accumulation` is the light that
    the film contains. A render is resumed with its methods.

    Attributes:
        film: The film.
        exposure: Weighting of light by path length. Its `weight` is None for films that resolve
            path lengths.
    """

    # Whether pixels that see emitters get additional samples
    emitters_apart = False

    # Path length that the film resolves [m], None for films without time bins
    width_opl: float | None = None

    # Whether contributions must have the rate of change of their path length
    needs_rates = False

    # Kind of film, which the exposure must support; None for all kinds
    _kind: str | None = None

    # Number of images that splats are added to; an image contains all channels of color
    _splat_images = 1

    # Class of the accumulation
    _accumulates: type[Accumulation] = Accumulation

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        if self._kind is not None and self._kind not in exposure.supported_films:
            allowed = " or ".join(exposure.supported_films)
            name = film.class_name() if type(film) is mi.Film else type(film).__name__
            raise TypeError(f"film = {name}: must be {allowed}, or a film with its interface")
        self.film = film
        self.exposure = replace(exposure, weight=None)
        self._accumulation: Accumulation | None = None

    @property
    def image(self) -> mi.Film:
        """The image of the samples."""
        return self.film

    @property
    def accumulation(self) -> Accumulation:
        """The light that the film contains. Before `prepare`, this raises a `RuntimeError`."""
        if self._accumulation is None:
            raise RuntimeError("the film is not prepared. Call prepare() of its recording first")
        return self._accumulation

    def require_memory(self, spp: int) -> None:
        """Raise a `MemoryError` if a film with `spp` samples per pixel cannot be developed."""

    def require_no_lengths(self, integrator: str) -> None:
        """Raise a TypeError: the film needs path lengths, and `sample()` does not report any."""
        raise TypeError(
            f"integrator = {integrator}: its own sample() does not report path lengths. "
            f"Use a steady film instead of {self.film.class_name()}, or another integrator"
        )

    def prepare(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Clear the film, and prepare it for samples.

        Args:
            spp: Number of samples per pixel.
            splats: Whether measurements add contributions at positions of their own.
            apart: Whether kernels that add splats do not add samples. This saves memory.
        """
        self.film.prepare(self._extra_channels())
        self._accumulation = self._accumulates(
            film=self.film,
            image=self.image,
            spp=spp,
            splats=Splats(self.film, self._splat_images) if splats else None,
            arrange=self._arrange,
        )

    def measurement(self, camera: CameraSample, one_writer: bool = False) -> Radiance:
        """Create the measurement of camera rays. Its `total` is the color of the picture.

        Args:
            camera: The camera rays.
            one_writer: Whether only one thread writes to each pixel, which makes bins faster.
        """
        return Radiance.zero(self._splat(camera))

    def channels(self, camera: CameraSample, measured: Radiance, valid_ray: mi.Bool) -> Channels:
        """Return the channels of samples before and after the image's weight channel.

        Args:
            camera: The camera rays.
            measured: Measured light of the camera rays.
            valid_ray: Lanes that are opaque in the alpha channel.
        """
        # Convert each Stokes component to RGB
        light = components(scaled(measured.total, camera.weight))
        color, *rest = (to_rgb(each, camera.ray.wavelengths) for each in light)

        # The first component and alpha are before the weight channel
        first = [color.x, color.y, color.z]
        if mi.has_flag(self.image.flags(), mi.FilmFlags.Alpha):
            first.append(dr.select(valid_ray, mi.Float(1), mi.Float(0)))
        return first, [value for each in rest for value in kept(each)]

    def _extra_channels(self) -> list[str]:
        """Return the names of channels of the film after its colors."""
        return []

    def _arrange(self, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Arrange sums of splats in the channels of the image, see `accumulation.Arrange`."""
        return first_image(sums)

    def _splat(self, camera: CameraSample) -> Splat | None:
        """Return a function that adds splats to the picture, None for renders without splats."""
        splats = self.accumulation.splats
        if splats is None:
            return None
        weight = self.accumulation.sample_weight(camera.weight)

        def add(spectra: list[mi.Spectrum], position: mi.Point2f, active: mi.Bool) -> None:
            """Add the spectra of all images at a position on the film [pixels]."""
            lights = [scaled(each, weight) for each in spectra]
            values = [channels_of(each, camera.ray.wavelengths) for each in lights]
            splats.add(position, values, 0, active)

        return add


class PictureRecording(Recording):
    """Recording of a steady picture of all light, or of light weighted by path length."""

    _kind = PICTURE

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        super().__init__(film, exposure)
        if exposure.steady_film_error:
            raise ValueError(exposure.steady_film_error)
        self.exposure = exposure
        self.emitters_apart = exposure.weight is not None

    def require_no_lengths(self, integrator: str) -> None:
        """Accept any integrator, because a steady picture does not need path lengths."""

    def measurement(self, camera: CameraSample, one_writer: bool = False) -> Radiance:
        """Create the sum of light, weighted by path length if the exposure has a weight."""
        splat = self._splat(camera)
        weight = self.exposure.weight
        return Radiance.zero(splat) if weight is None else Weighted.zero(weight, splat)

    def _extra_channels(self) -> list[str]:
        """Return the channels for Stokes components in polarized variants."""
        return stokes_channels()


class BinRecording(Recording):
    """Recording of time bins, with the light's pulse convolved with the temporal filter."""

    _kind = BINS
    emitters_apart = True
    _accumulates = BinAccumulation

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        super().__init__(film, exposure)
        require_resolved(film)

        # Pulses of users need all methods for time bins
        pulse = exposure.pulse
        if pulse is not None and not (hasattr(pulse, "support") and hasattr(pulse, "eval")):
            raise TypeError(
                f"pulse = {type(pulse).__name__}: must have eval, cdf and support for a film with "
                "time bins, like GaussianPulse(0.03)"
            )
        self.profile = profile(film, exposure)

    @property
    def image(self) -> mi.Film:
        """The film's steady image."""
        return self.film.steady

    @property
    def width_opl(self) -> float:
        """Width of a bin, plus half the extent of pulse and filter [m]."""
        low, high = (0.0, 0.0) if self.profile is None else self.profile.support
        return float(self.film.bin_width_opl) + 0.5 * (high - low)

    def require_memory(self, spp: int) -> None:
        """Raise a MemoryError if bins, flushed bins and the result of `develop` do not fit."""
        # The result has no padding, so it is smaller than the bins
        shape = self.film.shape
        copies = 2 if spp > MAX_ADDED else 1
        result = shape[3] / memory.stride(shape[3])
        memory.require_film(*shape, copies=copies + result, host_copies=TAKEN_COPIES)

    def prepare(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Clear the film, and allocate bins for splats."""
        super().prepare(spp, splats, apart)
        if splats:
            self.film.expect_splats(apart)

    def measurement(self, camera: CameraSample, one_writer: bool = False) -> TimeBins:
        """Create the measurement of the bins."""
        return TimeBins.of_film(
            film=self.film,
            camera=camera,
            weight=self.accumulation.sample_weight(camera.weight),
            pulse=self.profile,
            at_centers=self.exposure.at_centers,
            splat_steady=self._splat(camera),
            one_writer=one_writer,
        )


class MitransientRecording(BinRecording):
    """Recording of time bins on mitransient's film, without splats, checkpoints and flushing."""

    emitters_apart = False  # Pixels of visible emitters would need flushing
    _accumulates = Accumulation

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        if mi.is_polarized:
            raise TypeError(
                f"{self._named(film)}: polarized light is not supported. {USE_OUR_FILM}"
            )
        super().__init__(film, exposure)

    @staticmethod
    def _named(film: mi.Film) -> str:
        """Return the class of a film for messages."""
        return f"film = {type(film).__module__}.{type(film).__name__}"

    def require_memory(self, spp: int) -> None:
        """Accept any film, because the memory of mitransient's film is unknown."""

    def prepare(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Clear the film. Raise an error for splats."""
        if splats:
            raise TypeError(
                f"{self._named(self.film)}: light tracing is not supported. {USE_OUR_FILM}"
            )
        super().prepare(spp)

    def measurement(self, camera: CameraSample, one_writer: bool = False) -> TimeBins:
        """Create the measurement of the bins. mitransient's film adds atomically."""
        return super().measurement(camera)


class PhasorRecording(Recording):
    """Recording of phasors, multiplied by the Fourier transform of the light's pulse."""

    _kind = PHASORS
    emitters_apart = True

    def prepare(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Clear the film. Raise an error for a film that does not fit into memory."""
        self.require_memory(spp)
        super().prepare(spp, splats, apart)

    def require_memory(self, spp: int) -> None:
        """Raise a MemoryError if the film's image and the results do not fit into memory."""
        width, height = (int(n) for n in self.film.crop_size())
        count = len(self.film.frequencies_hz)
        channels = (1 + 2 * count) * self.film.base_channels_count() * stokes_count() + 1
        what = f"film of {width} x {height} pixels x {count} frequencies"
        memory.require_array(
            what, width * height * channels, PHASOR_COPIES, host_copies=PHASOR_COPIES
        )

    @property
    def image(self) -> mi.Film:
        """The film's image, with channels of phasors after the channels of color."""
        return self.film.steady

    def measurement(self, camera: CameraSample, one_writer: bool = False) -> PhasorSum:
        """Create the sums of phasors."""
        return PhasorSum.zero(self.film.frequencies_hz, self._splat(camera))

    @property
    def _splat_images(self) -> int:
        """Number of images: one for all light, and two for each frequency."""
        return 1 + 2 * len(self.film.frequencies_hz)

    def _arrange(self, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Arrange sums of splats: colors, and phasors multiplied by the film's factors."""
        # Multiply the phasors by the film's factors
        n = len(self.film.frequencies_hz)
        phasors = sums[:, :, 1 : n + 1] + 1j * sums[:, :, n + 1 :]
        phasors = phasors * self.film.factors(self.exposure.pulse)[:, None]

        # Append the phasors to the other channels
        parts = np.stack([phasors.real, phasors.imag], axis=3)
        first, rest = super()._arrange(sums)
        return first, np.concatenate([rest, parts.reshape(*sums.shape[:2], -1)], axis=2)

    def channels(self, camera: CameraSample, measured: Radiance, valid_ray: mi.Bool) -> Channels:
        """Return the color before the weight channel, and all phasors after the weight channel."""
        first, rest = super().channels(camera, measured, valid_ray)

        def colors(light: mi.Spectrum) -> list[mi.Color3f]:
            """Return the RGB color of each Stokes component."""
            each_component = components(scaled(light, camera.weight))
            return [to_rgb(each, camera.ray.wavelengths) for each in each_component]

        # Multiply each phasor by the film's complex factor a + ib
        for k, factor in enumerate(self.film.factors(self.exposure.pulse)):
            a = float(factor.real)
            b = float(factor.imag)
            both = list(zip(colors(measured.real[k]), colors(measured.imaginary[k]), strict=True))
            parts = [re * a - im * b for re, im in both] + [re * b + im * a for re, im in both]
            rest += [value for part in parts for value in kept(part)]
        return first, rest
