"""Delta lobes of surfaces as separate lobes, and wavefronts that follow delta lobes.

Each delta lobe of a BSDF has an index. Smooth lobes of the same BSDF are ignored.

| index | lobe |
|---|---|
| 0 | null transmission: straight through a pane, a mask or a polarizer |
| 1 | reflection: the sum of all mirrors of the BSDF, which reflect in the same direction |
| k + 2 | refraction by component k of the BSDF |
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .surfaces import bsdfs_in, materials, number_of

NULL = 0
"""Index of the lobe of null transmission."""

REFLECTION = 1
"""Index of the lobe of reflection."""

REFRACTION = 2
"""Index of the lobe of refraction by component 0 of a BSDF."""

MOST_LOBES = 15
"""Largest index of a lobe. `nlos.light.specular` stores an index in four bits."""


@dataclass
class LobeSample:
    """Sample of one delta lobe: the new direction, and the factor of the path's throughput."""

    # Index of the lobe
    lobe: mi.UInt32

    # Unit vector after the lobe, in world space
    direction: mi.Vector3f

    # Throughput of the lobe, at most 1 / η². It contains the compression of radiance
    f: mi.UnpolarizedSpectrum

    # Probability of this lobe if `DeltaLobes.sample` has chosen the lobe, otherwise 1
    probability: mi.Float

    # Index of refraction after the lobe, relative to the index before
    η: mi.Float


