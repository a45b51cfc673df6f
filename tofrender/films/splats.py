"""Splats: contributions at any position of a film, stored separately from the samples of pixels.

A light path that connects to the lens contributes to any pixel. All threads add such splats, and
the sum is divided by the number of all light paths. A reconstruction filter distributes a splat
over the neighboring pixels. The integral of the filter's weights over the sampled area is 1 for
each pixel.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..signals.polarization import stokes_count
from .histogram import Histogram

STEPS = 512  # Number of points per pixel for the integral of a filter


class Splats:
    """Sums of splats on a film.

    Args:
        film: The film.
        count: Number of time bins or images.

    Attributes:
        cells: The sums, a histogram with `count` cells for each pixel.
        norms: Factors of each column and row that normalize the filter, None for a box filter.
    """

    def __init__(self, film: mi.Film, count: int) -> None:
        width, height = (int(n) for n in film.crop_size())
        self.film = film
        channels = (1 if mi.is_monochromatic else 3) * stokes_count()
        self.cells = Histogram(height, width, count, channels)
        self.norms = None if film.rfilter().is_box_filter() else _norms(film, width, height)

    def add(
        self,
        position: mi.Point2f,
        values: Sequence[Sequence[mi.Float]],
        first: mi.UInt32 | int,
        active: mi.Bool,
    ) -> None:
        """Add a splat to consecutive cells.

        Args:
            position: Position on the film [pixels].
            values: Channels of each cell.
            first: Index of the first cell.
            active: Active lanes.
        """
        for x, y, weight in footprint(self.film, position):
            # Normalize the weight of the pixel
            inside = active & (x >= 0) & (y >= 0)
            inside &= (x < self.cells.shape[1]) & (y < self.cells.shape[0])
            if self.norms is not None:
                across, down = self.norms
                weight = weight * dr.gather(mi.Float, across, mi.UInt32(x), inside)
                weight = weight * dr.gather(mi.Float, down, mi.UInt32(y), inside)

            # Add to the cells of the pixel
            for k, channels in enumerate(values):
                weighted = [channel * weight for channel in channels]
                self.cells.add(weighted, x, y, mi.UInt32(first + k), inside, private=False)


def footprint(
    film: mi.Film, position: mi.Point2f
) -> list[tuple[mi.Int32, mi.Int32, mi.Float | int]]:
    """Return the pixels of the crop window around a position, and the filter's weight in each.

    Args:
        film: The film.
        position: Position on the film [pixels].

    Returns:
        (x, y, weight) of each pixel. Pixels may be outside of the crop window.
    """
    # A box filter has one pixel
    rfilter = film.rfilter()
    offset = mi.Vector2f(film.crop_offset())
    if rfilter.is_box_filter():
        pixel = mi.Point2i(dr.floor(mi.Point2f(position) - offset))
        return [(pixel.x, pixel.y, 1)]

    # Other filters are products of a weight along x and a weight along y
    radius = rfilter.radius()
    center = mi.Point2f(position) - offset - 0.5
    first = mi.Point2i(dr.ceil(center - radius))
    count = int(np.floor(2 * radius)) + 1
    xs = [(first.x + i, rfilter.eval(first.x + i - center.x)) for i in range(count)]
    ys = [(first.y + i, rfilter.eval(first.y + i - center.y)) for i in range(count)]
    return [(x, y, wx * wy) for y, wy in ys for x, wx in xs]


def _norms(film: mi.Film, width: int, height: int) -> tuple[mi.Float, mi.Float]:
    """Return one over the filter's integral over the sampled area, for each column and row."""
    # Values of the filter at evenly spaced points
    rfilter = film.rfilter()
    border = rfilter.border_size() if film.sample_border() else 0
    reach = int(np.ceil(rfilter.radius()))
    x = (np.arange(2 * reach * STEPS) + 0.5) / STEPS - reach
    values = np.array(rfilter.eval(mi.Float(x)), dtype=float)

    def along(size: int) -> mi.Float:
        """Return the factors along an axis with `size` pixels."""
        sampled = np.arange(size)[:, None] + 0.5 + x
        inside = (sampled > -border) & (sampled < size + border)
        return mi.Float(STEPS / (inside * values).sum(axis=1))

    return along(width), along(height)
