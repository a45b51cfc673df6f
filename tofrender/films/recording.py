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
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import memory
from ..signals.polarization import components, scaled, stokes_count
from .colors import channels_of, color_count, kept, to_rgb
from .contribution import CameraRays
from .exposure import BINS, PHASORS, PICTURE, Exposure, Weight, profile
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
    """Adds light to a film.

    The function `steps` calls the methods in this order: `prepare` and `begin`; `restore` to
    continue from a checkpoint; then in each step `set_one_writer`, `measurement` and `channels` for
    all samples, and `update_image`; and sometimes `flush`.
    """

    # Kind of film, which the exposure must support
    kind: str | None = None

    # Whether pixels that see emitters get additional samples
    emitters_apart = False

    # Weight by path length, None if all light has the weight 1
    weight: Weight | None = None

    # Path length that the film resolves [m], None for films without time bins
    width_opl: float | None = None

    # Number of images that splats are added to; an image contains all channels of color
    splat_images = 1

    # Whether contributions must have the rate of change of their path length
    needs_rates = False

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        if self.kind is not None and self.kind not in exposure.supported_films:
            allowed = " or ".join(exposure.supported_films)
            name = film.class_name() if type(film) is mi.Film else type(film).__name__
            raise TypeError(f"film = {name}: must be {allowed}, or a film with its interface")
        self.film = film
        self.exposure = exposure
        self.not_finite = (
            0  # Number of contributions that were dropped because they were not finite
        )
        self.splats: Splats | None = None

    @property
    def image(self) -> mi.Film:
        """The image of the samples."""
        return self.film

    def prepare(self) -> None:
        """Clear the film."""
        self.film.prepare([])

    def require_memory(self, spp: int) -> None:
        """Raise a `MemoryError` if a film with `spp` samples per pixel cannot be developed."""

    def require_no_lengths(self, integrator: str) -> None:
        """Raise a TypeError: the film needs path lengths, and `sample()` does not report any."""
        raise TypeError(
            f"integrator = {integrator}: its own sample() does not report path lengths. "
            f"Use a steady film instead of {self.film.class_name()}, or another integrator"
        )

    def measurement(self, camera: CameraRays, spp: int) -> Radiance:
        """Create the measurement of camera rays. Its `total` is the color of the picture."""
        return Radiance.zero(self.splat(camera, spp))

    def splat(self, camera: CameraRays, spp: int) -> Splat | None:
        """Return a function that adds splats to the picture, None for renders without splats."""
        if self.splats is None:
            return None
        splats = self.splats
        weight = camera.weight / spp

        def add(spectra: list[mi.Spectrum], position: mi.Point2f, active: mi.Bool) -> None:
            """Add the spectra of all images at a position on the film [pixels]."""
            lights = [scaled(each, weight) for each in spectra]
            values = [channels_of(each, camera.ray.wavelengths) for each in lights]
            splats.add(position, values, 0, active)

        return add

    def splatted(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the sums of splats, for channels before and after the image's weight channel."""
        first = self._splatted[:, :, 0]
        colors = self._splatted.shape[3] // stokes_count()
        return first[:, :, :colors], first[:, :, colors:]

    def channels(self, camera: CameraRays, measured: Radiance, valid_ray: mi.Bool) -> Channels:
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

    def begin(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Prepare for samples.

        Args:
            spp: Number of samples per pixel.
            splats: Whether measurements add contributions at positions of their own.
            apart: Whether kernels that add splats do not add samples. This saves memory.
        """
        self.splats = Splats(self.film, self.splat_images) if splats else None
        self._splatted = self._in_picture = np.zeros(())

    def update_image(self, taken: int, spp: int) -> None:
        """Add splats to the picture, scaled for `taken` of `spp` samples per pixel."""
        if self.splats is None:
            return

        # Accumulate in double precision, because single precision loses small addends
        self._splatted = self._splatted + np.array(self.splats.cells.tensor(), dtype=float)
        self.splats.cells.scale(0.0)

        # Arrange the splats in the channels of the image
        color, rest = self.splatted()
        raw = np.array(self.image.develop(raw=True))
        count = color_count(self.image)
        weight = raw[:, :, count : count + 1]
        splats = np.zeros_like(raw)
        splats[:, :, :3] = color
        if rest.shape[2]:
            splats[:, :, count + 1 :] = rest

        # `develop` divides by the weights of samples, but splats are already normalized
        splats *= weight * (spp / taken)

        # Add the difference to the splats that are already in the picture
        added = mi.TensorXf(splats - self._in_picture)
        self.image.put_block(mi.ImageBlock(added, self.image.crop_offset()))
        self._in_picture = splats

    def set_one_writer(self, one_writer: bool) -> None:
        """Set whether only one thread writes to each pixel in the next kernel."""

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Move the sums of some pixels or of all pixels to a second array.

        This avoids that single precision loses small addends.
        """

    def state(self) -> dict[str, np.ndarray]:
        """Return the film's content for a checkpoint, as arrays that may share memory with it."""
        picture = np.array(self.image.develop(raw=True))
        state = {"picture": picture, "not_finite": np.array(self.not_finite)}
        if self.splats is not None:
            state |= {"splatted": self._splatted, "in_picture": self._in_picture}
        return state

    def restore(self, state: Mapping[str, np.ndarray], taken: int, of: int, spp: int) -> None:
        """Restore the film's content from a `state`, after `begin`.

        Args:
            state: The state.
            taken: Samples per pixel that the state contains.
            of: Planned samples per pixel of the render that stored the state.
            spp: Planned samples per pixel of this render.
        """
        picture = mi.TensorXf(state["picture"])
        self.image.put_block(mi.ImageBlock(picture, self.image.crop_offset()))
        self.not_finite = int(state["not_finite"])
        if "splatted" in state:
            self._splatted = state["splatted"] * (of / spp)
            self._in_picture = state["in_picture"]
        self.update_image(taken, spp)


class PictureRecording(Recording):
    """Recording of a steady picture of all light, or of light weighted by path length."""

    kind = PICTURE

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        super().__init__(film, exposure)
        if exposure.steady_film_error:
            raise ValueError(exposure.steady_film_error)
        self.weight = exposure.weight
        self.emitters_apart = exposure.weight is not None

    def prepare(self) -> None:
        """Clear the film, and add channels for Stokes components in polarized variants."""
        self.film.prepare(stokes_channels())

    def require_no_lengths(self, integrator: str) -> None:
        """Accept any integrator, because a steady picture does not need path lengths."""

    def measurement(self, camera: CameraRays, spp: int) -> Radiance:
        """Create the sum of light, weighted by path length if the exposure has a weight."""
        splat = self.splat(camera, spp)
        return Radiance.zero(splat) if self.weight is None else Weighted.zero(self.weight, splat)


class BinRecording(Recording):
    """Recording of time bins, with the light's pulse convolved with the temporal filter."""

    kind = BINS
    emitters_apart = True

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

    def measurement(self, camera: CameraRays, spp: int) -> TimeBins:
        """Create the measurement of the bins."""
        splat = self.splat(camera, spp)
        return TimeBins.of_film(
            self.film, camera, spp, self.profile, self.exposure.at_centers, splat
        )

    def begin(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Prepare the film for `spp` samples per pixel, with or without splats."""
        super().begin(spp, splats, apart)
        self.film.samples_per_pixel = spp
        if splats:
            self.film.expect_splats(apart)

    def set_one_writer(self, one_writer: bool) -> None:
        """Set whether only one thread writes to each pixel in the next kernel."""
        self.film.one_writer_per_pixel = one_writer and self.film.rfilter().is_box_filter()

    def update_image(self, taken: int, spp: int) -> None:
        """Add splats to the picture, scaled for `taken` of `spp` samples per pixel."""
        super().update_image(taken, spp)
        self.film.taken = taken / spp

    def state(self) -> dict[str, np.ndarray]:
        """Return the content of picture and bins."""
        return super().state() | self.film.state()

    def restore(self, state: Mapping[str, np.ndarray], taken: int, of: int, spp: int) -> None:
        """Restore picture and bins."""
        self.film.restore(state, of / spp)
        super().restore(state, taken, of, spp)

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Flush the bins."""
        self.film.flush(pixels)


class MitransientRecording(BinRecording):
    """Recording of time bins on mitransient's film, without splats, checkpoints and flushing."""

    emitters_apart = False  # Pixels of visible emitters would need flushing

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

    def begin(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Prepare the film for `spp` samples per pixel. Raise an error for splats."""
        if splats:
            raise TypeError(
                f"{self._named(self.film)}: light tracing is not supported. {USE_OUR_FILM}"
            )
        super().begin(spp)

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Do nothing, because mitransient's film does not support flushing."""


class PhasorRecording(Recording):
    """Recording of phasors, multiplied by the Fourier transform of the light's pulse."""

    kind = PHASORS
    emitters_apart = True

    def prepare(self) -> None:
        """Clear the film. Raise an error for a film that does not fit into memory."""
        self.require_memory(1)
        super().prepare()

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

    def measurement(self, camera: CameraRays, spp: int) -> PhasorSum:
        """Create the sums of phasors."""
        return PhasorSum.zero(self.film.frequencies_hz, self.splat(camera, spp))

    @property
    def splat_images(self) -> int:
        """Number of images: one for all light, and two for each frequency."""
        return 1 + 2 * len(self.film.frequencies_hz)

    def splatted(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the sums of splats: colors, and phasors multiplied by the film's factors."""
        # Multiply the phasors by the film's factors
        sums = self._splatted
        n = len(self.film.frequencies_hz)
        phasors = sums[:, :, 1 : n + 1] + 1j * sums[:, :, n + 1 :]
        phasors = phasors * self.film.factors(self.exposure.pulse)[:, None]

        # Append the phasors to the other channels
        parts = np.stack([phasors.real, phasors.imag], axis=3)
        first, rest = super().splatted()
        return first, np.concatenate([rest, parts.reshape(*sums.shape[:2], -1)], axis=2)

    def channels(self, camera: CameraRays, measured: Radiance, valid_ray: mi.Bool) -> Channels:
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