class DeltaLobes:
    """Delta lobes of all surfaces in a scene.

    Mitsuba's `sample` chooses among all lobes of a BSDF. Mitsuba's `blendbsdf` mixes the
    probability of a delta lobe with the density of smooth lobes, and returns a wrong weight.
    Therefore this class samples each component of a BSDF separately.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: mi.Scene) -> None:
        bsdfs = [bsdf for bsdf in dict.fromkeys(materials(scene)) if bsdf is not None]

        # Sets of lobes and of components, by the registry index of the BSDF
        self.sets = _table(bsdfs, [self.set_of(bsdf) for bsdf in bsdfs])
        self.mirrors = _table(bsdfs, [_mirrors_of(bsdf) for bsdf in bsdfs])
        self.backs = _table(bsdfs, [_mirrors_of(bsdf, only_back=True) for bsdf in bsdfs])
        self.mixed = _table(bsdfs, [self.are_mixed(bsdf) for bsdf in bsdfs])

        # Lobes and components that occur in the scene
        self.lobes = _members(self.sets)
        self.components = _members(self.mirrors)
        self.back_components = _members(self.backs)

    @staticmethod
    def set_of(bsdf: mi.BSDF) -> int:
        """Return the set of delta lobes of a BSDF. Bit n is set if the BSDF has the lobe n."""
        found = 0
        for component in range(bsdf.component_count()):
            flags = bsdf.flags(component)
            if mi.has_flag(flags, mi.BSDFFlags.Null):
                found |= 1 << NULL
            elif mi.has_flag(flags, mi.BSDFFlags.DeltaReflection):
                found |= 1 << REFLECTION
            elif mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission):
                found |= 1 << REFRACTION + component
        return found

    @staticmethod
    def are_mixed(bsdf: mi.BSDF) -> bool:
        """Return whether a BSDF mixes delta lobes with smooth lobes or with equal delta lobes.

        Delta lobes are equal if they have the same side and the same direction.
        """
        # Does the BSDF have delta lobes and smooth lobes?
        has = mi.has_flag
        if DeltaLobes.set_of(bsdf) and has(bsdf.flags(), mi.BSDFFlags.Smooth):
            return True

        # Do two components of one side share a direction?
        components = [bsdf.flags(component) for component in range(bsdf.component_count())]
        for side in (mi.BSDFFlags.FrontSide, mi.BSDFFlags.BackSide):
            for kind in (mi.BSDFFlags.Null, mi.BSDFFlags.DeltaReflection):
                if sum(has(flags, side) and has(flags, kind) for flags in components) > 1:
                    return True
        return False

    @staticmethod
    def require_supported(shape: mi.Shape) -> None:
        """Check that delta lobes of a shape can be evaluated separately.

        Raises:
            ValueError: The shape has a mask, a bump map or a normal map over a mirror or glass, or
                its BSDF has too many components.
        """
        kinds = [bsdf.class_name() for bsdf in bsdfs_in(shape.bsdf())]
        lobes = DeltaLobes.set_of(shape.bsdf())
        name = f"shape {shape.id()!r}"
        if lobes >> 1 and "MaskBSDF" in kinds:
            raise ValueError(
                f"{name}: a mask over a mirror or glass is not supported. Remove the mask"
            )
        for kind, plugin in (("NormalMap", "normalmap"), ("BumpMap", "bumpmap")):
            if kind in kinds:
                raise ValueError(
                    f"{name}: a {plugin} of a mirror or glass is not supported. Remove the {plugin}"
                )
        if lobes.bit_length() > MOST_LOBES + 1:
            count = shape.bsdf().component_count()
            most = MOST_LOBES - REFRACTION + 1
            raise ValueError(
                f"{name}: a BSDF with {count} components is not supported. Use at most {most}"
            )

    def at(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UInt32:
        """Return the set of delta lobes at surface points, as bits.

        The set is 0 in lanes without a surface.
        """
        return dr.gather(mi.UInt32, self.sets, number_of(si.bsdf()), active & si.is_valid())

    def mixed_at(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Return lanes with a surface point that has mixed delta lobes, see `are_mixed`."""
        mixed = dr.gather(mi.UInt32, self.mixed, number_of(si.bsdf()), active & si.is_valid())
        return mixed != 0

    def eval(self, si: mi.SurfaceInteraction3f, lobe: mi.UInt32, active: mi.Bool) -> LobeSample:
        """Evaluate the lobe of each lane.

        The throughput `f` is 0 in lanes with a surface that lacks this lobe.

        Args:
            si: Surface interaction.
            lobe: Index of the lobe.
            active: Active lanes.
        """
        bits = self.at(si, active)
        found = self._none(si, lobe)
        for index in self.lobes:
            here = active & (lobe == index) & ((bits >> index & 1) != 0)
            found = dr.select(here, self._follow(si, index, here), found)
        return found

    def sample(self, si: mi.SurfaceInteraction3f, xi: mi.Float, active: mi.Bool) -> LobeSample:
        """Choose a lobe in proportion to the square root of its energy.

        The energy of a lobe is η² f. The square root favors weak lobes, because their light often
        arrives in different time bins. The throughput `f` of the result is 0 if all lobes are
        black, and does not contain 1 / probability.

        Args:
            si: Surface interaction.
            xi: Uniform random number.
            active: Active lanes.
        """
        # Evaluate all lobes, and find the square roots of their energies
        bits = self.at(si, active)
        lobes = []
        shares = []
        total = mi.Float(0)
        for index in self.lobes:
            here = active & ((bits >> index & 1) != 0)
            lobe = self._follow(si, index, here)
            share = dr.select(here, lobe.η * dr.sqrt(dr.max(lobe.f)), 0)
            lobes.append(lobe)
            shares.append(share)
            total += share

        # Choose a lobe by inversion of the cumulative distribution
        found = self._none(si, mi.UInt32(0))
        remainder = xi * total
        for lobe, share in zip(lobes, shares, strict=True):
            lobe.probability = share / total
            chosen = (share > 0) & (remainder >= 0)
            found = dr.select(chosen, lobe, found)
            remainder = dr.select(share > 0, remainder - share, remainder)
        return found

    def _follow(self, si: mi.SurfaceInteraction3f, index: int, active: mi.Bool) -> LobeSample:
        """Evaluate one lobe, given its index."""
        found = self._none(si, mi.UInt32(index))
        bsdf = si.bsdf()

        # Null transmission
        if index == NULL:
            found.f = mi.UnpolarizedSpectrum(bsdf.eval_null_transmission(si, active))
            found.f = dr.select(active, found.f, 0)
            return found

        # Refraction
        if index != REFLECTION:
            return self._component(si, index - REFRACTION, found, active)

        # Reflection: add all mirrors. If `twosided` has two BSDFs, the components of the first
        # BSDF also return lobes of the second BSDF on the back side. Count these lobes once
        mirrors = dr.gather(mi.UInt32, self.mirrors, number_of(bsdf), active)
        backs = dr.gather(mi.UInt32, self.backs, number_of(bsdf), active)
        behind = found
        for component in self.components:
            here = active & ((mirrors >> component & 1) != 0)
            is_back = (backs >> component & 1) != 0
            found = self._component(si, component, found, here & ~is_back)
            if component in self.back_components:
                behind = self._component(si, component, behind, here & is_back)
        if self.back_components:
            found = dr.select(dr.any(behind.f > 0), behind, found)
        return found

    @staticmethod
    def _component(
        si: mi.SurfaceInteraction3f, component: int, lobe: LobeSample, active: mi.Bool
    ) -> LobeSample:
        """Return a lobe with one component of the BSDF added.

        Args:
            si: Surface interaction.
            component: Index of the component.
            lobe: The lobe without this component.
            active: Active lanes.
        """
        # Sample this component only. The BSDF then chooses the component with the probability 1
        context = mi.BSDFContext()
        context.component = component
        half = mi.Point2f(0.5)
        bs, weight = si.bsdf().sample(context, si, mi.Float(0.5), half, active)

        # Add the component in lanes in which the BSDF has such a lobe
        exists = active & (bs.pdf > 0) & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        f = dr.select(exists, mi.unpolarized_spectrum(weight), 0)
        direction = dr.select(exists, si.to_world(bs.wo), lobe.direction)
        η = dr.select(exists, bs.eta, lobe.η)
        return LobeSample(
            lobe=lobe.lobe, direction=direction, f=lobe.f + f, probability=lobe.probability, η=η
        )

    @staticmethod
    def _none(si: mi.SurfaceInteraction3f, lobe: mi.UInt32) -> LobeSample:
        """Return a black lobe that does not change the direction."""
        black = mi.UnpolarizedSpectrum(0) + dr.zeros(mi.Float, dr.width(si))
        return LobeSample(
            lobe=lobe,
            direction=-si.to_world(si.wi),
            f=black,
            probability=mi.Float(1),
            η=mi.Float(1),
        )


