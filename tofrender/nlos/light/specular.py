"""Connections to a laser spot by way of mirrors and glass: specular manifold sampling.

A laser spot is a point, or a beam that lands on another point for each connection. No ray finds it,
and a mirror reflects no connection. Between a vertex y and the spot p there are only a few ways
through mirrors and clear glass. They are found as in Zeltner, Georgiev, and Jakob, "Specular
Manifold Sampling" (SIGGRAPH 2020):

1. A random ray from y towards a mirror or glass follows random delta lobes. Their numbers are kept.
2. Newton's method turns the ray's direction until the ray, by the same lobes, passes through p. Ray
   differentials give the derivative. One step is enough where all mirrors are flat.
3. A way that is found with the probability P has the weight 1/P. The number of further trials until
   the same way is found again has this mean.

A way of the transmission F, the product of all lobes, brings the irradiance

    E = Phi f_p F / A   [W/m²]

on a surface at y that faces it. A is the area at p, across the ray, per solid angle at y: r² on a
way of the length r by flat mirrors. The refraction of radiance is part of F.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from ...paths.delta_lobes import Wavefront
from ...paths.records import Connection, Path, Vertex
from ...paths.surfaces import (
    first_surface,
    is_on,
    spawn_ray,
)
from .scan import Beam, Scan

MOST_VERTICES = 16
"""Most delta vertices of a way: their lobes are kept in an integer, four bits for each."""

MOST_TRIALS = 1 << 14
"""Most trials until a way is found again. The weight of less likely ways is too small."""

MOST_STEPS = 20
"""Most steps of Newton's method."""

CLOSE = 3e-5
"""Distance of ray and spot, over the length of the way, at which Newton's method has converged."""

SAME = 1e-3
"""Distance of the directions of two ways, below which they are the same way [rad]."""

SHORT = 1e-4
"""Last part of the way to the spot that shadow rays leave out, because of rounding."""

DRAWS = 64
"""Random numbers of a trial: two for its direction, and two for each vertex."""


@dataclass
class Lobes:
    """Sequence of delta lobes."""

    count: mi.UInt32  # number of lobes
    code: mi.UInt64  # their numbers, four bits each


@dataclass
class Way:
    """A ray from a vertex through a sequence of delta lobes, and on past the laser spot."""

    exists: mi.Bool  # lanes in which the ray meets all lobes
    first: mi.Point3f  # first delta vertex [m]
    last: mi.Ray3f  # ray behind the last delta vertex
    f: mi.UnpolarizedSpectrum  # product of the lobes
    off_wall: mi.Bool  # lanes with a delta vertex off the relay wall
    length: mi.Float  # optical length up to the spot, over the index at the start [m]
    η: mi.Float  # index of refraction at the spot, over that at the start
    area: mi.Float  # area at the spot, across the ray, per solid angle at the start [m²/sr]
    ahead: mi.Float  # signed length from the last delta vertex to the spot [m]
    miss: mi.Float  # distance of ray and spot, over the length of the way
    step: mi.Vector3f  # Newton's step of the direction at the start


