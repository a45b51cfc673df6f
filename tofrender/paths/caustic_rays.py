"""Caustic rays: rays from a surface that follow delta lobes to an emitter.

Light that arrives by mirrors and clear glass comes from few directions. A vertex with a smooth lobe
sends several rays at once, in the directions from which photons of a pilot have come (see
`guiding`). The rays follow delta lobes only, and their light counts after one delta lobe or more.
"""

from __future__ import annotations

from copy import copy

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import intensity, multiply_throughput
from .guiding import GuidedMaterials
from .kinds import Kind
from .protocols import Endpoint, Measurement, Parts, Space
from .records import Limits, Path, Vertex
from .scattering import Materials
from .walk import walk

FIRST = 16  # rays of a path's first vertex with a smooth lobe
LATER = 4  # rays of all further vertices
LONGEST_CHAIN = 16  # delta lobes from which on Russian roulette may end a ray


class CausticRays:
    """Rays of a path's vertices, for the kinds of paths that end with a delta lobe.

    Args:
        scene: The scene.
        space: The space of the paths.
        emitters: The emitters' emission where rays run into them.
        guided: Scattering by smooth lobes, guided by photons.
        limits: The limits of the paths.
        kinds: `CAUSTIC` and `CAUSTIC_IN_MIRROR`, or one of them.
    """

    def __init__(
        self,
        scene: mi.Scene,
        space: Space,
        emitters: Endpoint,
        guided: GuidedMaterials,
        limits: Limits,
        kinds: frozenset[Kind],
    ) -> None:
        self.guided = guided
        self.kinds = kinds
        own_limits = copy(limits)
        own_limits.rr_depth = limits.rr_depth + LONGEST_CHAIN
        own_limits.left_out = frozenset({Kind.SMOOTH})
        chain = Materials(scene, lobes=mi.BSDFFlags.Delta)
        self.parts = Parts(space, emitters, chain, own_limits)

    @dr.syntax
    def trace(
        self,
        path: Path,
        vertex: Vertex,
        sampler: mi.Sampler,
        measurement: Measurement,
        active: mi.Bool,
    ) -> mi.UInt32:
        """Add the emission that a vertex's rays find; returns how many were not finite."""
        count = self.count(path)
        k = mi.UInt32(0)
        not_finite = mi.UInt32(0)
        while active & (k < count):
            ray = self._start(path, vertex, sampler, count, active)
            measurement, ray = walk(sampler, ray, self.parts, measurement)
            not_finite += ray.not_finite
            k += 1
        return not_finite

    def count(self, path: Path) -> mi.UInt32:
        """Return the number of rays at a path's vertex, 0 where another technique is used."""
        assert path.lobes is not None
        count = dr.select(path.lobes.any_smooth == 0, mi.UInt32(FIRST), LATER)
        first_is_smooth = (path.depth == 0) | (path.lobes.first_smooth != 0)
        if Kind.CAUSTIC not in self.kinds:
            count = dr.select(first_is_smooth, 0, count)
        if Kind.CAUSTIC_IN_MIRROR not in self.kinds:
            count = dr.select(first_is_smooth, count, 0)
        return count

    def _start(
        self, path: Path, vertex: Vertex, sampler: mi.Sampler, count: mi.UInt32, active: mi.Bool
    ) -> Path:
        """Start one of a vertex's rays."""
        _, sample = self.guided.sample(vertex, None, sampler, active)
        ray = copy(path)
        ray.ray = sample.ray
        ray.β = multiply_throughput(path.β, sample.weight / mi.Float(count))
        ray.η = path.η * sample.η
        ray.prev = mi.Interaction3f(vertex.si)
        ray.pdf = sample.pdf
        ray.specular = mi.Bool(False)
        ray.valid_ray = mi.Bool(True)
        ray.depth = path.depth + 1
        ray.not_finite = dr.zeros(mi.UInt32, dr.width(path.depth))
        ray.active = active & dr.any(intensity(ray.β) != 0)
        return ray
