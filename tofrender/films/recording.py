"""What each kind of film makes of light: the only place that tells films apart.

| recording | film | measures |
|---|---|---|
| `BinRecording` | `transient_hdr_film`, mitransient's as well | the energy of each time bin |
| `PhasorRecording` | `phasor_hdr_film` | phasors |
| `PictureRecording` | any other | one weighted sum |

A film of your own says by a method `recording(exposure)` which is its.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import memory
from ..signals.polarisation import components, scaled, stokes_count
from .cells import MAX_ADDED
from .colours import channels_of, colour_count, kept, to_rgb
from .deposit import FilmDeposit, open_gates, spread
from .exposure import BINS, PHASORS, PICTURE, Exposure, Weight, profile
from .image import require_resolved, stokes_channels
from .phasor_sum import PhasorSum
from .splats import Splats
from .sums import Land, Radiance, Weighted


def recording(film: Any, exposure: Exposure) -> Recording:
    """The recording of an exposure on a film.

    Raises:
        TypeError: The film is of a kind that the exposure makes no sense on; one line.
        ValueError: The exposure lacks something, or does not fit the film's filter; one line.
    """
    if hasattr(film, "recording"):
        return film.recording(exposure)
    if hasattr(film, "frequencies_hz"):
        found: type[Recording] = PhasorRecording
    else:
        found = BinRecording if hasattr(film, "add_transient_data") else PictureRecording
    if found.kind not in exposure.onto:
        allowed = " or ".join(exposure.onto)
        kind = film.class_name() if type(film) is mi.Film else type(film).__name__
        raise TypeError(f"film = {kind}: must be {allowed}, or a film like it")
    return found(film, exposure)


def tell_not_finite(count: int, stacklevel: int = 4) -> None:
    """Warn of contributions that were left out, who called whatever has rendered."""
    if count:
        warnings.warn(
            f"{count} contributions of paths were not finite and left out; a light, a material or "
            "a texture of the scene is",
            stacklevel=stacklevel,
        )


class Recording:
    """A film under exposure.

    Attributes:
        not_finite: Contributions that were left out because they were not finite.
    """

    kind = PICTURE

    def __init__(self, film: Any, exposure: Exposure) -> None:
        self.film, self.exposure = film, exposure
        self.not_finite = 0
        self.splats: Any = None

    @property
    def pictures(self) -> int:
        """Number of pictures that the film has, colours counted as one."""
        return 1

    @property
    def image(self) -> Any:
        """The film's picture, which takes samples."""
        return self.film

    @property
    def weight(self) -> Weight | None:
        """The weight by length that all light counts by; None if light of any length counts."""
        return None

    @property
    def in_time(self) -> bool:
        """Whether light counts by its length."""
        return self.weight is not None

    @property
    def width_opl(self) -> float | None:
        """Length by which the film tells arrivals apart [m]; None if it has no time bins."""
        return None

    def prepare(self) -> None:
        """Empty the film."""
        self.film.prepare([])

    def require_memory(self, spp: int) -> None:
        """Refuse to develop what does not fit into memory.

        Args:
            spp: Samples per pixel.

        Raises:
            MemoryError: One line with what it takes and what there is.
        """

    def require_no_lengths(self, integrator: str) -> None:
        """Refuse an integrator that tells what a ray sees and not how long its paths are.

        Raises:
            TypeError: The film needs lengths; one line.
        """
        raise TypeError(
            f"integrator = {integrator}: has a sample of its own, which tells no path lengths; "
            f"must have none on a film with time, here a {self.film.class_name()}"
        )

    def measurement(self, camera: Any, spp: int) -> Any:
        """What is done with the light of camera rays; its `total` is the picture's colour."""
        return Radiance.zero(self.land(camera, spp))

    def land(self, camera: Any, spp: int) -> Land | None:
        """What is done with light that lands on any pixel of the picture."""
        if self.splats is None:
            return None
        splats, weight = self.splats, camera.weight / spp

        def land(spectra: list[Any], position: mi.Point2f, active: mi.Bool) -> None:
            lights = [scaled(each, weight) for each in spectra]
            values: Any = [channels_of(each, camera.ray.wavelengths) for each in lights]
            splats.add(position, values, 0, active)

        return land

    def landed(self) -> tuple[Any, Any]:
        """Splats so far, for the picture's colours and for the channels behind its weight."""
        first, colours = self._landed[:, :, 0], self._landed.shape[3] // stokes_count()
        return first[:, :, :colours], first[:, :, colours:]

    def channels(self, camera: Any, measured: Any, valid_ray: mi.Bool) -> tuple[list, list]:
        """What samples put into the picture, before and behind their weight."""
        light = components(scaled(measured.total, camera.weight))
        colour, *rest = (to_rgb(each, camera.ray.wavelengths) for each in light)
        first: list[Any] = [colour.x, colour.y, colour.z]
        if mi.has_flag(self.image.flags(), mi.FilmFlags.Alpha):
            first.append(dr.select(valid_ray, mi.Float(1), mi.Float(0)))
        return first, [value for each in rest for value in kept(each)]

    def begin(self, spp: int, one_writer: bool, splats: bool = False) -> None:
        """Say what comes.

        Args:
            spp: Number of samples per pixel.
            one_writer: Whether one thread alone writes to a pixel.
            splats: Whether light lands on any pixel, besides what camera rays bring.
        """
        self.splats = Splats(self.film, self.pictures) if splats else None
        self._landed: Any = 0.0
        self._in_picture: Any = 0.0

    def reach(self, taken: int, spp: int) -> None:
        """Say how many samples per pixel were taken so far: the picture then has all splats."""
        if self.splats is None:
            return
        # Put aside in double precision, so that single precision loses no small addends
        self._landed = self._landed + np.array(self.splats.cells.tensor(), dtype=float)
        self.splats.cells.scale(0.0)
        colour, rest = self.landed()
        raw = np.array(self.image.develop(raw=True))
        count = colour_count(self.image)
        weight = raw[:, :, count : count + 1]
        splats = np.zeros_like(raw)
        splats[:, :, :3] = colour
        if rest.shape[2]:
            splats[:, :, count + 1 :] = rest
        # A picture divides by its weights, which the splats' sums do not have
        splats *= weight * (spp / taken)
        added: Any = mi.TensorXf(splats - self._in_picture)
        self.image.put_block(mi.ImageBlock(added, self.image.crop_offset()))
        self._in_picture = splats

    def write(self, one_writer: bool) -> None:
        """Say whether one thread alone writes to a pixel in the next kernel."""

    def fold(self, pixels: mi.UInt32 | None = None) -> None:
        """Keep single precision from losing small addends, after many samples, of some pixels."""

    def state(self) -> dict[str, np.ndarray]:
        """All that the film has so far, as arrays that may share its memory."""
        state = {
            "picture": np.array(self.image.develop(raw=True)),
            "not_finite": np.array(self.not_finite),
        }
        if self.splats is not None:
            state |= {"landed": self._landed, "in_picture": self._in_picture}
        return state

    def restore(self, state: Mapping[str, np.ndarray], taken: int, of: int, spp: int) -> None:
        """Go on from what `state` gave after `taken` of `of` samples per pixel, `spp` of them now.

        The film was prepared and `begin` called.
        """
        picture: Any = mi.TensorXf(state["picture"])
        self.image.put_block(mi.ImageBlock(picture, self.image.crop_offset()))
        self.not_finite = int(state["not_finite"])
        if "landed" in state:
            self._landed, self._in_picture = state["landed"] * (of / spp), state["in_picture"]
        self.reach(taken, spp)


