"""Light that a render has added to a film: splats, flushing, and states for checkpoints."""

from __future__ import annotations

from collections.abc import Callable

import mitsuba as mi
import numpy as np

from ..runtime.checkpoints import SavedState
from ..signals.polarization import stokes_count
from .channels import color_count
from .splats import Splats

Arrange = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function that converts sums of splats, an array (height, width, images, channels), to the
channels before the image's weight channel and the channels after it.
"""


def first_image(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the channels of the first image of splats, before and after the weight channel."""
    first = sums[:, :, 0]
    colors = sums.shape[3] // stokes_count()
    return first[:, :, :colors], first[:, :, colors:]


class Accumulation:
    """Light that a render has added to the image of a film so far.

    An accumulation can be stored, and restored when the render is resumed.

    Args:
        film: The film.
        image: The image of the samples. Films with time bins have a separate image.
        spp: Planned number of samples per pixel. All contributions of splats and bins are divided
            by this number.
        splats: Splats of the image, None for renders without splats.
        arrange: Function that arranges sums of splats in the channels of the image.
    """

    def __init__(
        self,
        film: mi.Film,
        image: mi.Film,
        spp: int,
        splats: Splats | None = None,
        arrange: Arrange = first_image,
    ) -> None:
        self.film = film
        self.image = image
        self.spp = spp
        self.splats = splats
        self.arrange = arrange

        # Number of contributions that were dropped because they were not finite
        self.not_finite = 0

        # Sums of splats in double precision, and the splats that the image contains already
        self._splatted = np.zeros(())
        self._in_image = np.zeros(())

    def sample_weight(self, weight: mi.UnpolarizedSpectrum) -> mi.UnpolarizedSpectrum:
        """Return the weight of a camera ray, divided by the number of samples per pixel."""
        return weight / self.spp

    def update_image(self, taken: int) -> None:
        """Add splats to the image, after `taken` samples per pixel."""
        if self.splats is None:
            return

        # Accumulate in double precision, because single precision loses small addends
        self._splatted = self._splatted + np.array(self.splats.cells.tensor(), dtype=float)
        self.splats.cells.scale(0.0)

        # Arrange the splats in the channels of the image
        color, rest = self.arrange(self._splatted)
        raw = np.array(self.image.develop(raw=True))
        count = color_count(self.image)
        weight = raw[:, :, count : count + 1]
        splats = np.zeros_like(raw)
        splats[:, :, :3] = color
        if rest.shape[2]:
            splats[:, :, count + 1 :] = rest

        # `develop` divides by the weights of samples, but splats are already normalized
        splats *= weight * (self.spp / taken)

        # Add the difference to the splats that are already in the image
        added = mi.TensorXf(splats - self._in_image)
        self.image.put_block(mi.ImageBlock(added, self.image.crop_offset()))
        self._in_image = splats

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Move the sums of some pixels or of all pixels to a second array.

        This avoids that single precision loses small addends. Images do not need it.
        """

    def state(self) -> dict[str, np.ndarray]:
        """Return the content for a checkpoint, as arrays that may share memory with the film."""
        picture = np.array(self.image.develop(raw=True))
        state = {"picture": picture, "not_finite": np.array(self.not_finite)}
        if self.splats is not None:
            state |= {"splatted": self._splatted, "in_picture": self._in_image}
        return state

    def restore(self, saved: SavedState) -> None:
        """Restore the content from the arrays of a `state`, into an empty film.

        The render that stored the state may have had another planned number of samples per pixel.
        """
        state = saved.arrays
        picture = mi.TensorXf(state["picture"])
        self.image.put_block(mi.ImageBlock(picture, self.image.crop_offset()))
        self.not_finite = int(state["not_finite"])
        if "splatted" in state:
            self._splatted = state["splatted"] * (saved.of / self.spp)
            self._in_image = state["in_picture"]
        self.update_image(saved.done)


class BinAccumulation(Accumulation):
    """Light that a render has added to a `transient_hdr_film`: its image and its time bins."""

    def update_image(self, taken: int) -> None:
        """Add splats to the image, and give the number of samples to the film."""
        super().update_image(taken)
        self.film.count_samples(taken, self.spp)

    def flush(self, pixels: mi.UInt32 | None = None) -> None:
        """Flush the bins."""
        self.film.flush(pixels)

    def state(self) -> dict[str, np.ndarray]:
        """Return the content of image and bins."""
        return super().state() | self.film.state()

    def restore(self, saved: SavedState) -> None:
        """Restore image and bins."""
        self.film.restore(saved.arrays, saved.of / self.spp)
        super().restore(saved)
