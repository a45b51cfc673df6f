"""Extra samples for pixels in which the camera sees an emitter directly.

Directly visible light falls into few time bins, and is most of a film's noise. It is left out of
the paths, and found by rays that end at their first surface. Their pixels are those that emitters'
bounding boxes project to: choosing them by samples would bias the means.
"""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np

from ..paths.camera import Tile, sampled_size
from ..paths.walk import add_emission
from ..paths.window import KINDS, Window
from .plan import Plan
from .user_defined import Tracer

MOST = 32  # Rays for each sample of a pixel
MARGIN = 0.01  # Added to the projection of an emitter's box on each side, for rounding [pixels]
MEAN_RATE = 0.5  # Rays per sample, on average over all pixels: a path has ten or more


class VisibleEmitters:
    """Rays that end at the first surface, in the pixels that may see an emitter there.

    Args:
        plan: The plan of the render; `rest` is that without these rays' light.
        pixels: Numbers of the pixels, row by row in the sampled area of the film.
        rate: Rays for each sample of such a pixel.
        splats: Whether their light is added as splats, for filters other than box: the sum of few
            samples' weights would make other rays too bright, 5 % with a sample per pixel.
    """

    def __init__(self, plan: Plan, pixels: np.ndarray, rate: int, splats: bool) -> None:
        self.plan, self.pixels, self.rate, self.splats = plan, pixels, rate, splats
        self.rest = plan.without_first_hit()

    @classmethod
    def of(
        cls, plan: Tracer, sensor: mi.Sensor, film: mi.Film, tile: Tile | None = None
    ) -> VisibleEmitters | None:
        """Return the rays for a film, or a tile of one.

        None if no emitter is in view, if emitters fill the picture, or if the camera projects no
        points onto pixels.
        """
        if not isinstance(plan, Plan) or sensor.class_name() not in KINDS:
            return None
        emitters = plan.visible_emitters()
        if not emitters:
            return None
        whole = film if tile is None else tile.whole
        pixels = pixels_of(emitters, sensor, whole)
        width, height = sampled_size(whole)
        rate = min(MOST, int(MEAN_RATE * width * height / max(pixels.size, 1)))
        if tile is not None:
            pixels = _within(pixels, width, film, tile)
        if not pixels.size or rate <= 1:
            return None
        # A power of two suits the point set, and the same for any number of samples resumed renders
        splats = not film.rfilter().is_box_filter()
        return cls(plan, pixels, 1 << (rate.bit_length() - 1), splats)

    @property
    def scene(self) -> mi.Scene:
        """The scene of the plan."""
        return self.plan.scene

    def trace(self, sampler, ray, origin, measurement, frame=None):
        """Add the emission that camera rays hit first."""
        plan = self.plan
        path = plan.start(plan.endpoint, ray, origin, True, frame)
        path, vertex = plan.space.next_vertex(path, sampler)
        path.active &= vertex.valid  # What is behind the scene is left to the paths
        path = add_emission(path, vertex, plan, measurement)
        return measurement, path


def pixels_of(emitters: Sequence[mi.Emitter], sensor: mi.Sensor, film: mi.Film) -> np.ndarray:
    """Return the pixels that may see one of some emitters, all if one is beside the camera."""
    width, height = sampled_size(film)
    window = Window(sensor)
    first = np.ravel(np.array(window.first))
    chosen = np.zeros((height, width), dtype=bool)
    for emitter in emitters:
        box = emitter.bbox()
        bounds = window.pixels_of(np.array(box.min, float), np.array(box.max, float))
        if bounds is None:
            return np.arange(width * height)
        low, high = np.floor(bounds[0] - first - MARGIN), np.ceil(bounds[1] - first + MARGIN)
        left, top = (int(n) for n in np.clip(low, 0, (width, height)))
        right, bottom = (int(n) for n in np.clip(high, 0, (width, height)))
        chosen[top:bottom, left:right] = True
    return np.flatnonzero(chosen)


def _within(pixels: np.ndarray, width: int, film: mi.Film, tile: Tile) -> np.ndarray:
    """Select a film's pixels that are in a tile, with their numbers in the tile."""
    own_width, own_height = sampled_size(film)
    y, x = np.divmod(pixels, width)
    x, y = x - tile.x, y - tile.y
    inside = (x >= 0) & (x < own_width) & (y >= 0) & (y < own_height)
    return (y * own_width + x)[inside]
