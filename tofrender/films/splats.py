"""Splats: contributions anywhere on a film, apart from the samples of its pixels.

Connections of light paths to the lens are no samples of the pixel that sees them: they are summed
by all threads, and divided by the number of all light paths. A reconstruction filter spreads each
over the pixels around, with weights whose integral over the sampled area is 1 for every pixel.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ..signals.polarisation import stokes_count
from .histogram import Histogram

STEPS = 512  # Points per pixel that a filter is integrated over


class Splats:
    """Sums of splats in `cells`, a histogram of `count` bins or pictures on a film's pixels."""

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
        """Add to the cells from `first` on, each a sequence of channels, at a position [pixels]."""
        for x, y, weight in footprint(self.film, position):
            inside = active & (x >= 0) & (y >= 0)
            inside &= (x < self.cells.shape[1]) & (y < self.cells.shape[0])
            if self.norms is not None:
                across, down = self.norms
                weight = weight * dr.gather(mi.Float, across, mi.UInt32(x), inside)
                weight = weight * dr.gather(mi.Float, down, mi.UInt32(y), inside)
            for k, channels in enumerate(values):
                weighted = [channel * weight for channel in channels]
                self.cells.add(weighted, x, y, mi.UInt32(first + k), inside, private=False)


def footprint(
    film: mi.Film, position: mi.Point2f
) -> list[tuple[mi.Int32, mi.Int32, mi.Float | int]]:
    """Return the pixels of the crop that light at a position reaches, and its weight in each."""
    rfilter = film.rfilter()
    offset = mi.Vector2f(film.crop_offset())
    if rfilter.is_box_filter():
        pixel = mi.Point2i(dr.floor(mi.Point2f(position) - offset))
        return [(pixel.x, pixel.y, 1)]
    radius = rfilter.radius()
    centre = mi.Point2f(position) - offset - 0.5
    first = mi.Point2i(dr.ceil(centre - radius))
    count = int(np.floor(2 * radius)) + 1
    xs = [(first.x + i, rfilter.eval(first.x + i - centre.x)) for i in range(count)]
    ys = [(first.y + i, rfilter.eval(first.y + i - centre.y)) for i in range(count)]
    return [(x, y, wx * wy) for y, wy in ys for x, wx in xs]


def _norms(film: mi.Film, width: int, height: int) -> tuple[mi.Float, mi.Float]:
    """Return 1 over the filter's integral over the sampled area, around each column and row."""
    rfilter = film.rfilter()
    border = rfilter.border_size() if film.sample_border() else 0
    reach = int(np.ceil(rfilter.radius()))
    x = (np.arange(2 * reach * STEPS) + 0.5) / STEPS - reach
    values = np.array(rfilter.eval(mi.Float(x)), dtype=float)

    def along(size: int) -> mi.Float:
        sampled = np.arange(size)[:, None] + 0.5 + x
        inside = (sampled > -border) & (sampled < size + border)
        return mi.Float(STEPS / (inside * values).sum(axis=1))

    return along(width), along(height)