def _mirrors_of(bsdf: mi.BSDF, *, only_back: bool = False) -> int:
    """Return the set of components of a BSDF that are mirrors, as bits.

    Args:
        bsdf: The BSDF.
        only_back: Whether to leave out mirrors on the front side.
    """
    found = 0
    for component in range(bsdf.component_count()):
        flags = bsdf.flags(component)
        is_front = mi.has_flag(flags, mi.BSDFFlags.FrontSide)
        if mi.has_flag(flags, mi.BSDFFlags.DeltaReflection) and not (only_back and is_front):
            found |= 1 << component
    return found


def _table(bsdfs: list[mi.BSDF], sets: list[int]) -> mi.UInt32:
    """Return a table of sets, by the registry index of the BSDF."""
    rows = [int(number_of(mi.BSDFPtr(bsdf))[0]) for bsdf in bsdfs]
    table = np.zeros(max(rows, default=0) + 1, np.uint32)
    table[rows] = sets
    return mi.UInt32(table.tolist())


def _members(sets: mi.UInt32) -> list[int]:
    """Return the members of the union of all sets in a table."""
    union = int(np.bitwise_or.reduce(np.array(sets)))
    return [n for n in range(union.bit_length()) if union >> n & 1]


@dataclass
class Wavefront:
    """Ray differentials along both axes across a ray (Igehy, SIGGRAPH 1999)."""

    # Derivatives of the point with respect to the direction at the start [m/rad]
    p1: mi.Vector3f
    p2: mi.Vector3f

    # Derivatives of the direction with respect to the direction at the start
    d1: mi.Vector3f
    d2: mi.Vector3f

    @classmethod
    def start(cls, d: mi.Vector3f) -> Wavefront:
        """Create the wavefront at the start of rays.

        Args:
            d: Directions of the rays. The differentials are along both tangents of `mi.Frame3f(d)`.
        """
        zero = dr.zeros(mi.Vector3f, dr.width(d))
        across = mi.Frame3f(d)
        return cls(p1=zero, p2=mi.Vector3f(zero), d1=across.s + zero, d2=across.t + zero)

    def spread(self, length: mi.Float) -> Wavefront:
        """Return the wavefront after a straight segment of a given length [m]."""
        p1 = dr.fma(self.d1, length, self.p1)
        p2 = dr.fma(self.d2, length, self.p2)
        return Wavefront(p1=p1, p2=p2, d1=self.d1, d2=self.d2)

    def bend(
        self, si: mi.SurfaceInteraction3f, d: mi.Vector3f, out: mi.Vector3f, η: mi.Float
    ) -> Wavefront:
        """Return the wavefront after a delta lobe.

        Args:
            si: Surface interaction, computed with `mi.RayFlags.dNSdUV`.
            d: Direction before the lobe.
            out: Direction after the lobe.
            η: Index of refraction after the lobe, relative to the index before.
        """
        p1, d1 = _bend(self.p1, self.d1, si, d, out, η)
        p2, d2 = _bend(self.p2, self.d2, si, d, out, η)
        return Wavefront(p1=p1, p2=p2, d1=d1, d2=d2)

    def area(self, d: mi.Vector3f) -> mi.Float:
        """Return the area of the wavefront per solid angle at its start [m²/sr].

        Args:
            d: Current direction of the ray.
        """
        return dr.abs(dr.dot(dr.cross(self.p1, self.p2), d))


