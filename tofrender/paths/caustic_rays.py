"""Caustic rays: rays from a vertex that follow delta lobes to an emitter.

Light that arrives by mirrors and clear glass comes from few directions. Photons of a pilot pass
show these directions (see `guiding`). Each vertex with a smooth lobe sends several rays in the
directions of photons. These rays follow delta lobes only. Their light counts if they have met at
least one delta lobe.
"""

from __future__ import annotations

from copy import copy

import drjit as dr
import mitsuba as mi

from ..signals.polarization import intensity, multiply_throughput
from .guiding import GuidedMaterials
from .path_kinds import Kind
from .protocols import Endpoint, Measurement, Parts, Space
from .records import Limits, Path, Vertex
from .scattering import Materials
from .walk import walk

FIRST = 16  # Rays of the first vertex with a smooth lobe of a path
LATER = 4  # Rays of each later vertex
LONGEST_CHAIN = 16  # Number of delta lobes that Russian roulette does not end


class CausticRays:
    """Traces caustic rays from the vertices of paths.

    Args:
        scene: The scene.
        space: Space of the paths.
        emitters: Endpoint with the emission of emitters that rays hit.
        guided: Scattering by smooth lobes, guided by photons.
        limits: Limits of the paths.
        kinds: Kinds of paths to render: `CAUSTIC`, `CAUSTIC_IN_MIRROR`, or both.
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

        # Trace chains of delta lobes. A ray that hits an emitter without a delta lobe does not
        # count, because next-event estimation finds its light
        ray_limits = copy(limits)
        ray_limits.rr_depth = limits.rr_depth + LONGEST_CHAIN
        ray_limits.left_out = frozenset({Kind.SMOOTH})
        delta_lobes = Materials(scene, lobes=mi.BSDFFlags.Delta)
        self.parts = Parts(space, emitters, delta_lobes, ray_limits)

    @dr.syntax
    def trace(
        self,
        path: Path,
        vertex: Vertex,
        sampler: mi.Sampler,
        measurement: Measurement,
        active: mi.Bool,
    ) -> mi.UInt32:
        """Trace the rays of a vertex, and add the emission that they hit.

        Returns the number of contributions that were not finite. `CausticTracer.trace` describes
        the arguments.
        """
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
        """Return the number of rays at a vertex, 0 if another technique renders its kind of paths.

        Args:
            path: The path up to the vertex, before its update.
        """
        assert path.lobes is not None

        # Has the path met a smooth lobe before this vertex?
        count = dr.select(path.lobes.any_smooth == 0, mi.UInt32(FIRST), LATER)

        # Rays of this vertex make caustics if the first lobe is smooth, otherwise caustics in
        # mirrors
        first_is_smooth = (path.depth == 0) | (path.lobes.first_smooth != 0)
        if Kind.CAUSTIC not in self.kinds:
            count = dr.select(first_is_smooth, 0, count)
        if Kind.CAUSTIC_IN_MIRROR not in self.kinds:
            count = dr.select(first_is_smooth, count, 0)
        return count

    def _start(
        self, path: Path, vertex: Vertex, sampler: mi.Sampler, count: mi.UInt32, active: mi.Bool
    ) -> Path:
        """Return a path that starts at a vertex in a guided direction.

        `count` is the number of rays of the vertex, which share the throughput of the path.
        """
        # Sample the direction
        _, sample = self.guided.sample(vertex, None, sampler, active)

        # Extend the path by the vertex
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
