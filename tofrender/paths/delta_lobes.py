"""Delta lobes of surfaces, one by one, and wavefronts that follow them.

A lobe has a number. Number 0 is null transmission, straight through a pane, a mask or a polarizer.
Number 1 is reflection: all mirrors of a BSDF together, since they reflect in one direction. Number
k + 2 is refraction by component k of the BSDF. A BSDF may also have smooth lobes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .surfaces import bsdfs_in, materials, number_of

NULL = 0
"""Number of the lobe of null transmission."""

REFLECTION = 1
"""Number of the lobe of reflection."""

REFRACTION = 2
"""Number of the lobe of refraction by the first component."""

MOST_LOBES = 15
"""Largest number of a lobe: a number fits into four bits, see `nlos.light.specular`."""


@dataclass
class LobeSample:
    """Light on its way through one delta lobe."""

    lobe: mi.UInt32  # number of the lobe
    direction: mi.Vector3f  # direction behind the surface, world space
    f: mi.UnpolarizedSpectrum  # radiance behind the lobe over radiance before it, at most 1 / η²
    probability: mi.Float  # probability of this lobe in `sample`, else 1
    η: mi.Float  # index of refraction behind the surface, relative to that before


class DeltaLobes:
    """Delta lobes of all surfaces of a scene.

    Mitsuba's `sample` chooses among all lobes of a BSDF. Its `blendbsdf` mixes the probability of a
    delta lobe with the density of smooth lobes, and returns a wrong weight. Therefore each lobe is
    evaluated by the number of its component.
    """

    def __init__(self, scene: mi.Scene) -> None:
        bsdfs = [bsdf for bsdf in dict.fromkeys(materials(scene)) if bsdf is not None]
        self.sets = _table(bsdfs, [self.set_of(bsdf) for bsdf in bsdfs])
        self.mirrors = _table(bsdfs, [_mirrors_of(bsdf) for bsdf in bsdfs])
        self.backs = _table(bsdfs, [_mirrors_of(bsdf, only_back=True) for bsdf in bsdfs])
        self.mixed = _table(bsdfs, [self.are_mixed(bsdf) for bsdf in bsdfs])
        self.numbers = _members(self.sets)
        self.components = _members(self.mirrors)
        self.back_components = _members(self.backs)

    @staticmethod
    def set_of(bsdf: mi.BSDF) -> int:
        """Return the set of delta lobes of a BSDF: bit n is set if it has lobe number n."""
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
        """Whether delta lobes of a BSDF are mixed with smooth ones, or share a direction."""
        has = mi.has_flag
        if DeltaLobes.set_of(bsdf) and has(bsdf.flags(), mi.BSDFFlags.Smooth):
            return True
        components = [bsdf.flags(component) for component in range(bsdf.component_count())]
        for side in (mi.BSDFFlags.FrontSide, mi.BSDFFlags.BackSide):
            for kind in (mi.BSDFFlags.Null, mi.BSDFFlags.DeltaReflection):
                if sum(has(flags, side) and has(flags, kind) for flags in components) > 1:
                    return True
        return False

    @staticmethod
    def require_supported(shape: mi.Shape) -> None:
        """Refuse a shape if its delta lobes cannot be followed one by one."""
        kinds = [bsdf.class_name() for bsdf in bsdfs_in(shape.bsdf())]
        lobes = DeltaLobes.set_of(shape.bsdf())
        name = f"shape {shape.id()!r}"
        if lobes >> 1 and "MaskBSDF" in kinds:
            raise ValueError(f"{name}: a mask over a mirror or glass is not supported")
        for kind, plugin in (("NormalMap", "normalmap"), ("BumpMap", "bumpmap")):
            if kind in kinds:
                raise ValueError(f"{name}: a {plugin} of a mirror or glass is not supported")
        if lobes.bit_length() > MOST_LOBES + 1:
            raise ValueError(
                f"{name}: a BSDF of more than {MOST_LOBES} components is not supported"
            )

    def at(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UInt32:
        """Return the set of delta lobes at surface points, as bits; 0 if rays meet nothing."""
        return dr.gather(mi.UInt32, self.sets, number_of(si.bsdf()), active & si.is_valid())

    def mixed_at(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Return lanes with surface points whose delta lobes are mixed, see `are_mixed`."""
        mixed = dr.gather(mi.UInt32, self.mixed, number_of(si.bsdf()), active & si.is_valid())
        return mixed != 0

    def eval(self, si: mi.SurfaceInteraction3f, lobe: mi.UInt32, active: mi.Bool) -> LobeSample:
        """Follow a given lobe; `f` is 0 where the surface does not have it."""
        bits = self.at(si, active)
        found = self._none(si, lobe)
        for number in self.numbers:
            here = active & (lobe == number) & ((bits >> number & 1) != 0)
            found = dr.select(here, self._follow(si, number, here), found)
        return found

    def sample(self, si: mi.SurfaceInteraction3f, xi: mi.Float, active: mi.Bool) -> LobeSample:
        """Choose a lobe in proportion to the square root of the energy that it passes on.

        The square root favors weak lobes: their light often arrives in other time bins. `f` is 0
        where all lobes are black.
        """
        # Find all lobes, and their shares
        bits = self.at(si, active)
        lobes = []
        shares = []
        total = mi.Float(0)
        for number in self.numbers:
            here = active & ((bits >> number & 1) != 0)
            lobe = self._follow(si, number, here)
            share = dr.select(here, lobe.η * dr.sqrt(dr.max(lobe.f)), 0)
            lobes.append(lobe)
            shares.append(share)
            total += share

        # Choose one
        found = self._none(si, mi.UInt32(0))
        rest = xi * total
        for lobe, share in zip(lobes, shares, strict=True):
            lobe.probability = share / total
            chosen = (share > 0) & (rest >= 0)
            found = dr.select(chosen, lobe, found)
            rest = dr.select(share > 0, rest - share, rest)
        return found

    def _follow(self, si: mi.SurfaceInteraction3f, number: int, active: mi.Bool) -> LobeSample:
        """Evaluate the lobe of one number."""
        found = self._none(si, mi.UInt32(number))
        bsdf = si.bsdf()
        if number == NULL:
            found.f = mi.UnpolarizedSpectrum(bsdf.eval_null_transmission(si, active))
            found.f = dr.select(active, found.f, 0)
            return found
        if number != REFLECTION:
            return self._component(si, number - REFRACTION, found, active)

        # Add the mirrors. If `twosided` has two BSDFs, the components of the first one return
        # lobes of the second one behind the surface, which must not count twice
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
        """Add a component of the BSDF to a lobe."""
        context = mi.BSDFContext()
        context.component = component
        # A component alone is chosen with certainty
        half = mi.Point2f(0.5)
        bs, weight = si.bsdf().sample(context, si, mi.Float(0.5), half, active)
        exists = active & (bs.pdf > 0) & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        f = dr.select(exists, mi.unpolarized_spectrum(weight), 0)
        direction = dr.select(exists, si.to_world(bs.wo), lobe.direction)
        η = dr.select(exists, bs.eta, lobe.η)
        return LobeSample(lobe.lobe, direction, lobe.f + f, lobe.probability, η)

    @staticmethod
    def _none(si: mi.SurfaceInteraction3f, lobe: mi.UInt32) -> LobeSample:
        """Return a lobe that passes nothing on, straight ahead."""
        black = mi.UnpolarizedSpectrum(0) + dr.zeros(mi.Float, dr.width(si))
        return LobeSample(lobe, -si.to_world(si.wi), black, mi.Float(1), mi.Float(1))