def _bend(
    p: Any, v: Any, si: mi.SurfaceInteraction3f, d: mi.Vector3f, out: mi.Vector3f, η: mi.Float
) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Return the derivatives of point and direction after a delta lobe.

    Args:
        p: Derivative of the point before the lobe [m/rad].
        v: Derivative of the direction before the lobe.
        si: Surface interaction, computed with `mi.RayFlags.dNSdUV`.
        d: Direction before the lobe.
        out: Direction after the lobe.
        η: Index of refraction after the lobe, relative to the index before.
    """
    # Project the derivative of the point along the ray to the surface
    p = p - d * (dr.dot(p, si.n) / dr.dot(d, si.n))

    # Find the derivative of the normal, by the metric of the surface
    uu = dr.squared_norm(si.dp_du)
    uv = dr.dot(si.dp_du, si.dp_dv)
    vv = dr.squared_norm(si.dp_dv)
    pu = dr.dot(p, si.dp_du)
    pv = dr.dot(p, si.dp_dv)
    area2 = uu * vv - uv * uv
    dn = (si.dn_du * (vv * pu - uv * pv) + si.dn_dv * (uu * pv - uv * pu)) / area2

    # Flip the normal to the side of the incident ray
    side = -dr.sign(dr.dot(si.sh_frame.n, d))
    n = mi.Vector3f(si.sh_frame.n) * side
    dn = mi.Vector3f(dn) * side

    # With the cosines c and c', reflection is d + 2 c n, and refraction is d / η + (c / η - c') n.
    # Differentiate both
    c = -dr.dot(d, n)
    c_out = -dr.dot(out, n)
    inverse = 1 / η
    dc = -dr.dot(v, n) - dr.dot(d, dn)
    reflected = v + 2 * (dc * n + c * dn)
    refracted = inverse * v + (inverse * c - c_out) * dn
    refracted += inverse * dc * (1 - inverse * c / c_out) * n
    return p, dr.select(c_out < 0, reflected, refracted)
