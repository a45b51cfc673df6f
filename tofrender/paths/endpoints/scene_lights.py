"""Next-event estimation of a scene's emitters, and hits of them, alone or combined."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from typing import Any, Self

import drjit as dr
import mitsuba as mi

from ...runtime import checks
from ..records import BSDFEval, Connection, Hit, Path, Vertex
from ..wavefronts import Wavefronts
from .emitters import EmitterEndpoint, power_heuristic

GOLDEN = 0.6180339887  # the golden ratio's fraction, whose multiples fill the unit interval evenly
# Extents of the emitters in widths, and the number of samples that pays from there on
BY_WIDTHS = ((20, 8), (5, 4))
MOST = 64  # largest number of emitter samples of a vertex


@dataclass
class LatticeConnection(Connection):
    """The first connection of a vertex, with the random shift of its lattice."""

    shift: mi.Point2f = field(kw_only=True)  # the shift, in [0, 1)²


class EmitterLattice:
    """Further emitter samples of a vertex, on a lattice that the first one has shifted.

    Point k of n is shift + (k / n, k φ) modulo 1, with the golden ratio φ: a rank-1 lattice where n
    is a Fibonacci number, and nearly one elsewhere. A path's first vertex has `first` points, all
    further ones have half as many, rounded up: those matter less, and a path has more of them.
    """

    def __init__(self, endpoint: EmitterEndpoint, first: int) -> None:
        self.endpoint = endpoint
        self.first, self.later = mi.UInt32(first), mi.UInt32((first + 1) // 2)
        dr.make_opaque(self.first, self.later)  # One kernel for all numbers above 1

    def size(self, depth: mi.UInt32) -> mi.UInt32:
        """Return the number of samples of vertex number 0, 1, ... of a path."""
        return dr.select(depth == 0, self.first, self.later)

    def count(self, path: Path) -> mi.UInt32:
        """Return the number of samples after the first."""
        return self.size(path.depth) - 1

    def sample(
        self,
        k: mi.UInt32,
        first: LatticeConnection,
        vertex: Vertex,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Sample point number k + 1 of the lattice."""
        number, size = mi.Float(k + 1), mi.Float(self.size(path.depth))
        u = mi.Point2f(number / size, number * GOLDEN) + first.shift
        return self.endpoint.sample_emitter(vertex, u - dr.floor(u), active)


class SceneLights(EmitterEndpoint):
    """Next-event estimation and hits of all emitters, combined by the power heuristic.

    Args:
        scene: The scene.
        sensor: The sensor, which the bounding sphere of distant emitters contains, or None.
        hide_emitters: Whether the sensor looks through area lights, and sees no environment, as in
            Mitsuba.
        discard_direct_light: Whether light that comes straight from an emitter does not count.
        light_samples: Emitter samples at the first vertex of a path; all further vertices have half
            as many, rounded up. "auto" is 1 until `for_bin_width` chooses.
    """

    further: EmitterLattice | None

    def __init__(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        hide_emitters: bool = False,
        discard_direct_light: bool = False,
        light_samples: str | int = 1,
    ) -> None:
        super().__init__(scene, sensor, hide_emitters, discard_direct_light)
        self.light_samples = checked_count(light_samples)
        self._set_count(1 if isinstance(light_samples, str) else light_samples)

    def _set_count(self, count: int) -> None:
        """Set the number of emitter samples at a path's first vertex."""
        self.further = None
        if count > 1:  # a copy, since a cycle would keep the scene until garbage collection
            self.further = EmitterLattice(copy(self), count)

    def for_bin_width(self, width_opl: float) -> Self:
        """Return the endpoint with as many emitter samples as pay off, if they are "auto"."""
        if self.light_samples != "auto":
            return self
        other = copy(self)
        other._set_count(points_that_pay(self.scene, width_opl, self.sphere))
        return other

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample an emitter; if more samples follow, as the first of a lattice."""
        shift = sampler.next_2d()
        connection = self.sample_emitter(vertex, shift, active)
        if self.further is None:
            return connection
        return LatticeConnection(**vars(connection), shift=shift)

    def _count(self, depth: mi.UInt32) -> mi.Float:
        """Return the number of emitter samples at a vertex."""
        return mi.Float(1) if self.further is None else mi.Float(self.further.size(depth))

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the power heuristic against emitter samples; 1 after delta lobes."""
        weight = mi.Float(0)
        if not self.finds_all:
            # The vertex before the hit had the samples; first rays have none, and are specular
            pdf = hit.pdf if self.further is None else hit.pdf * self._count(path.depth - 1)
            weight = power_heuristic(path.pdf, pdf)
        return dr.select(path.specular, mi.Float(1), weight)

    def mis_weight(
        self, path: Path, vertex: Vertex, connection: Connection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return the power heuristic against BSDF samples; 1 for emitters that cannot be hit.

        Each of n samples has an n-th of it, for n times its density (Veach 1997, 9.2.2). The
        density is the point's own, occluded or not: hits know of no shadow either.
        """
        n = self._count(path.depth)
        if self.finds_all:
            return dr.rcp(n)
        weight = power_heuristic(n * connection.pdf, bsdf_eval.pdf)
        return dr.select(connection.delta, 1, weight) / n


class ConnectionsOnly(SceneLights):
    """Next-event estimation of all emitters alone; hits count after delta lobes only.

    Noisy where a glossy surface reflects a large light: emitter samples rarely fall into its lobe.
    """

    finds_all = True


class EmitterHits(EmitterEndpoint):
    """Emitters by hits alone, without next-event estimation.

    Arguments as for `SceneLights`; noisier by far with small lights, and blind to point lights.
    """

    connects = False

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Raise a TypeError: there are no connections."""
        raise TypeError("EmitterHits: makes no connections; must be used for hits alone")

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return 1: nothing else finds the light."""
        return mi.Float(1)


def checked_count(value: Any) -> str | int:
    """Check a number of emitter samples, or "auto"."""
    try:
        is_auto = isinstance(value, str) and value == "auto"
        return value if is_auto else checks.integer("", value, 1, MOST)
    except ValueError:
        raise ValueError(
            f"light_samples = {checks.quote(value)}: must be 'auto' or an integer from 1 to {MOST}"
        ) from None


def points_that_pay(scene: mi.Scene, width_opl: float, sphere: Wavefronts | None) -> int:
    """Return the number of emitter samples of a first vertex for time bins of a width [m].

    Where emitters extend over many widths, light of one vertex falls into many bins, each of which
    few connections reach: more samples make up for that.
    """
    widths = _extent(scene, sphere) / width_opl
    return next((n for least, n in BY_WIDTHS if widths >= least), 1)


def _extent(scene: mi.Scene, sphere: Wavefronts | None) -> float:
    """Return the largest distance between points of emission [m]."""
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