def _mirrors_of(bsdf: mi.BSDF, *, only_back: bool = False) -> int:
    """Return the set of components of a BSDF that are mirrors, as bits, perhaps of its back."""
    found = 0
    for component in range(bsdf.component_count()):
        flags = bsdf.flags(component)
        is_front = mi.has_flag(flags, mi.BSDFFlags.FrontSide)
        if mi.has_flag(flags, mi.BSDFFlags.DeltaReflection) and not (only_back and is_front):
            found |= 1 << component
    return found


def _table(bsdfs: list[mi.BSDF], sets: list[int]) -> mi.UInt32:
    """Return a table of sets by the registry index of their BSDF."""
    rows = [int(number_of(mi.BSDFPtr(bsdf))[0]) for bsdf in bsdfs]
    table = np.zeros(max(rows, default=0) + 1, np.uint32)
    table[rows] = sets
    return mi.UInt32(table.tolist())


def _members(sets: mi.UInt32) -> list[int]:
    """Return the members of all sets of a table together."""
    together = int(np.bitwise_or.reduce(np.array(sets)))
    return [n for n in range(together.bit_length()) if together >> n & 1]


@dataclass
class Wavefront:
    """Ray differentials to both sides of a ray (Igehy, SIGGRAPH 1999)."""

    p1: mi.Vector3f  # derivatives of the point by the direction at the start [m/rad]
    p2: mi.Vector3f
    d1: mi.Vector3f  # derivatives of the direction by the direction at the start
    d2: mi.Vector3f

    @classmethod
    def start(cls, d: mi.Vector3f) -> Wavefront:
        """Create the wavefront at the start of rays, which vary along `mi.Frame3f(d)`."""
        zero = dr.zeros(mi.Vector3f, dr.width(d))
        across = mi.Frame3f(d)
        return cls(zero, mi.Vector3f(zero), across.s + zero, across.t + zero)

    def spread(self, length: mi.Float) -> Wavefront:
        """Return the wavefront behind a straight segment [m]."""
        p1 = dr.fma(self.d1, length, self.p1)
        p2 = dr.fma(self.d2, length, self.p2)
        return Wavefront(p1, p2, self.d1, self.d2)

    def bend(
        self, si: mi.SurfaceInteraction3f, d: mi.Vector3f, out: mi.Vector3f, η: mi.Float
    ) -> Wavefront:
        """Return the wavefront behind a delta lobe from `d` to `out`.

        `si` needs `mi.RayFlags.dNSdUV`; η is the index of refraction behind over that before.
        """
        p1, d1 = _bend(self.p1, self.d1, si, d, out, η)
        p2, d2 = _bend(self.p2, self.d2, si, d, out, η)
        return Wavefront(p1, p2, d1, d2)

    def area(self, d: mi.Vector3f) -> mi.Float:
        """Return the area across the ray per solid angle at its start [m²/sr]."""
        return dr.abs(dr.dot(dr.cross(self.p1, self.p2), d))


