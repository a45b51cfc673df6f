"""Media with derivatives, for detached sampling (see `gradients.detached`).

Distances of free flights are detached: a point that scatters is fixed relative to
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

from ..paths.records import Connection, MediumPoint, Path, Vertex
from ..signals.polarisation import multiply_throughput
from .flight import Flight
from .phases import as_surface
from .space import Media, medium_interaction


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
        change = self._transmittance_change(
            path.medium, ray, o, length, sampler, within, path.passed
        )
        path = replace(
            path, medium=medium, β=multiply_throughput(path.β, weight * change * scattered)
        )
        point, valid = as_surface(si, mei, here), here | si.is_valid()
        passes = self._stopped(path, flight, si)
        return path, Vertex(point, dr.norm(point.p - o), valid, MediumPoint(mei, here), passes)

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
        start: mi.Float | None = None,
    ) -> mi.Spectrum:
        """Return 1, with the derivative of transmittance from `start` (0 if None) to a length."""
        at = mi.Float(0)
        if self.repeats:
            with dr.suspend_grad():
                first = mi.Float(0) if start is None else start
                at = dr.fma(sampler.next_1d(), length - first, first)
                medium = self._medium_at(medium, ray, o, at, active)
            length = dr.detach(length - first)
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
