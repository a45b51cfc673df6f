"""Next-event estimation of the emitters of a scene, and rays that hit emitters."""

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

# Fractional part of the golden ratio. Its multiples modulo 1 fill the unit interval evenly
GOLDEN = 0.6180339887

# Smallest extent of the emitters in bin widths -> number of emitter samples that reduces the noise
# per time
BY_WIDTHS = ((20, 8), (5, 4))

# Number of emitter samples for paths of two segments. Without the rest of a path, emitter samples
# are a larger part of its time, and reduce the noise more
DIRECT_SAMPLES = 8

# Largest number of emitter samples of a vertex
MOST = 64


@dataclass
class LatticeConnection(Connection):
    """The first connection of a vertex, with the random shift of its lattice."""

    # Shift, in [0, 1)²
    shift: mi.Point2f = field(kw_only=True)


class EmitterLattice:
    """Additional emitter samples of a vertex, on a shifted lattice.

    Point k of n is shift + (k / n, k φ) modulo 1, with the golden ratio φ. If n is a Fibonacci
    number, the points are a rank-1 lattice, otherwise nearly so. The first emitter sample of the
    vertex is point 0.

    Later vertices have half as many points as the first vertex, because they matter less and are
    more numerous.

    Args:
        endpoint: Endpoint that samples the emitters.
        first: Number of points at the first vertex of a path. Later vertices have half as many
            points, rounded up.
    """

    def __init__(self, endpoint: EmitterEndpoint, first: int) -> None:
        self.endpoint = endpoint
        self.first = mi.UInt32(first)
        self.later = mi.UInt32((first + 1) // 2)

        # Opaque numbers give one kernel for all numbers above 1
        dr.make_opaque(self.first, self.later)

    def size(self, depth: mi.UInt32) -> mi.UInt32:
        """Return the number of emitter samples of the vertex with index `depth` = 0, 1, ..."""
        return dr.select(depth == 0, self.first, self.later)

    def count(self, path: Path) -> mi.UInt32:
        """Return the number of emitter samples of a vertex after the first sample."""
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
        """Sample an emitter by point k + 1 of the lattice."""
        index = mi.Float(k + 1)
        size = mi.Float(self.size(path.depth))
        u = mi.Point2f(index / size, index * GOLDEN) + first.shift
        return self.endpoint.sample_emitter(vertex, u - dr.floor(u), active)


class SceneLights(EmitterEndpoint):
    """Next-event estimation and hits of all emitters, combined by the power heuristic.

    Args:
        scene: The scene.
        sensor: The sensor, or None. Light of emitters at infinity starts outside the sphere around
            scene and sensor.
        hide_emitters: Whether the sensor looks through area lights and does not see the
            environment, as in Mitsuba.
        discard_direct_light: Whether to leave out light that the sensor receives directly from an
            emitter.
        light_samples: Number of emitter samples at the first vertex of a path. Later vertices have
            half as many, rounded up. "auto" means 1 until `for_bin_width` chooses a number.
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

        # Refer to a copy: a reference cycle would keep the scene until the next garbage collection
        if count > 1:
            self.further = EmitterLattice(copy(self), count)

    def for_bin_width(self, width_opl: float) -> Self:
        """Return the endpoint with a number of emitter samples for this bin width [m].

        Only `light_samples = "auto"` depends on the bin width.
        """
        if self.light_samples != "auto":
            return self
        other = copy(self)
        other._set_count(points_that_pay(self.scene, width_opl, self.sphere))
        return other

    def for_direct_light(self) -> Self:
        """Return the endpoint with a number of emitter samples for paths of two segments.

        Only `light_samples = "auto"` changes. A single point light or directional light has one
        emitter sample.
        """
        if self.light_samples != "auto" or _extent(self.scene, self.sphere) == 0:
            return self
        other = copy(self)
        other._set_count(DIRECT_SAMPLES)
        return other

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample an emitter. The result contains the shift of the lattice for further samples."""
        shift = sampler.next_2d()
        connection = self.sample_emitter(vertex, shift, active)
        if self.further is None:
            return connection
        return LatticeConnection(**vars(connection), shift=shift)

    def _count(self, depth: mi.UInt32) -> mi.Float:
        """Return the number of emitter samples of the vertex with index `depth`."""
        return mi.Float(1) if self.further is None else mi.Float(self.further.size(depth))

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return the power heuristic against emitter samples, 1 after delta lobes."""
        weight = mi.Float(0)
        if not self.finds_all:
            # The emitter samples belong to the vertex before the hit. First rays are specular
            pdf = hit.pdf if self.further is None else hit.pdf * self._count(path.depth - 1)
            weight = power_heuristic(path.pdf, pdf)
        return dr.select(path.specular, mi.Float(1), weight)

    def mis_weight(
        self, path: Path, vertex: Vertex, connection: Connection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return the power heuristic against BSDF samples, 1 for emitters that rays cannot hit.

        With n emitter samples, the density is n times as high, and each sample receives 1/n of the
        weight (Veach 1997, section 9.2.2). The density does not depend on the visibility of the
        emitter, as in `hit_weight`.
        """
        n = self._count(path.depth)
        if self.finds_all:
            return dr.rcp(n)
        weight = power_heuristic(n * connection.pdf, bsdf_eval.pdf)
        return dr.select(connection.delta, 1, weight) / n


class ConnectionsOnly(SceneLights):
    """Next-event estimation of all emitters. Hits count after delta lobes only.

    The result is noisy if a glossy surface reflects a large light, because few emitter samples are
    within the glossy lobe.
    """

    finds_all = True


class EmitterHits(EmitterEndpoint):
    """Rays that hit emitters, without next-event estimation.

    Small lights are much noisier than with `SceneLights`, and point lights are black. `SceneLights`
    describes the arguments.
    """

    connects = False

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Raise a TypeError, because this endpoint does not support connections."""
        raise TypeError("EmitterHits does not support connections. Use SceneLights for connections")

    def hit_weight(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """Return 1, because no other technique finds the light."""
        return mi.Float(1)


def checked_count(value: Any) -> str | int:
    """Check the argument `light_samples`: an integer from 1 to `MOST`, or "auto"."""
    try:
        is_auto = isinstance(value, str) and value == "auto"
        return value if is_auto else checks.integer("", value, 1, MOST)
    except ValueError:
        raise ValueError(
            f"light_samples = {checks.quote(value)}: must be 'auto' or an integer from 1 to {MOST}"
        ) from None


def points_that_pay(scene: mi.Scene, width_opl: float, sphere: Wavefronts | None) -> int:
    """Return a number of emitter samples for the first vertex of a path.

    If emitters extend over many bin widths, light from one vertex falls into many time bins, and
    few connections fall into each bin. More emitter samples reduce the noise.

    Args:
        scene: The scene.
        width_opl: Bin width as optical path length [m].
        sphere: Planes where light of emitters at infinity starts, None without such emitters.
    """
    widths = _extent(scene, sphere) / width_opl
    return next((n for least, n in BY_WIDTHS if widths >= least), 1)


def _extent(scene: mi.Scene, sphere: Wavefronts | None) -> float:
    """Return an upper bound for the distance between two points that emit [m]."""
    emitters = scene.emitters()
    if len(emitters) == 1 and mi.has_flag(emitters[0].flags(), mi.EmitterFlags.Delta):
        return 0.0
    if sphere is not None:
        return 2 * float(sphere.radius[0])
    whole = mi.ScalarBoundingBox3f()
    for emitter in emitters:
        box = mi.ScalarBoundingBox3f(emitter.bbox())
        if box.valid():  # The box of a projector is not valid
            whole.expand(box)
    return float(dr.norm(whole.extents())) if whole.valid() else 0.0