def _bend(
    p: Any, v: Any, si: mi.SurfaceInteraction3f, d: mi.Vector3f, out: mi.Vector3f, η: mi.Float
) -> tuple[mi.Vector3f, mi.Vector3f]:
    """Return derivatives of point and direction behind a delta lobe."""
    # Move along the ray onto the surface, and find how its normal changes there
    p = p - d * (dr.dot(p, si.n) / dr.dot(d, si.n))
    uu = dr.squared_norm(si.dp_du)
    uv = dr.dot(si.dp_du, si.dp_dv)
    vv = dr.squared_norm(si.dp_dv)
    pu = dr.dot(p, si.dp_du)
    pv = dr.dot(p, si.dp_dv)
    area2 = uu * vv - uv * uv
    dn = (si.dn_du * (vv * pu - uv * pv) + si.dn_dv * (uu * pv - uv * pu)) / area2
    side = -dr.sign(dr.dot(si.sh_frame.n, d))
    n = mi.Vector3f(si.sh_frame.n) * side
    dn = mi.Vector3f(dn) * side

    # Differentiate d + 2 c n, or d / η + (c / η - c') n with the cosines c and c'
    c = -dr.dot(d, n)
    c_out = -dr.dot(out, n)
    inverse = 1 / η
    dc = -dr.dot(v, n) - dr.dot(d, dn)
    reflected = v + 2 * (dc * n + c * dn)
    refracted = inverse * v + (inverse * c - c_out) * dn
    refracted += inverse * dc * (1 - inverse * c / c_out) * n
    return p, dr.select(c_out < 0, reflected, refracted)