class PictureRecording(Recording):
    """A steady picture of all light, or of light weighted by its length."""

    def __init__(self, film: Any, exposure: Exposure) -> None:
        if exposure.lacks:
            raise ValueError(exposure.lacks)
        super().__init__(film, exposure)

    def prepare(self) -> None:
        """Empty the film; polarised light has channels behind its colours."""
        self.film.prepare(stokes_channels())

    def require_no_lengths(self, integrator: str) -> None:
        """A picture needs none."""

    @property
    def weight(self) -> Weight | None:
        """That of the exposure."""
        return self.exposure.weight

    def measurement(self, camera: Any, spp: int) -> Radiance | Weighted:
        """The sum, weighted if the exposure says so."""
        land = self.land(camera, spp)
        return Radiance.zero(land) if self.weight is None else Weighted.zero(self.weight, land)


class BinRecording(Recording):
    """Time bins. The light's pulse is seen through the temporal filter."""

    kind = BINS

    def __init__(self, film: Any, exposure: Exposure) -> None:
        super().__init__(film, exposure)
        require_resolved(film)
        if mi.is_polarized and not hasattr(film, "expect_splats"):
            kind = type(film)
            raise TypeError(
                f"film = {kind.__module__}.{kind.__name__}: has no frames of polarised light; must "
                f"be this package's {BINS}"
            )
        pulse = exposure.pulse
        if pulse is not None and not (hasattr(pulse, "support") and hasattr(pulse, "eval")):
            raise TypeError(
                f"pulse = {type(pulse).__name__}: must have eval, cdf and support on a film with "
                "time, like GaussianPulse(0.03)"
            )
        self.profile = profile(film, exposure)

    @property
    def in_time(self) -> bool:
        """Light does; of mitransient's film some pixels cannot be folded alone."""
        return hasattr(self.film, "fold")

    @property
    def image(self) -> Any:
        """The film's steady image."""
        return self.film.steady

    @property
    def width_opl(self) -> float:
        """Width of a bin, and half the length that pulse and filter reach over."""
        low, high = (0.0, 0.0) if self.profile is None else self.profile.support
        return float(self.film.bin_width_opl) + 0.5 * (high - low)

    def require_memory(self, spp: int) -> None:
        """Refuse where bins, those put aside, and what `develop` returns do not fit together."""
        shape = getattr(self.film, "shape", None)  # mitransient's film has none
        if shape is not None:
            copies = 2 if spp > MAX_ADDED else 1
            memory.require_film(*shape, copies=copies + shape[3] / memory.stride(shape[3]))

    def measurement(self, camera: Any, spp: int) -> FilmDeposit:
        """Deposits in the bins."""
        how = open_gates if self.exposure.at_centres else spread
        weight, wavelengths = camera.weight / spp, camera.ray.wavelengths
        position, land = camera.position, self.land(camera, spp)
        return FilmDeposit.into(self.film, position, wavelengths, weight, self.profile, how, land)

    def begin(self, spp: int, one_writer: bool, splats: bool = False) -> None:
        """Tell the film."""
        super().begin(spp, one_writer, splats)
        self.film.samples_per_pixel = spp
        self.write(one_writer)
        if splats:
            if not hasattr(self.film, "expect_splats"):
                kind = type(self.film)
                raise TypeError(
                    f"film = {kind.__module__}.{kind.__name__}: takes no light that lands on any "
                    f"pixel; must be this package's {BINS}"
                )
            self.film.expect_splats()

    def write(self, one_writer: bool) -> None:
        """Tell the film."""
        self.film.one_writer_per_pixel = one_writer and self.film.rfilter().is_box_filter()

    def reach(self, taken: int, spp: int) -> None:
        """Tell the film."""
        super().reach(taken, spp)
        self.film.taken = taken / spp

    def state(self) -> dict[str, np.ndarray]:
        """The bins too; mitransient's film cannot."""
        return super().state() | self.film.state()

    def restore(self, state: Mapping[str, np.ndarray], taken: int, of: int, spp: int) -> None:
        """The bins too."""
        self.film.restore(state, of / spp)
        super().restore(state, taken, of, spp)

    def fold(self, pixels: mi.UInt32 | None = None) -> None:
        """Put the bins aside; mitransient's film cannot."""
        if hasattr(self.film, "fold"):
            self.film.fold(pixels)