class SpecularConnections:
    """Connections to a laser spot by way of delta lobes, in addition to the straight one.

    Args:
        scan: The scan.
        beam: Returns the laser spot of a connection, as for `LaserSpot`.
        max_depth: Longest path in segments, -1 for any.
    """

    def __init__(self, scan: Scan, beam: Beam, max_depth: int) -> None:
        assert scan.specular is not None
        self.scan = scan
        self.beam = beam
        self.max_depth = max_depth
        self.lobes = scan.specular.lobes
        self.targets = scan.specular.targets

    def count(self, path: Path) -> mi.UInt32:
        """Return 1."""
        return mi.UInt32(1)

    def sample(
        self,
        k: mi.UInt32,
        first: Connection,
        vertex: Vertex,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Connect a vertex to the laser spot by one way, or by none."""
        scan = self.scan
        spot = self.beam(sampler, active)
        seeds = random_seeds(sampler)

        # How many delta vertices may there be?
        most = mi.UInt32(MOST_VERTICES)
        if self.max_depth >= 0:
            left = mi.Int32(self.max_depth) - 2 - mi.Int32(path.depth + spot.bounces)
            most = mi.UInt32(dr.clip(left, 0, MOST_VERTICES))
        active = active & (most > 0) & dr.any(spot.power > 0)

        # Find a way, its lobes, and the inverse of the probability to find it
        d, lobes, trials = self._find(vertex, spot.si.p, most, seeds, active)
        active = active & (trials > 0)
        way = self._follow(vertex, d, lobes, spot.si.p, active)
        active = active & way.exists

        # Does it count?
        if scan.bounces >= 0:
            bounces = path.depth + 2 + lobes.count + spot.bounces
            active = active & (bounces == scan.bounces)
        if scan.hidden_only:
            active = active & ((path.history != 0) | way.off_wall | spot.off_wall)

        # Light of the spot, and length
        f_spot = mi.unpolarized_spectrum(spot.eval(-way.last.d, active))
        weight = spot.power * f_spot * way.f * (mi.Float(trials) / way.area)
        if scan.space.scatters:
            weight = weight * self._transmittance(
                vertex, path, d, lobes, spot.si.p, sampler, active
            )
        weight = dr.select(active, weight, 0)
        active = active & ~dr.all(weight == 0)
        length = dr.fma(way.η, spot.distance, way.length)
        return Connection(way.first, d, weight, length, active, unoccluded=mi.Bool(True))

    @dr.syntax
    def _find(
        self,
        vertex: Vertex,
        p: mi.Point3f,
        most: mi.UInt32,
        seeds: list[mi.UInt32],
        active: mi.Bool,
    ) -> tuple[mi.Vector3f, Lobes, mi.UInt32]:
        """Find a random way to a point, and count the trials until it is found again.

        Returns direction and lobes of the way, and the number of trials, which is 0 without a way.
        """
        trial = mi.UInt32(0)
        trials = mi.UInt32(0)
        found = mi.Vector3f(0, 0, 1)
        lobes = Lobes(mi.UInt32(0), mi.UInt64(0))
        searching = mi.Bool(active)
        while searching:
            d, tried, exists = self._try(vertex, p, most, seeds, trial, searching)
            is_first = trial == 0
            close = dr.squared_norm(d - found) < SAME**2
            same = exists & close & (tried.code == lobes.code) & (tried.count == lobes.count)
            found = dr.select(is_first, d, found)
            lobes = dr.select(is_first, tried, lobes)
            trials = dr.select(is_first & ~exists, 0, trial)
            searching &= dr.select(is_first, exists, ~same & (trial < MOST_TRIALS))
            trial += 1
        return found, lobes, trials

    @dr.syntax
    def _try(
        self,
        vertex: Vertex,
        p: mi.Point3f,
        most: mi.UInt32,
        seeds: list[mi.UInt32],
        trial: mi.UInt32,
        active: mi.Bool,
    ) -> tuple[mi.Vector3f, Lobes, mi.Bool]:
        """Try to find a way to a point; returns direction, lobes, and lanes where there is one."""
        # Start towards a random point of the mirrors and glass
        number = seeds[0] + trial * DRAWS
        u = mi.Point2f(random_number(number, seeds[1]), random_number(number + 1, seeds[1]))
        point, _ = self.targets.sample(u, active)
        d = mi.Vector3f(dr.normalize(point.p - vertex.si.p))
        lobes = self._sample_lobes(vertex, d, most, number + 2, seeds[1], active)

        # Turn the direction until the ray meets the spot; shorten steps that do not help
        tried = mi.Vector3f(d)
        step = mi.Vector3f(0)
        miss = mi.Float(dr.inf)
        fraction = mi.Float(1)
        last = mi.Ray3f(vertex.si.p, d)
        ahead = mi.Float(0)
        steps = mi.UInt32(0)
        running = active & (lobes.count > 0)
        while running:
            way = self._follow(vertex, tried, lobes, p, running)
            better = way.exists & (way.miss < miss)
            d = dr.select(better, tried, d)
            step = dr.select(better, way.step, step)
            miss = dr.select(better, way.miss, miss)
            ahead = dr.select(better, way.ahead, ahead)
            last.o = dr.select(better, way.last.o, last.o)
            last.d = dr.select(better, way.last.d, last.d)
            fraction = dr.select(better, dr.minimum(2 * fraction, 1), 0.5 * fraction)
            tried = mi.Vector3f(dr.normalize(dr.fma(step, fraction, d)))
            steps += 1
            running &= (miss > CLOSE) & dr.isfinite(miss) & (steps < MOST_STEPS)
        exists = active & (miss <= CLOSE) & (ahead > 0)

        # Is the way from the last lobe to the spot free? Media are passed by `_transmittance`
        if dr.hint(not self.scan.space.scatters, mode="scalar"):
            last.maxt = dr.dot(p - last.o, last.d) * (1 - SHORT)
            exists &= ~self.scan.scene.ray_test(last, exists)
        return d, lobes, exists

    @dr.syntax
    def _sample_lobes(
        self,
        vertex: Vertex,
        d: mi.Vector3f,
        most: mi.UInt32,
        number: mi.UInt32,
        seed: mi.UInt32,
        active: mi.Bool,
    ) -> Lobes:
        """Follow random delta lobes up to a surface that has smooth lobes."""
        lobes = Lobes(mi.UInt32(0), mi.UInt64(0))
        ray = spawn_ray(vertex.si, d, mi.Bool(True))
        following = mi.Bool(active)
        while following:
            si = self._hit(ray, following)
            # Surfaces with both kinds of lobes end the way in half of the cases
            smooth = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth) & (lobes.count > 0)
            ends = smooth & (random_number(number, seed) < 0.5)
            following &= si.is_valid() & ~ends
            lobe = self.lobes.sample(si, random_number(number + 1, seed), following)
            following &= dr.any(lobe.f > 0)
            shifted = mi.UInt64(lobe.lobe) << mi.UInt64(4 * lobes.count)
            lobes.code = dr.select(following, lobes.code | shifted, lobes.code)
            lobes.count = dr.select(following, lobes.count + 1, lobes.count)
            following &= lobes.count < most
            ray = dr.select(following, spawn_ray(si, lobe.direction, mi.Bool(True)), ray)
            number += 2
        return lobes

    @dr.syntax
    def _follow(
        self, vertex: Vertex, d: mi.Vector3f, lobes: Lobes, p: mi.Point3f, active: mi.Bool
    ) -> Way:
        """Follow given lobes in a direction, and find where the ray passes a point."""
        start = vertex.si.p
        ray = spawn_ray(vertex.si, d, mi.Bool(True))
        at = mi.Point3f(start)
        first = mi.Point3f(start)
        front = Wavefront.start(d)
        f = mi.UnpolarizedSpectrum(1) + dr.zeros(mi.Float, dr.width(d))
        length = mi.Float(0)
        optical = mi.Float(0)
        η = mi.Float(1)
        off_wall = mi.Bool(False)
        k = mi.UInt32(0)
        exists = mi.Bool(active)
        following = active & (k < lobes.count)
        while following:
            # Follow the lobe of the next surface
            si = self._hit(ray, following, int(mi.RayFlags.dNSdUV))
            number = mi.UInt32((lobes.code >> mi.UInt64(4 * k)) & 15)
            lobe = self.lobes.eval(si, number, following)
            passes = following & si.is_valid() & dr.any(lobe.f > 0)

            # Update wavefront, length and throughput
            segment = dr.norm(si.p - at)
            spread = front.spread(segment)
            front = dr.select(passes, spread.bend(si, ray.d, lobe.direction, lobe.η), front)
            length = dr.select(passes, length + segment, length)
            optical = dr.select(passes, dr.fma(η, segment, optical), optical)
            f = dr.select(passes, f * lobe.f, f)
            η = dr.select(passes, η * lobe.η, η)
            off_wall |= passes & ~is_on(si, self.scan.wall)

            # Go on behind the surface
            ray = dr.select(passes, spawn_ray(si, lobe.direction, mi.Bool(True)), ray)
            at = dr.select(passes, si.p, at)
            first = dr.select(passes & (k == 0), si.p, first)
            exists &= passes
            k += 1
            following = passes & (k < lobes.count)

        # Where does the ray, or its backward extension, pass the point?
        ahead = dr.dot(p - at, ray.d)
        off = mi.Vector3f(p - dr.fma(ray.d, ahead, at))
        front = front.spread(ahead)
        length += dr.abs(ahead)
        optical = dr.fma(η, ahead, optical)

        # Newton's step: solve (p1 p2) (a b) = off in the plane across the ray
        across = mi.Frame3f(ray.d)
        p1 = across.to_local(front.p1)
        p2 = across.to_local(front.p2)
        offset = across.to_local(off)
        determinant = p1.x * p2.y - p1.y * p2.x
        a = (offset.x * p2.y - offset.y * p2.x) / determinant
        b = (p1.x * offset.y - p1.y * offset.x) / determinant
        axes = mi.Frame3f(d)
        step = mi.Vector3f(a * axes.s + b * axes.t)
        miss = dr.norm(off) / length
        exists &= dr.isfinite(a + b + miss)
        return Way(
            exists=exists,
            first=first,
            last=ray,
            f=f,
            off_wall=off_wall,
            length=optical,
            η=η,
            area=dr.abs(determinant),
            ahead=ahead,
            miss=miss,
            step=step,
        )

    @dr.syntax
    def _transmittance(
        self,
        vertex: Vertex,
        path: Path,
        d: mi.Vector3f,
        lobes: Lobes,
        p: mi.Point3f,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> mi.UnpolarizedSpectrum:
        """Estimate the transmittance of media behind the first delta vertex, 0 if blocked."""
        space = self.scan.space
        ray = spawn_ray(vertex.si, d, mi.Bool(True))
        medium = space.medium_behind(path, vertex, d)
        transmittance = mi.UnpolarizedSpectrum(1) + dr.zeros(mi.Float, dr.width(d))
        k = mi.UInt32(0)
        following = mi.Bool(active)
        si = self._hit(ray, following)
        while following:
            # Find the segment behind the next lobe
            number = mi.UInt32((lobes.code >> mi.UInt64(4 * k)) & 15)
            lobe = self.lobes.eval(si, number, following)
            ray = spawn_ray(si, lobe.direction, mi.Bool(True))
            k += 1
            is_last = k == lobes.count
            next_si = self._hit(ray, following & ~is_last)
            end = dr.select(is_last, p, next_si.p)

            # Attenuate the light on it
            segment = Connection.to_point(end, lobe.direction, dr.norm(end - si.p), following)
            segment.unoccluded = ~is_last
            there = replace(path, medium=medium)
            at = Vertex(si, mi.Float(0), following)
            factor, medium = space.transmittance_and_medium(there, at, segment, sampler)
            transmittance = dr.select(following, transmittance * factor, transmittance)
            si = dr.select(is_last, si, next_si)
            following &= ~is_last
        return transmittance

    def _hit(self, ray: mi.Ray3f, active: mi.Bool, more_flags: int = 0) -> mi.SurfaceInteraction3f:
        """Intersect rays with the surfaces that are vertices of paths."""
        scene = self.scan.scene
        if self.scan.space.scatters:
            return first_surface(scene, ray, active, more_flags)
        return scene.ray_intersect(ray, int(mi.RayFlags.All) | more_flags, False, active)


def random_seeds(sampler: mi.Sampler) -> list[mi.UInt32]:
    """Sample the two seeds of a sequence of random numbers of any length."""
    return [mi.UInt32(sampler.next_1d() * (1 << 24)) for _ in range(2)]


def random_number(number: mi.UInt32, seed: mi.UInt32) -> mi.Float:
    """Return a random number in [0, 1) of a sequence; `number` starts at the first seed."""
    return mi.sample_tea_float32(number, seed)
