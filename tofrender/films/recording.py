"""Recordings of light on each kind of film: the only place that tells films apart.

| recording | film | measures |
|---|---|---|
| `BinRecording` | `transient_hdr_film` | the energy of each time bin |
| `MitransientRecording` | mitransient's film of this name | the same, with fewer abilities |
| `PhasorRecording` | `phasor_hdr_film` | phasors |
| `PictureRecording` | any other | one weighted sum |

A film names its recording by a method `recording(exposure)`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import memory
from ..signals.polarisation import components, scaled, stokes_count
from .colours import channels_of, colour_count, kept, to_rgb
from .contribution import CameraRays
from .exposure import BINS, PHASORS, PICTURE, Exposure, Weight, profile
from .histogram import MAX_ADDED
from .image import require_resolved, stokes_channels
from .phasor_sum import PhasorSum
from .splats import Splats
from .sums import Radiance, Splat, Weighted
from .time_bins import TimeBins

Channels = tuple[list[mi.Float], list[mi.Float]]
PHASOR_COPIES = 9.0  # Peak memory of phasor images and of what is computed from them, in images
ONLY_OURS = f"must be this package's {BINS}"


def recording(film: mi.Film, exposure: Exposure) -> Recording:
    """Return the recording of an exposure on a film; what makes no sense there is refused."""
    if hasattr(film, "recording"):
        return film.recording(exposure)
    if hasattr(film, "add_transient_data"):
        return MitransientRecording(film, exposure)
    return PictureRecording(film, exposure)


def warn_not_finite(count: int, stacklevel: int = 4) -> None:
    """Warn of contributions that were dropped because they were not finite."""
    if count:
        warnings.warn(
            f"{count} contributions of paths were not finite and left out; a light, a material or "
            "a texture of the scene is",
            stacklevel=stacklevel,
        )


class Recording:
    """Writes light into a film.

    `steps` calls `prepare` and `begin`, and `restore` to go on from a checkpoint. For each step it
    calls `set_one_writer`, then `measurement` and `channels` of all samples, and `update_image`;
    `flush` from time to time.
    """

    kind: str | None = None  # What the exposure must support
    emitters_apart = False  # Whether pixels that see emitters have more samples
    weight: Weight | None = None  # By length, None if light of any length counts alike
    width_opl: float | None = None  # Length that the film resolves [m]; None without time bins
    splat_images = 1  # Images that splats go to, colours counted as one
    needs_rates = False  # Whether contributions must have rates of change

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        if self.kind is not None and self.kind not in exposure.onto:
            allowed = " or ".join(exposure.onto)
            name = film.class_name() if type(film) is mi.Film else type(film).__name__
            raise TypeError(f"film = {name}: must be {allowed}, or a film like it")
        self.film, self.exposure = film, exposure
        self.not_finite = 0  # Contributions that were dropped because they were not finite
        self.splats: Splats | None = None

    @property
    def image(self) -> mi.Film:
        """The image that samples are added to."""
        return self.film

    def prepare(self) -> None:
        """Clear the film."""
        self.film.prepare([])

    def require_memory(self, spp: int) -> None:
        """Raise a `MemoryError` if a film of `spp` samples per pixel cannot be developed."""

    def require_no_lengths(self, integrator: str) -> None:
        """Raise a `TypeError` if the film needs path lengths, which a `sample` does not tell."""
        raise TypeError(
            f"integrator = {integrator}: has a sample of its own, which tells no path lengths; "
            f"must have none on a film with time, here a {self.film.class_name()}"
        )

    def measurement(self, camera: CameraRays, spp: int) -> Radiance:
        """Create the measurement of camera rays; its `total` is the picture's colour."""
        return Radiance.zero(self.splat(camera, spp))

    def splat(self, camera: CameraRays, spp: int) -> Splat | None:
        """Return a function that adds splats to the picture, None if there are none."""
        if self.splats is None:
            return None
        splats, weight = self.splats, camera.weight / spp

        def add(spectra: list[mi.Spectrum], position: mi.Point2f, active: mi.Bool) -> None:
            lights = [scaled(each, weight) for each in spectra]
            values = [channels_of(each, camera.ray.wavelengths) for each in lights]
            splats.add(position, values, 0, active)

        return add

    def splatted(self) -> tuple[np.ndarray, np.ndarray]:
        """Return splats so far, for channels before the image's weight channel, and after it."""
        first, colours = self._splatted[:, :, 0], self._splatted.shape[3] // stokes_count()
        return first[:, :, :colours], first[:, :, colours:]

    def channels(self, camera: CameraRays, measured: Radiance, valid_ray: mi.Bool) -> Channels:
        """Return the channels of samples before the image's weight channel, and those after it."""
        light = components(scaled(measured.total, camera.weight))
        colour, *rest = (to_rgb(each, camera.ray.wavelengths) for each in light)
        first = [colour.x, colour.y, colour.z]
        if mi.has_flag(self.image.flags(), mi.FilmFlags.Alpha):
            first.append(dr.select(valid_ray, mi.Float(1), mi.Float(0)))
        return first, [value for each in rest for value in kept(each)]

    def begin(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Prepare for samples.

        With `splats`, measurements add contributions that have a position. If these are `apart`,
        kernels that add splats add no samples, which saves memory.
        """
        self.splats = Splats(self.film, self.splat_images) if splats else None
        self._splatted = self._in_picture = np.zeros(())

    def update_image(self, taken: int, spp: int) -> None:
        """Add splats to the picture, after `taken` of `spp` samples per pixel."""
        if self.splats is None:
            return
        # Accumulate in double precision, since single precision loses small addends
        self._splatted = self._splatted + np.array(self.splats.cells.tensor(), dtype=float)
        self.splats.cells.scale(0.0)
        colour, rest = self.splatted()
        raw = np.array(self.image.develop(raw=True))
        count = colour_count(self.image)
        weight = raw[:, :, count : count + 1]
        splats = np.zeros_like(raw)
        splats[:, :, :3] = colour
        if rest.shape[2]:
            splats[:, :, count + 1 :] = rest
        # `develop` divides by the samples' weights, of which splats have none
        splats *= weight * (spp / taken)
        added = mi.TensorXf(splats - self._in_picture)
        self.image.put_block(mi.ImageBlock(added, self.image.crop_offset()))
        self._in_picture = splats

    def set_one_writer(self, one_writer: bool) -> None:
        """Set whether only one thread writes to each pixel in the next kernel."""

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Flush sums, of some pixels or all, since single precision loses small addends."""

    def state(self) -> dict[str, np.ndarray]:
        """Return the film's content for a checkpoint, as arrays that may share its memory."""
        picture = np.array(self.image.develop(raw=True))
        state = {"picture": picture, "not_finite": np.array(self.not_finite)}
        if self.splats is not None:
            state |= {"splatted": self._splatted, "in_picture": self._in_picture}
        return state

    def restore(self, state: Mapping[str, np.ndarray], taken: int, of: int, spp: int) -> None:
        """Restore a `state` of `taken` out of `of` samples per pixel, `spp` now, after `begin`."""
        picture = mi.TensorXf(state["picture"])
        self.image.put_block(mi.ImageBlock(picture, self.image.crop_offset()))
        self.not_finite = int(state["not_finite"])
        if "splatted" in state:
            self._splatted, self._in_picture = state["splatted"] * (of / spp), state["in_picture"]
        self.update_image(taken, spp)


class PictureRecording(Recording):
    """Records a steady picture of all light, or of light weighted by its length."""

    kind = PICTURE

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        super().__init__(film, exposure)
        if exposure.lacks:
            raise ValueError(exposure.lacks)
        self.weight, self.emitters_apart = exposure.weight, exposure.weight is not None

    def prepare(self) -> None:
        """Clear the film; polarised light has channels behind its colours."""
        self.film.prepare(stokes_channels())

    def require_no_lengths(self, integrator: str) -> None:
        """Accept any integrator: an image needs no lengths."""

    def measurement(self, camera: CameraRays, spp: int) -> Radiance:
        """Create the sum, weighted if the exposure is."""
        splat = self.splat(camera, spp)
        return Radiance.zero(splat) if self.weight is None else Weighted.zero(self.weight, splat)


class BinRecording(Recording):
    """Records time bins. The light's pulse is seen through the temporal filter."""

    kind, emitters_apart = BINS, True

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        super().__init__(film, exposure)
        require_resolved(film)
        pulse = exposure.pulse
        if pulse is not None and not (hasattr(pulse, "support") and hasattr(pulse, "eval")):
            raise TypeError(
                f"pulse = {type(pulse).__name__}: must have eval, cdf and support on a film with "
                "time, like GaussianPulse(0.03)"
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
        """Refuse where bins, flushed bins, and the result of `develop` do not fit together."""
        shape = self.film.shape
        copies = 2 if spp > MAX_ADDED else 1
        memory.require_film(*shape, copies=copies + shape[3] / memory.stride(shape[3]))

    def measurement(self, camera: CameraRays, spp: int) -> TimeBins:
        """Create the measurement of the bins."""
        at_centres, splat = self.exposure.at_centres, self.splat(camera, spp)
        return TimeBins.of_film(self.film, camera, spp, self.profile, at_centres, splat)

    def begin(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Prepare the film for samples."""
        super().begin(spp, splats, apart)
        self.film.samples_per_pixel = spp
        if splats:
            self.film.expect_splats(apart)

    def set_one_writer(self, one_writer: bool) -> None:
        """Set whether only one thread writes to each pixel in the next kernel."""
        self.film.one_writer_per_pixel = one_writer and self.film.rfilter().is_box_filter()

    def update_image(self, taken: int, spp: int) -> None:
        """Add splats to the picture, after `taken` of `spp` samples per pixel."""
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
    """Records time bins of mitransient's film: without splats, checkpoints and flushing."""

    emitters_apart = False  # Pixels of visible emitters would have to be flushed

    def __init__(self, film: mi.Film, exposure: Exposure) -> None:
        if mi.is_polarized:
            raise TypeError(f"{self._named(film)}: has no frames of polarised light; {ONLY_OURS}")
        super().__init__(film, exposure)

    @staticmethod
    def _named(film: mi.Film) -> str:
        return f"film = {type(film).__module__}.{type(film).__name__}"

    def require_memory(self, spp: int) -> None:
        """Accept any film: its memory is not known."""

    def begin(self, spp: int, splats: bool = False, apart: bool = False) -> None:
        """Prepare for samples, without splats."""
        if splats:
            raise TypeError(
                f"{self._named(self.film)}: takes no light that lands on any pixel; {ONLY_OURS}"
            )
        super().begin(spp)

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Do nothing."""


class PhasorRecording(Recording):
    """Records phasors, path by path, multiplied by the Fourier transform of the light's pulse."""

    kind, emitters_apart = PHASORS, True

    def prepare(self) -> None:
        """Clear the film; a film that does not fit into memory is refused."""
        self.require_memory(1)
        super().prepare()

    def require_memory(self, spp: int) -> None:
        """Refuse a film whose image and results do not fit."""
        width, height = (int(n) for n in self.film.crop_size())
        count = len(self.film.frequencies_hz)
        channels = (1 + 2 * count) * self.film.base_channels_count() * stokes_count() + 1
        what = f"film of {width} x {height} pixels x {count} frequencies"
        memory.require_array(what, width * height * channels, PHASOR_COPIES)

    @property
    def image(self) -> mi.Film:
        """The film's image, with the phasors behind its colours."""
        return self.film.steady

    def measurement(self, camera: CameraRays, spp: int) -> PhasorSum:
        """Create the phasors' sums."""
        return PhasorSum.zero(self.film.frequencies_hz, self.splat(camera, spp))

    @property
    def splat_images(self) -> int:
        """Number of images: that of all light, and two for each frequency."""
        return 1 + 2 * len(self.film.frequencies_hz)

    def splatted(self) -> tuple[np.ndarray, np.ndarray]:
        """Return splats so far: colours, and phasors multiplied by the film's factors."""
        sums = self._splatted
        n = len(self.film.frequencies_hz)
        phasors = sums[:, :, 1 : n + 1] + 1j * sums[:, :, n + 1 :]
        phasors = phasors * self.film.factors(self.exposure.pulse)[:, None]
        parts = np.stack([phasors.real, phasors.imag], axis=3)
        first, rest = super().splatted()
        return first, np.concatenate([rest, parts.reshape(*sums.shape[:2], -1)], axis=2)

    def channels(self, camera: CameraRays, measured: Radiance, valid_ray: mi.Bool) -> Channels:
        """Return the colour, and all phasors behind the weight, times the film's factors."""
        first, rest = super().channels(camera, measured, valid_ray)

        def colours(light: mi.Spectrum) -> list[mi.Color3f]:
            each_component = components(scaled(light, camera.weight))
            return [to_rgb(each, camera.ray.wavelengths) for each in each_component]

        for k, factor in enumerate(self.film.factors(self.exposure.pulse)):
            a, b = float(factor.real), float(factor.imag)
            both = list(zip(colours(measured.real[k]), colours(measured.imaginary[k]), strict=True))
            parts = [re * a - im * b for re, im in both] + [re * b + im * a for re, im in both]
            rest += [value for part in parts for value in kept(part)]
        return first, rest
