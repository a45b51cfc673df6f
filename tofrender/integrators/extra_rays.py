"""Extra rays in pixels in which the camera sees an emitter, directly or by delta lobes alone.

This light falls into few time bins, and is most of a film's noise. It is left out of the paths. The
extra rays find it in the pixels that the bounding boxes of emitters or of mirrors and clear glass
project to. Choosing the pixels by samples would bias the means.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Self

import mitsuba as mi
import numpy as np

from ..paths.camera import Tile, sampled_size
from ..paths.endpoints import EmitterHits, SceneLights
from ..paths.kinds import Kind
from ..paths.scattering import Materials
from ..paths.space import Vacuum
from ..paths.walk import add_emission
from ..paths.window import KINDS, Window
from .plan import Plan
from .user_defined import Tracer

MARGIN = 0.01  # Added to the projection of a box on each side, for rounding [pixels]


class ExtraRays:
    """Abstract base of rays for one kind of paths, in the pixels that may see such paths.

    Args:
        plan: The plan of the render; `rest` is that without these rays' light.
        sensor: The sensor of the render.
        pixels: Numbers of the pixels, row by row in the sampled area of the film.
        rate: Rays for each sample of such a pixel.
        splats: Whether their light is added as splats, for filters other than box: the sum of few
            samples' weights would make other rays too bright, 5 % with a sample per pixel.
    """

    kind: ClassVar[Kind]  # the kind of paths
    most: ClassVar[int]  # rays for each sample of a pixel, at most
    mean_rate: ClassVar[float]  # rays per sample, on average over all pixels: a path has ten

    def __init__(
        self, plan: Plan, sensor: mi.Sensor, pixels: np.ndarray, rate: int, splats: bool
    ) -> None:
        self.plan, self.pixels, self.rate, self.splats = plan, pixels, rate, splats
        self.remaining_plan = plan.without(self.kind)

    @classmethod
    def boxes(cls, plan: Plan) -> Sequence[mi.ScalarBoundingBox3f]:
        """Return the boxes around all that these paths meet first."""
        raise NotImplementedError

    @classmethod
    def of(
        cls, plan: Tracer, sensor: mi.Sensor, film: mi.Film, tile: Tile | None = None
    ) -> Self | None:
        """Return the rays for a film, or a tile of one.

        None if no such path is in view, if they fill the picture, or if the camera projects no
        points onto pixels.
        """
        if not isinstance(plan, Plan) or sensor.class_name() not in KINDS:
            return None
        boxes = cls.boxes(plan)
        if not boxes:
            return None
        whole = film if tile is None else tile.whole
        pixels = pixels_of(boxes, sensor, whole)
        width, height = sampled_size(whole)
        rate = min(cls.most, int(cls.mean_rate * width * height / max(pixels.size, 1)))
        if tile is not None:
            pixels = _within(pixels, width, film, tile)
        if not pixels.size or rate <= 1:
            return None
        # A power of two suits the point set, and the same for any number of samples resumed renders
        splats = not film.rfilter().is_box_filter()
        return cls(plan, sensor, pixels, 1 << (rate.bit_length() - 1), splats)

    @property
    def scene(self) -> mi.Scene:
        """The scene of the plan."""
        return self.plan.scene

    def trace(self, sampler, ray, origin, measurement, frame=None):
        """Add the light of these paths along camera rays."""
        raise NotImplementedError


class VisibleEmitters(ExtraRays):
    """Rays that end at the first surface, in the pixels that may see an emitter there."""

    kind, most, mean_rate = Kind.VISIBLE, 32, 0.5

    @classmethod
    def boxes(cls, plan: Plan) -> Sequence[mi.ScalarBoundingBox3f]:
        """Return the boxes around the emitters."""
        return [emitter.bbox() for emitter in plan.visible_emitters()]

    def trace(self, sampler, ray, origin, measurement, frame=None):
        """Add the emission that camera rays hit first."""
        plan = self.plan
        path = plan.start(plan.endpoint, ray, origin, True, frame)
        path, vertex = plan.space.next_vertex(path, sampler)
        path.active &= vertex.valid  # What is behind the scene is left to the paths
        path = add_emission(path, vertex, plan, measurement)
        return measurement, path


class DeltaChains(ExtraRays):
    """Rays that follow delta lobes alone, in the pixels that may see a mirror or clear glass."""

    kind, most, mean_rate = Kind.CHAIN, 4, 1.0

    def __init__(
        self, plan: Plan, sensor: mi.Sensor, pixels: np.ndarray, rate: int, splats: bool
    ) -> None:
        super().__init__(plan, sensor, pixels, rate, splats)
        emitters = EmitterHits(plan.scene, sensor, plan.endpoint.hide_emitters)
        self.chains = plan.with_endpoint(emitters)
        self.chains.scattering = Materials(plan.scene, lobes=mi.BSDFFlags.Delta)
        self.chains = self.chains.without(*(set(Kind) - {Kind.CHAIN}))
        self.chains.limits.min_depth = max(plan.limits.min_depth, 2)  # no emitter at once
        self.chains.caustic_rays = None

    @classmethod
    def boxes(cls, plan: Plan) -> Sequence[mi.ScalarBoundingBox3f]:
        """Return the boxes around the shapes with delta lobes, none if chains are not supported."""
        supported = (
            plan.techniques.chain_rays
            and type(plan.scattering) is Materials
            and type(plan.space) is Vacuum
            and isinstance(plan.endpoint, SceneLights)
            and not (plan.limits.bounded and plan.limits.max_depth < 2)
        )
        if not supported:
            return ()
        return [shape.bbox() for shape in plan.scene.shapes() if _has_delta_lobe(shape)]

    def trace(self, sampler, ray, origin, measurement, frame=None):
        """Add the emission that camera rays hit by delta lobes."""
        return self.chains.trace(sampler, ray, origin, measurement, frame=frame)


def _has_delta_lobe(shape: mi.Shape) -> bool:
    """Whether a shape may have a delta lobe; instances, whose BSDFs are not known, may."""
    bsdf = shape.bsdf()
    return bsdf is None or mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)


def pixels_of(
    boxes: Sequence[mi.ScalarBoundingBox3f], sensor: mi.Sensor, film: mi.Film
) -> np.ndarray:
    """Return the pixels that may see one of some boxes, all if one is beside the camera."""
    width, height = sampled_size(film)
    window = Window(sensor)
    first = np.ravel(np.array(window.first))
    chosen = np.zeros((height, width), dtype=bool)
    for box in boxes:
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
