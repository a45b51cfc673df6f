"""Derivatives of free flights through media.

How far a flight goes is detached: a point that scatters keeps its place on the way to the surface
behind it, or its distance where there is none. What the flight carries changes by

    exp(-∫ σ_t ds) σ_s ds

with the extinction σ_t, the length s, and for a point that scatters σ_s and the stretch of its way.
In a single homogeneous medium the integral is a product. Through grids and boundaries of equal
index, its change is estimated at one even random point of the way: the length times the change of
σ_t there. Things may move in the former only.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import drjit as dr
import mitsuba as mi

from .flight import Flight
from .media import Media, medium_interaction
from .phases import as_surface
from .records import Connection, MediumPoint, Path, Vertex, extend


class AttachedMedia(Media):
    """Media with derivatives by coefficients, and by surfaces around one homogeneous medium.

    Args:
        media: The media.
    """

    def __init__(self, media: Media) -> None:
        vars(self).update(vars(media))

    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Delegate to `Media`, with derivatives."""
        with dr.suspend_grad():
            flight, weight = self.sample_flight(path, sampler)
        ray, o, here, medium = path.ray, path.prev.p, flight.scattered, flight.medium
        si = self._surface(path, flight)
        way = dr.norm(si.p - o)
        stretch = dr.select(here & si.is_valid(), way / dr.detach(way), 1)
        length = dr.select(here, flight.distance * stretch, way)
        mei = medium_interaction(ray, dr.fma(ray.d, dr.select(here, length, 0), o), medium)
        inside = path.active & here & (medium != None)  # noqa: E711 (a Dr.Jit mask)
        σ_s, _, _ = medium.get_scattering_coefficients(mei, inside)
        scattered = dr.select(inside & (σ_s > 0), σ_s / dr.detach(σ_s), 1) * stretch
        leaves = ~here & ~si.is_valid()
        if self.repeats:
            length = dr.select(
                leaves, flight.distance, length
            )  # Behind its last boundary is no medium
        within = path.active & (self.repeats | ~leaves)
        change = self._change(path.medium, ray, o, length, sampler, within)
        path = copy(path)
        path.medium = medium
        path.β = extend(path.β, weight * change * scattered)
        point = as_surface(si, mei, here)
        valid = here | si.is_valid()
        return path, Vertex(point, dr.norm(point.p - o), valid, MediumPoint(mei, here))

    def _surface(self, path: Path, flight: Flight) -> mi.SurfaceInteraction3f:
        """Return the surface behind a flight; through boundaries, the one that it met."""
        if not self.repeats:
            return self.scene.ray_intersect(path.ray, active=path.active)
        met = path.active & ~flight.scattered
        return flight.pi.compute_surface_interaction(flight.ray, mi.RayFlags.All, met)

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> Any:
        """Delegate to `Media`, with derivatives."""
        if not self.repeats:
            return super().transmittance(path, vertex, connection, sampler)
        with dr.suspend_grad():
            left = super().transmittance(path, vertex, connection, sampler)
        o, ray = vertex.si.p, vertex.si.spawn_ray_to(connection.point)
        medium = self.medium_behind(path, vertex, connection.direction)
        length = dr.norm(connection.point - o)
        length = length if connection.medium_length is None else connection.medium_length
        return left * self._change(medium, ray, o, length, sampler, connection.active)

    def _change(
        self,
        medium: mi.MediumPtr,
        ray: mi.Ray3f,
        o: mi.Point3f,
        length: mi.Float,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Any:
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
        lost: Any = σ_t * dr.select(inside, length, 0)
        return dr.select(inside, dr.exp(dr.detach(lost) - lost), 1)

    @dr.syntax
    def _medium_at(
        self, medium: Any, ray: mi.Ray3f, o: mi.Point3f, at: mi.Float, active: mi.Bool
    ) -> Any:
        """Return the medium at a distance along rays that only cross boundaries before."""
        flight = Flight.start(ray, medium, active, mi.Bool(False))
        while flight.needs_intersection:
            flight = self._intersect(flight, o)
            before = flight.needs_intersection & flight.pi.is_valid() & (flight.end < at)
            flight, _ = self._cross_boundary(flight, before, connects=True)
        return flight.medium
