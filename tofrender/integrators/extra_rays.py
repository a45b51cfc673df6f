"""Extra rays in pixels where the camera sees an emitter, directly or only through delta lobes.

The light of these emitters arrives in few time bins, and causes most of the noise of a film. The
main paths exclude this light. Extra rays find it in the pixels that see the bounding boxes of
emitters, or the bounding boxes of mirrors and clear glass. The choice of pixels does not depend on
samples, because such a choice would be biased.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Self

import mitsuba as mi
import numpy as np

from ..paths.camera import Tile, sampled_size
from ..paths.endpoints import EmitterHits, SceneLights
from ..paths.path_kinds import Kind
from ..paths.scattering import Materials
from ..paths.sensor_window import KINDS, Window
from ..paths.space import Vacuum
from ..paths.walk import add_emission
from .plan import Plan
from .user_defined import Tracer

MARGIN = 0.01  # Margin around the projection of a box, for rounding errors [pixels]


class ExtraRays:
    """Abstract base class of rays for one kind of paths, in the pixels that may see such paths.

    Args:
        plan: The plan of the render. The attribute `remaining_plan` is the plan without this kind
            of paths.
        sensor: The sensor of the render.
        pixels: Indices of the pixels, row by row in the sampled area of the film.
        rate: Number of rays per sample of these pixels.
        splats: Whether contributions are added as splats, for reconstruction filters other than
            box. With few samples per pixel, the division by the sum of the filter weights would
            make the pixels too bright, by 5 % with one sample per pixel.
    """

    # The kind of paths
    kind: ClassVar[Kind]

    # Largest number of rays per sample of a pixel
    most: ClassVar[int]

    # Largest number of rays per sample, as the mean over all pixels. A path has about ten rays
    mean_rate: ClassVar[float]

    def __init__(
        self, plan: Plan, sensor: mi.Sensor, pixels: np.ndarray, rate: int, splats: bool
    ) -> None:
        self.plan = plan
        self.pixels = pixels
        self.rate = rate
        self.splats = splats
        self.remaining_plan = plan.without(self.kind)

    @classmethod
    def boxes(cls, plan: Plan) -> Sequence[mi.ScalarBoundingBox3f]:
        """Return bounding boxes of all surfaces that these paths may hit first."""
        raise NotImplementedError

    @classmethod
    def of(
        cls, plan: Tracer, sensor: mi.Sensor, film: mi.Film, tile: Tile | None = None
    ) -> Self | None:
        """Create the rays for a film or a tile.

        Args:
            plan: The plan of the render.
            sensor: The sensor of the render.
            film: The film.
            tile: Position of the film in a larger film, None for a whole film.

        Returns:
            The rays. None if the tracer is not a plan, if the camera does not project points onto
            pixels, or if no pixel sees such paths. Also None if so many pixels see such paths that
            more than one ray per sample is not affordable.
        """
        if not isinstance(plan, Plan) or sensor.class_name() not in KINDS:
            return None

        # Find the pixels that may see such paths
        boxes = cls.boxes(plan)
        if not boxes:
            return None
        whole = film if tile is None else tile.whole
        pixels = pixels_of(boxes, sensor, whole)

        # Choose the number of rays per sample, from all pixels of the film
        width, height = sampled_size(whole)
        rate = min(cls.most, int(cls.mean_rate * width * height / max(pixels.size, 1)))
        if tile is not None:
            pixels = _within(pixels, width, film, tile)
        if not pixels.size or rate <= 1:
            return None

        # Round the number down to a power of two, which the point set requires. The number does not
        # depend on the samples per pixel, so that resumed renders use the same number
        splats = not film.rfilter().is_box_filter()
        return cls(
            plan=plan,
            sensor=sensor,
            pixels=pixels,
            rate=1 << (rate.bit_length() - 1),
            splats=splats,
        )

    @property
    def scene(self) -> mi.Scene:
        """The scene of the plan."""
        return self.plan.scene

    def trace(self, sampler, ray, origin, measurement, frame=None):
        """Trace camera rays, and add the light of these paths to the measurement."""
        raise NotImplementedError


class VisibleEmitters(ExtraRays):
    """Rays to the first surface, in the pixels that may see an emitter directly."""

    kind = Kind.VISIBLE
    most = 32
    mean_rate = 0.5

    @classmethod
    def boxes(cls, plan: Plan) -> Sequence[mi.ScalarBoundingBox3f]:
        """Return the bounding boxes of the emitters."""
        return [emitter.bbox() for emitter in plan.visible_emitters()]

    def trace(self, sampler, ray, origin, measurement, frame=None):
        """Add the emission of the first surface that a camera ray hits."""
        plan = self.plan
        path = plan.start(plan.endpoint, ray, origin, True, frame)
        path, vertex = plan.space.next_vertex(path, sampler)

        # The main paths add the emission of environments
        path.active &= vertex.valid
        path = add_emission(path, vertex, plan, measurement)
        return measurement, path


class DeltaChains(ExtraRays):
    """Rays that follow only delta lobes until they hit an emitter, for mirror images of emitters.

    The rays are traced in the pixels that may see a mirror or clear glass. They add the emission
    that they hit.
    """

    kind = Kind.CHAIN
    most = 4
    mean_rate = 1.0

    def __init__(
        self, plan: Plan, sensor: mi.Sensor, pixels: np.ndarray, rate: int, splats: bool
    ) -> None:
        super().__init__(plan, sensor, pixels, rate, splats)

        # Create a plan for paths that follow delta lobes and hit emitters
        emitters = EmitterHits(plan.scene, sensor, plan.endpoint.hide_emitters)
        self.chains = plan.with_endpoint(emitters)
        self.chains.scattering = Materials(plan.scene, lobes=mi.BSDFFlags.Delta)
        self.chains = self.chains.without(*(set(Kind) - {Kind.CHAIN}))

        # `VisibleEmitters` or the main paths add emitters that the camera sees directly
        self.chains.limits.min_depth = max(plan.limits.min_depth, 2)
        self.chains.caustic_rays = None

    @classmethod
    def boxes(cls, plan: Plan) -> Sequence[mi.ScalarBoundingBox3f]:
        """Return the bounding boxes of shapes with delta lobes, empty if rays are not supported."""
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
        """Add the emission that camera rays find through delta lobes."""
        return self.chains.trace(sampler, ray, origin, measurement, frame=frame)


def _has_delta_lobe(shape: mi.Shape) -> bool:
    """Return whether a shape may have a delta lobe.

    The result is True for instances, because their BSDFs are not known.
    """
    bsdf = shape.bsdf()
    return bsdf is None or mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta)


def pixels_of(
    boxes: Sequence[mi.ScalarBoundingBox3f], sensor: mi.Sensor, film: mi.Film
) -> np.ndarray:
    """Return the indices of the pixels that may see at least one bounding box.

    If a box is not completely in front of the camera, all pixels are returned.

    Args:
        boxes: Bounding boxes.
        sensor: The sensor.
        film: The film.
    """
    width, height = sampled_size(film)
    window = Window(sensor)
    first = np.ravel(np.array(window.first))
    chosen = np.zeros((height, width), dtype=bool)
    for box in boxes:
        # Project the box onto the film
        bounds = window.pixels_of(np.array(box.min, float), np.array(box.max, float))
        if bounds is None:
            return np.arange(width * height)

        # Mark the pixels within these bounds
        low = np.floor(bounds[0] - first - MARGIN)
        high = np.ceil(bounds[1] - first + MARGIN)
        left, top = (int(n) for n in np.clip(low, 0, (width, height)))
        right, bottom = (int(n) for n in np.clip(high, 0, (width, height)))
        chosen[top:bottom, left:right] = True
    return np.flatnonzero(chosen)


def _within(pixels: np.ndarray, width: int, film: mi.Film, tile: Tile) -> np.ndarray:
    """Select the pixels in a tile.

    Args:
        pixels: Indices of pixels of the whole film.
        width: Width of the whole film [pixels].
        film: Film of the tile.
        tile: Position of the tile.

    Returns:
        Indices of the pixels in the tile.
    """
    tile_width, tile_height = sampled_size(film)
    y, x = np.divmod(pixels, width)
    x -= tile.x
    y -= tile.y
    inside = (x >= 0) & (x < tile_width) & (y >= 0) & (y < tile_height)
    return (y * tile_width + x)[inside]
