"""Connections to a laser spot through mirrors and glass, by specular manifold sampling.

A laser spot is a point, or a beam that hits another point for each connection. No ray finds this
point by chance, and a mirror does not reflect a straight connection. A vertex y and the spot p are
connected by only a few chains of delta lobes of mirrors and clear glass. These chains are found as
in Zeltner, Georgiev, and Jakob, "Specular Manifold Sampling" (SIGGRAPH 2020):

1. A random ray from y towards a mirror or glass follows random delta lobes. Their indices are
   stored.
2. Newton's method rotates the initial direction until the ray passes through p, with the same
   lobes. Ray differentials give the derivative. If all mirrors are flat, one step is enough.
3. A chain that is found with the probability P has the weight 1/P. The number of further trials
   until the same chain is found again has this mean.

Let F be the product of all lobes of a chain. The irradiance on a surface at y that faces it is

    E = Phi f_p F / A   [W/m²]

A is the area at p, across the ray, per solid angle at y. With flat mirrors, A is the square of the
chain's length. F includes the change of radiance by refraction.
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
"""Largest number of delta vertices of a chain. Lobe indices use four bits each of one integer."""

MOST_TRIALS = 1 << 14
"""Largest number of trials until a chain is found again. Rarer chains are too dark."""

MOST_STEPS = 20
"""Largest number of steps of Newton's method."""

CLOSE = 3e-5
"""Newton's method has converged at this distance of ray and spot, relative to the length."""

SAME = 1e-3
"""Two chains are the same if their directions differ by less [rad]."""

SHORT = 1e-4
"""Last part of the ray to the spot that shadow rays leave out, because of rounding."""

DRAWS = 64
"""Random numbers reserved for a trial: two for its direction, and two for each vertex."""


@dataclass
class LobeSequence:
    """Sequence of delta lobes."""

    # Number of lobes
    count: mi.UInt32

    # Indices of the lobes, four bits each
    code: mi.UInt64


@dataclass
class Chain:
    """A ray from a vertex through a sequence of delta lobes, and beyond the laser spot."""

    # Lanes in which the ray hits surfaces with all lobes
    exists: mi.Bool

    # First delta vertex [m]
    first: mi.Point3f

    # Ray after the last delta vertex
    last: mi.Ray3f

    # Product of the lobes
    f: mi.UnpolarizedSpectrum

    # Lanes with a delta vertex off the relay wall
    off_wall: mi.Bool

    # Optical length up to the spot, divided by the index of refraction at the start [m]
    length: mi.Float

    # Index of refraction at the spot, relative to the index at the start
    η: mi.Float

    # Area at the spot, across the ray, per solid angle at the start [m²/sr]
    area: mi.Float

    # Signed length from the last delta vertex to the spot [m]
    ahead: mi.Float

    # Distance of ray and spot, relative to the length of the chain
    miss: mi.Float

    # Newton's step of the initial direction
    step: mi.Vector3f