class PhasorRecording(Recording):
    """Phasors, path by path; the light's pulse multiplies them by its Fourier transform."""

    kind = PHASORS

    @property
    def in_time(self) -> bool:
        """Light does."""
        return True

    @property
    def image(self) -> Any:
        """The film's image, with the phasors behind its colours."""
        return self.film.steady

    def measurement(self, camera: Any, spp: int) -> PhasorSum:
        """The phasors of every path."""
        return PhasorSum.zero(self.film.frequencies_hz, self.land(camera, spp))

    @property
    def pictures(self) -> int:
        """That of all light, and two for each frequency."""
        return 1 + 2 * len(self.film.frequencies_hz)

    def landed(self) -> tuple[Any, Any]:
        """Splats so far: those of all light, and the phasors of the film's own phase and pulse."""
        sums = self._landed
        n = len(self.film.frequencies_hz)
        phasors = sums[:, :, 1 : n + 1] + 1j * sums[:, :, n + 1 :]
        phasors = phasors * self.film.factors(self.exposure.pulse)[:, None]
        parts = np.stack([phasors.real, phasors.imag], axis=3)
        first, rest = super().landed()
        return first, np.concatenate([rest, parts.reshape(*sums.shape[:2], -1)], axis=2)

    def channels(self, camera: Any, measured: PhasorSum, valid_ray: mi.Bool) -> tuple[list, list]:
        """The colour, and all phasors."""
        first, rest = super().channels(camera, measured, valid_ray)

        def colours(light: Any) -> list[mi.Color3f]:
            light = components(scaled(light, camera.weight))
            return [to_rgb(each, camera.ray.wavelengths) for each in light]

        return first, rest + self.film.channels(measured, colours, self.exposure.pulse)
