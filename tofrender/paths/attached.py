"""Derivatives with detached sampling: of what paths carry, not of the samples that they follow.

A vertex that a path has found by a random direction is a point of a surface. If the scene changes,
it is fixed on that surface, and the direction to it changes. The integral over directions is one
over surface points then, whose domain no surface leaves by moving:

    f(x, ω) dω = f(x, y) G(x, y) dA(y),     G = |cos θ_y| / |y - x|²

The density is that of the unchanged scene; f, G and dA change. Along single directions (camera
rays, mirrors, glass) there is no choice: the next vertex slides along the ray. MIS weights are
those of the changed scene, so that they add up to 1 in it.

This is the material form of T. Zeltner et al., "Monte Carlo Estimators for Differential Light
Transport", SIGGRAPH 2021 (detached sampling), and of C. Zhang et al., "Path-Space Differentiable
Rendering", SIGGRAPH 2020 (material points). It leaves out what becomes visible or hidden, and hard
edges of gates.

**Free flights through media** have detached distances: a point that scatters is fixed relative to
the surface behind it, or in its distance where there is none. The weight of a flight changes by

    exp(-∫ σ_t ds) σ_s ds

with the extinction σ_t, the length s, and for a point that scatters σ_s and its stretch. In a
single homogeneous medium the integral is a product. Through grids and index-matched boundaries, its
derivative is estimated at one uniform point of the flight: the length times the derivative of σ_t
there. Surfaces may move in the former only.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import intensity, multiply_throughput
from .flight import Flight
from .media import Media, medium_interaction
from .phases import as_surface
from .protocols import Scattering, ScatteringWrapper
from .records import BSDFEval, BSDFSample, Connection, MediumPoint, Path, Vertex
from .surfaces import changing, element, spawn_ray


class Detached(ScatteringWrapper):
    """Scattering with detached sampling: sampled directions lead to the same surface points.

    `single` says whether it may sample delta lobes, whose directions have derivatives.
    """

    def __init__(self, inner: Scattering, scene: mi.Scene, single: bool) -> None:
        super().__init__(inner)
        self.scene, self.single = scene, single

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Complete the inner sample; its density is detached."""
        completed = self.inner.complete_sample(replace(path, β=mi.UnpolarizedSpectrum(1)), vertex)
        return replace(completed, β=multiply_throughput(path.β, dr.detach(intensity(completed.β))))

    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Evaluate a connection, and sample a direction to a detached point."""
        bsdf_eval = self.inner.eval_connection(vertex, connection)

        # Sample a direction, and find the detached point y that it leads to
        with dr.suspend_grad(when=not self.single):
            _, bsdf_sample = self.inner.sample(vertex, None, sampler, active)
        chosen = active & ~bsdf_sample.specular
        with dr.suspend_grad():
            ray = dr.detach(bsdf_sample.ray)
            ahead = self.scene.ray_intersect_preliminary(ray, active=chosen)
        flags = mi.RayFlags.All | mi.RayFlags.FollowShape
        y = ahead.compute_surface_interaction(ray, flags, chosen)
        found = chosen & y.is_valid()
        onto = dr.select(found, y.p - vertex.si.p, ray.d)
        d = dr.normalize(onto)

        # Evaluate the BSDF, and the area that the solid angle covers at y, in the changed scene
        again = self.inner.eval_pdf(vertex, d, chosen)
        seen = dr.abs(dr.dot(y.n, d)) / dr.squared_norm(onto) * element(y)
        change = changing(seen, found)

        bsdf_sample.weight = dr.select(
            chosen, _reweighted(bsdf_sample.weight, again.f) * change, bsdf_sample.weight
        )
        same = dr.detach(again.pdf)
        pdf = dr.detach(bsdf_sample.pdf) * dr.select(same > 0, again.pdf / same, 1)
        bsdf_sample.pdf = dr.select(chosen, pdf, bsdf_sample.pdf)
        bsdf_sample.η = dr.select(chosen, again.η, bsdf_sample.η)
        onwards = spawn_ray(vertex.si, d, mi.Bool(False))
        bsdf_sample.ray.o = dr.select(chosen, dr.replace_grad(ray.o, onwards.o), bsdf_sample.ray.o)
        bsdf_sample.ray.d = dr.select(chosen, dr.replace_grad(ray.d, d), bsdf_sample.ray.d)
        return bsdf_eval, bsdf_sample


class AttachedMedia(Media):
    """Media with derivatives by coefficients, and by surfaces around one homogeneous medium."""

    def __init__(self, media: Media) -> None:
        vars(self).update(vars(media))

    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Delegate to `Media`, with derivatives."""
        # Sample the detached flight
        with dr.suspend_grad():
            flight, weight = self.sample_flight(path, sampler)
        ray, o, here, medium = path.ray, path.prev.p, flight.scattered, flight.medium

        # Find the surface behind it; through boundaries, the one that it met
        if self.repeats:
            met = path.active & ~here
            si = flight.pi.compute_surface_interaction(flight.ray, mi.RayFlags.All, met)
        else:
            si = self.scene.ray_intersect(ray, active=path.active)
        distance = dr.norm(si.p - o)
        stretch = dr.select(here & si.is_valid(), distance / dr.detach(distance), 1)
        length = dr.select(here, flight.distance * stretch, distance)

        # Derivatives of σ_s at a scattering point, and of the transmittance up to it
        mei = medium_interaction(ray, dr.fma(ray.d, dr.select(here, length, 0), o), medium)
        inside = path.active & here & (medium != None)  # noqa: E711 (a Dr.Jit mask)
        σ_s, _, _ = medium.get_scattering_coefficients(mei, inside)
        scattered = dr.select(inside & (σ_s > 0), σ_s / dr.detach(σ_s), 1) * stretch
        leaves = ~here & ~si.is_valid()
        if self.repeats:
            # Behind the last boundary is no medium
            length = dr.select(leaves, flight.distance, length)
        within = path.active & (self.repeats | ~leaves)
        change = self._transmittance_change(path.medium, ray, o, length, sampler, within)
        path = replace(
            path, medium=medium, β=multiply_throughput(path.β, weight * change * scattered)
        )
        point, valid = as_surface(si, mei, here), here | si.is_valid()
        return path, Vertex(point, dr.norm(point.p - o), valid, MediumPoint(mei, here))

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> mi.Spectrum:
        """Delegate to `Media`, with derivatives."""
        if not self.repeats:
            return super().transmittance(path, vertex, connection, sampler)
        with dr.suspend_grad():
            transmittance = super().transmittance(path, vertex, connection, sampler)
        o, ray = vertex.si.p, vertex.si.spawn_ray_to(connection.point)
        medium = self.medium_behind(path, vertex, connection.direction)
        length = connection.medium_length
        length = dr.norm(connection.point - o) if length is None else length
        change = self._transmittance_change(medium, ray, o, length, sampler, connection.active)
        return transmittance * change

    def _transmittance_change(
        self,
        medium: mi.MediumPtr,
        ray: mi.Ray3f,
        o: mi.Point3f,
        length: mi.Float,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Return 1, with the derivative of transmittance over a length."""
        at = mi.Float(0)
        if self.repeats:
            with dr.suspend_grad():
                at = sampler.next_1d() * length
                medium = self._medium_at(medium, ray, o, at, active)
            length = dr.detach(length)
        inside = active & (medium != None)  # noqa: E711 (a Dr.Jit mask)
        mei = medium_interaction(ray, dr.fma(ray.d, dr.detach(at), o), medium)
        _, _, σ_t = medium.get_scattering_coefficients(mei, inside)
        optical_depth = σ_t * dr.select(inside, length, 0)
        return dr.select(inside, dr.exp(dr.detach(optical_depth) - optical_depth), 1)

    @dr.syntax
    def _medium_at(
        self, medium: mi.MediumPtr, ray: mi.Ray3f, o: mi.Point3f, at: mi.Float, active: mi.Bool
    ) -> mi.MediumPtr:
        """Return the medium at a distance along rays that only cross boundaries before."""
        flight = Flight.start(ray, medium, active, mi.Bool(False))
        while flight.needs_intersection:
            flight = self._intersect(flight, o)
            before = flight.needs_intersection & flight.pi.is_valid() & (flight.end < at)
            flight, _ = self._cross_boundary(flight, before, connects=True)
        return flight.medium


def _reweighted(weight: mi.Spectrum, f: mi.Spectrum) -> mi.Spectrum:
    """Return a sample weight with the derivatives of the BSDF f; its density stays."""
    f_0, weight_0 = dr.detach(intensity(f)), dr.detach(intensity(weight))
    highest = dr.max(f_0)
    usual = dr.select(highest > 0, dr.max(weight_0) / highest, 0)
    ratio = dr.select(f_0 > 0, weight_0 / f_0, usual)
    return dr.detach(weight) + multiply_throughput(f - dr.detach(f), ratio)