class SpecularConnections:
    """Connections to a laser spot through delta lobes, in addition to the straight connection.

    Args:
        scan: The scan.
        beam: Function that samples the laser spot of a connection, as for `LaserSpot`.
        max_depth: Longest path in segments, -1 without a limit.
    """

    def __init__(self, scan: Scan, beam: Beam, max_depth: int) -> None:
        assert scan.specular is not None
        self.scan = scan
        self.beam = beam
        self.max_depth = max_depth
        self.lobes = scan.specular.lobes
        self.targets = scan.specular.targets

    def count(self, path: Path) -> mi.UInt32:
        """Return the number of further connections of a path's last vertex, 1."""
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
        """Connect a vertex to the laser spot by one random chain.

        Args:
            k: Index of the connection.
            first: The straight connection.
            vertex: The vertex.
            path: The path up to the vertex.
            sampler: The sampler.
            active: Active lanes.
        """
        # Sample the laser spot
        scan = self.scan
        spot = self.beam(sampler, active)
        seeds = random_seeds(sampler)

        # How many delta vertices are allowed?
        most = mi.UInt32(MOST_VERTICES)
        if self.max_depth >= 0:
            left = mi.Int32(self.max_depth) - 2 - mi.Int32(path.depth + spot.bounces)
            most = mi.UInt32(dr.clip(left, 0, MOST_VERTICES))
        active = active & (most > 0) & dr.any(spot.power > 0)

        # Find a chain and the reciprocal of its probability
        d, lobes, trials = self._sample_chain(vertex, spot.si.p, most, seeds, active)
        active = active & (trials > 0)
        chain = self._follow(vertex, d, lobes, spot.si.p, active)
        active = active & chain.exists

        # Does the path count?
        if scan.bounces >= 0:
            bounces = path.depth + 2 + lobes.count + spot.bounces
            active = active & (bounces == scan.bounces)
        if scan.hidden_only:
            active = active & ((path.history != 0) | chain.off_wall | spot.off_wall)

        # Evaluate the light of the spot, attenuated by media
        f_spot = mi.unpolarized_spectrum(spot.eval(-chain.last.d, active))
        weight = spot.power * f_spot * chain.f * (mi.Float(trials) / chain.area)
        if scan.space.scatters:
            weight = weight * self._transmittance(
                vertex, path, d, lobes, spot.si.p, sampler, active
            )
        weight = dr.select(active, weight, 0)
        active = active & ~dr.all(weight == 0)
        return Connection(
            point=chain.first,
            direction=d,
            weight=weight,
            length=dr.fma(chain.η, spot.distance, chain.length),
            active=active,
            unoccluded=mi.Bool(True),
        )

    @dr.syntax
    def _sample_chain(
        self,
        vertex: Vertex,
        p: mi.Point3f,
        most: mi.UInt32,
        seeds: list[mi.UInt32],
        active: mi.Bool,
    ) -> tuple[mi.Vector3f, LobeSequence, mi.UInt32]:
        """Sample a chain to a point, and count the trials until it is found again.

        Args:
            vertex: Start of the chain.
            p: End of the chain.
            most: Largest number of delta vertices.
            seeds: The two seeds of the random numbers.
            active: Active lanes.

        Returns:
            The initial direction and the lobes of the chain, and the number of trials, which is 0
            if no chain was found.
        """
        # ----------------------- Loop state -----------------------

        # Index of the current trial
        trial = mi.UInt32(0)

        # Trials after the first, until the same chain was found
        trials = mi.UInt32(0)

        # Direction and lobes of the first trial
        found = mi.Vector3f(0, 0, 1)
        lobes = LobeSequence(mi.UInt32(0), mi.UInt64(0))

        # Lanes that continue
        searching = mi.Bool(active)
        while searching:
            # ---------------- Is this the chain of the first trial? ----------------

            d, tried, exists = self._try_chain(vertex, p, most, seeds, trial, searching)
            is_first = trial == 0
            close = dr.squared_norm(d - found) < SAME**2
            same = exists & close & (tried.code == lobes.code) & (tried.count == lobes.count)

            # -------------- Store the first trial, stop at the same chain --------------

            found = dr.select(is_first, d, found)
            lobes = dr.select(is_first, tried, lobes)
            trials = dr.select(is_first & ~exists, 0, trial)
            searching &= dr.select(is_first, exists, ~same & (trial < MOST_TRIALS))
            trial += 1
        return found, lobes, trials

    @dr.syntax
    def _try_chain(
        self,
        vertex: Vertex,
        p: mi.Point3f,
        most: mi.UInt32,
        seeds: list[mi.UInt32],
        trial: mi.UInt32,
        active: mi.Bool,
    ) -> tuple[mi.Vector3f, LobeSequence, mi.Bool]:
        """Try to find a chain to a point.

        Args:
            vertex: Start of the chain.
            p: End of the chain.
            most: Largest number of delta vertices.
            seeds: The two seeds of the random numbers.
            trial: Index of this trial.
            active: Active lanes.

        Returns:
            The initial direction, the lobes, and the lanes in which a chain was found.
        """
        # ------------- Sample lobes, towards a random point of the mirrors and glass -------------

        number = seeds[0] + trial * DRAWS
        u = mi.Point2f(random_number(number, seeds[1]), random_number(number + 1, seeds[1]))
        point, _ = self.targets.sample(u, active)
        d = mi.Vector3f(dr.normalize(point.p - vertex.si.p))
        lobes = self._sample_lobes(vertex, d, most, number + 2, seeds[1], active)

        # --------------- Rotate the direction until the ray hits the spot ---------------

        # Direction of the next evaluation
        tried = mi.Vector3f(d)

        # Best chain so far: its Newton step, its miss, its last ray, and the length of this ray [m]
        step = mi.Vector3f(0)
        miss = mi.Float(dr.inf)
        last = mi.Ray3f(vertex.si.p, d)
        ahead = mi.Float(0)

        # Fraction of Newton's step that is applied
        fraction = mi.Float(1)

        # Number of steps, and lanes that continue
        steps = mi.UInt32(0)
        running = active & (lobes.count > 0)
        while running:
            # Did the last step help?
            chain = self._follow(vertex, tried, lobes, p, running)
            better = chain.exists & (chain.miss < miss)
            d = dr.select(better, tried, d)
            step = dr.select(better, chain.step, step)
            miss = dr.select(better, chain.miss, miss)
            ahead = dr.select(better, chain.ahead, ahead)
            last.o = dr.select(better, chain.last.o, last.o)
            last.d = dr.select(better, chain.last.d, last.d)

            # Continue with a longer step after a success, otherwise with a shorter step
            fraction = dr.select(better, dr.minimum(2 * fraction, 1), 0.5 * fraction)
            tried = mi.Vector3f(dr.normalize(dr.fma(step, fraction, d)))
            steps += 1
            running &= (miss > CLOSE) & dr.isfinite(miss) & (steps < MOST_STEPS)
        exists = active & (miss <= CLOSE) & (ahead > 0)

        # -------- Is the last segment occluded? With media, `_transmittance` finds out --------

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
    ) -> LobeSequence:
        """Follow random delta lobes up to a surface with smooth lobes.

        Args:
            vertex: Start of the ray.
            d: Direction of the ray.
            most: Largest number of lobes.
            number: Index of the first random number.
            seed: Seed of the random numbers.
            active: Active lanes.
        """
        # Sequence of lobes, next ray, and lanes that continue
        lobes = LobeSequence(mi.UInt32(0), mi.UInt64(0))
        ray = spawn_ray(vertex.si, d, mi.Bool(True))
        following = mi.Bool(active)
        while following:
            si = self._hit(ray, following)
            # Does the ray end here? If a surface has both kinds of lobes, half of the rays end
            smooth = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Smooth) & (lobes.count > 0)
            ends = smooth & (random_number(number, seed) < 0.5)
            following &= si.is_valid() & ~ends

            # Sample a delta lobe and append its index
            lobe = self.lobes.sample(si, random_number(number + 1, seed), following)
            following &= dr.any(lobe.f > 0)
            shifted = mi.UInt64(lobe.lobe) << mi.UInt64(4 * lobes.count)
            lobes.code = dr.select(following, lobes.code | shifted, lobes.code)
            lobes.count = dr.select(following, lobes.count + 1, lobes.count)
            following &= lobes.count < most

            # Continue after the surface
            ray = dr.select(following, spawn_ray(si, lobe.direction, mi.Bool(True)), ray)
            number += 2
        return lobes

    @dr.syntax
    def _follow(
        self, vertex: Vertex, d: mi.Vector3f, lobes: LobeSequence, p: mi.Point3f, active: mi.Bool
    ) -> Chain:
        """Follow a sequence of lobes, and find where the ray passes a point.

        Args:
            vertex: Start of the ray.
            d: Direction of the ray.
            lobes: The sequence of lobes.
            p: The point.
            active: Active lanes.
        """
        # ----------------------- Loop state -----------------------

        # Next ray, the last vertex, and the first delta vertex
        start = vertex.si.p
        ray = spawn_ray(vertex.si, d, mi.Bool(True))
        at = mi.Point3f(start)
        first = mi.Point3f(start)

        # Derivatives of the ray by its initial direction
        front = Wavefront.start(d)

        # Product of the lobes
        f = mi.UnpolarizedSpectrum(1) + dr.zeros(mi.Float, dr.width(d))

        # Geometric and optical length [m], and relative index of refraction
        length = mi.Float(0)
        optical = mi.Float(0)
        η = mi.Float(1)

        # Lanes with a delta vertex off the relay wall
        off_wall = mi.Bool(False)

        # Index of the next lobe, lanes in which all lobes exist, and lanes that continue
        k = mi.UInt32(0)
        exists = mi.Bool(active)
        following = active & (k < lobes.count)
        while following:
            # -------------------- Find the lobe of the next surface --------------------

            si = self._hit(ray, following, int(mi.RayFlags.dNSdUV))
            number = mi.UInt32((lobes.code >> mi.UInt64(4 * k)) & 15)
            lobe = self.lobes.eval(si, number, following)
            passes = following & si.is_valid() & dr.any(lobe.f > 0)

            # ---------------- Update wavefront, length and throughput ----------------

            segment = dr.norm(si.p - at)
            spread = front.spread(segment)
            front = dr.select(passes, spread.bend(si, ray.d, lobe.direction, lobe.η), front)
            length = dr.select(passes, length + segment, length)
            optical = dr.select(passes, dr.fma(η, segment, optical), optical)
            f = dr.select(passes, f * lobe.f, f)
            η = dr.select(passes, η * lobe.η, η)
            off_wall |= passes & ~is_on(si, self.scan.wall)

            # --------------------- Continue after the surface ---------------------

            ray = dr.select(passes, spawn_ray(si, lobe.direction, mi.Bool(True)), ray)
            at = dr.select(passes, si.p, at)
            first = dr.select(passes & (k == 0), si.p, first)
            exists &= passes
            k += 1
            following = passes & (k < lobes.count)

        # Where does the ray, or its backward extension, pass the point?
        ahead = dr.dot(p - at, ray.d)
        offset_world = mi.Vector3f(p - dr.fma(ray.d, ahead, at))
        front = front.spread(ahead)
        length += dr.abs(ahead)
        optical = dr.fma(η, ahead, optical)

        # Newton's step: solve (p1 p2) (a b) = offset in the plane across the ray
        across = mi.Frame3f(ray.d)
        p1 = across.to_local(front.p1)
        p2 = across.to_local(front.p2)
        offset = across.to_local(offset_world)
        determinant = p1.x * p2.y - p1.y * p2.x
        a = (offset.x * p2.y - offset.y * p2.x) / determinant
        b = (p1.x * offset.y - p1.y * offset.x) / determinant
        axes = mi.Frame3f(d)
        step = mi.Vector3f(a * axes.s + b * axes.t)
        miss = dr.norm(offset_world) / length
        exists &= dr.isfinite(a + b + miss)
        return Chain(
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
        lobes: LobeSequence,
        p: mi.Point3f,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> mi.UnpolarizedSpectrum:
        """Estimate the transmittance after the first delta vertex, 0 if a segment is occluded.

        Args:
            vertex: Start of the chain.
            path: The path up to this vertex.
            d: Initial direction of the chain.
            lobes: Lobes of the chain.
            p: The laser spot.
            sampler: The sampler.
            active: Active lanes.
        """
        # Medium of the next segment, and transmittance so far
        space = self.scan.space
        ray = spawn_ray(vertex.si, d, mi.Bool(True))
        medium = space.medium_behind(path, vertex, d)
        transmittance = mi.UnpolarizedSpectrum(1) + dr.zeros(mi.Float, dr.width(d))

        # Index of the next lobe, lanes that continue, and next surface
        k = mi.UInt32(0)
        following = mi.Bool(active)
        si = self._hit(ray, following)
        while following:
            # Find the segment after the next lobe
            number = mi.UInt32((lobes.code >> mi.UInt64(4 * k)) & 15)
            lobe = self.lobes.eval(si, number, following)
            ray = spawn_ray(si, lobe.direction, mi.Bool(True))
            k += 1
            is_last = k == lobes.count
            next_si = self._hit(ray, following & ~is_last)
            end = dr.select(is_last, p, next_si.p)

            # Attenuate the light on this segment
            segment = Connection.to_point(end, lobe.direction, dr.norm(end - si.p), following)
            segment.unoccluded = ~is_last
            there = replace(path, medium=medium)
            at = Vertex(si, mi.Float(0), following)
            passed = space.transmittance(there, at, segment, sampler)
            medium = passed.medium
            transmittance = dr.select(following, transmittance * passed.value, transmittance)
            si = dr.select(is_last, si, next_si)
            following &= ~is_last
        return transmittance

    def _hit(self, ray: mi.Ray3f, active: mi.Bool, more_flags: int = 0) -> mi.SurfaceInteraction3f:
        """Intersect rays with surfaces, except boundaries of media, which are not vertices."""
        scene = self.scan.scene
        if self.scan.space.scatters:
            return first_surface(scene, ray, active, more_flags)
        return scene.ray_intersect(ray, int(mi.RayFlags.All) | more_flags, False, active)


def random_seeds(sampler: mi.Sampler) -> list[mi.UInt32]:
    """Sample the two seeds of a sequence of random numbers without a fixed length."""
    return [mi.UInt32(sampler.next_1d() * (1 << 24)) for _ in range(2)]


def random_number(number: mi.UInt32, seed: mi.UInt32) -> mi.Float:
    """Return a uniform random number in [0, 1).

    Args:
        number: Index of the random number, plus the first seed.
        seed: The second seed.
    """
    return mi.sample_tea_float32(number, seed)
