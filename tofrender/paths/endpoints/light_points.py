"""Number and positions of the emitter samples of a vertex."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..surfaces import has_mirrors
from .wavefronts import Wavefronts

GOLDEN = 0.6180339887
"""The golden ratio's fraction, whose multiples fill the unit interval evenly."""

BY_WIDTHS = ((20, 8), (5, 4))
"""Extents of the lights, in widths, from which on so many points pay; one below."""


MOST = 64
"""Points on lights that a vertex may connect to."""


def checked_count(value: Any) -> str | int:
    """A number of light points, or "auto".

    Raises:
        ValueError: It is neither; one line.
    """
    try:
        is_auto = isinstance(value, str) and value == "auto"
        return value if is_auto else checks.integer("", value, 1, MOST)
    except ValueError:
        raise ValueError(
            f"light_samples = {checks.quote(value)}: must be 'auto' or an integer from 1 to {MOST}"
        ) from None


class LightPoints:
    """A lattice of points for each vertex, moved by a random shift of its own.

    Point k of n is shift + (k / n, k φ) modulo 1, with the golden ratio φ: a rank-1 lattice where n
    is a Fibonacci number, and nearly one elsewhere. A path's first vertex has `first` points, all
    further ones have half as many, rounded up: those matter less, and a path has more of them.
    """

    def __init__(self, first: int) -> None:
        self.several = first > 1
        self.first, self.further = mi.UInt32(first), mi.UInt32((first + 1) // 2)
        dr.make_opaque(self.first, self.further)  # One kernel for all numbers above 1

    def count(self, vertex: mi.UInt32) -> mi.UInt32:
        """Points of a vertex, 0 being the first that a path has."""
        return dr.select(vertex == 0, self.first, self.further)

    def point(self, k: mi.UInt32, vertex: mi.UInt32, shift: mi.Point2f) -> mi.Point2f:
        """Point number k, in [0, 1)²."""
        x = mi.Point2f(mi.Float(k) / mi.Float(self.count(vertex)), mi.Float(k) * GOLDEN) + shift
        return x - dr.floor(x)


def points_that_pay(scene: mi.Scene, width_opl: float, sphere: Wavefronts | None) -> int:
    """Number of light points of a first vertex where lengths are told apart by `width_opl` [m].

    Where lights reach over many widths, light of one vertex falls into many bins, each of which
    few connections reach: more points make up for that. Mirrors and clear glass show a light by the
    paths themselves; that noise is far above the connections' own.

    Args:
        scene: The scene.
        width_opl: Width of a bin, with what light is spread by [m].
        sphere: Where light starts that is infinitely far away, None if none is.
    """
    if has_mirrors(scene):
        return 1
    widths = _extent(scene, sphere) / width_opl
    return next((n for least, n in BY_WIDTHS if widths >= least), 1)


def _extent(scene: mi.Scene, sphere: Wavefronts | None) -> float:
    """Largest difference of where light starts [m]."""
    emitters = scene.emitters()
    if len(emitters) == 1 and mi.has_flag(emitters[0].flags(), mi.EmitterFlags.Delta):
        return 0.0
    if sphere is not None:
        return 2 * float(sphere.radius[0])
    whole = mi.ScalarBoundingBox3f()
    for emitter in emitters:
        box = mi.ScalarBoundingBox3f(emitter.bbox())
        if box.valid():  # A projector has none
            whole.expand(box)
    return float(dr.norm(whole.extents())) if whole.valid() else 0.0
