"""Media with derivatives, for detached sampling (see `gradients.detached`).

The distances of free flights are sampled without derivatives. If a surface is behind a scattering
point, the point divides the distance to this surface in a fixed ratio. Otherwise the distance of
the point is fixed. The derivative of a flight's weight is the derivative of

    exp(-∫ σ_t ds) σ_s ds

with the extinction σ_t and the length s. The factors σ_s ds belong to scattering points only, and
ds is the stretch of the distance. In a single homogeneous medium, the integral is a product.
Through grids and index-matched boundaries, the derivative of the integral is estimated at one
uniform point of the flight, as the length times the derivative of σ_t at this point. Surfaces may
move only in a single homogeneous medium.
"""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..paths.records import Connection, MediumPoint, Path, Transmittance, Vertex
from ..signals.polarization import multiply_throughput
from .flight import Flight
from .phases import as_surface
from .transport import MediaTransport, medium_interaction


class AttachedMedia(MediaTransport):
    """Media with derivatives by coefficients, and by surfaces around one homogeneous medium.

    Args:
        media: The media without derivatives.
    """

    def __init__(self, media: MediaTransport) -> None:
        vars(self).update(vars(media))

    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Sample the next vertex as `Media` does, and attach derivatives to point and weight."""
        # --------------------- Sample the flight without derivatives ---------------------

        with dr.suspend_grad():
            flight, weight = self.sample_flight(path, sampler)
        ray = path.ray
        o = path.prev.p
        here = flight.scattered
        medium = flight.medium

        # ---------------- Where is the vertex when the surfaces move? ----------------

        # Find the surface behind the vertex; with boundaries, the surface where the flight ended
        if self.repeats:
            met = path.active & ~here
            si = flight.pi.compute_surface_interaction(flight.ray, mi.RayFlags.All, met)
        else:
            si = self.scene.ray_intersect(ray, active=path.active)

        # A scattering point divides the distance to this surface in a fixed ratio
        distance = dr.norm(si.p - o)
        stretch = dr.select(here & si.is_valid(), distance / dr.detach(distance), 1)
        length = dr.select(here, flight.distance * stretch, distance)

        # ------------- How does the weight of the flight change? -------------

        # Scattering coefficient σ_s at a scattering point
        mei = medium_interaction(ray, dr.fma(ray.d, dr.select(here, length, 0), o), medium)
        inside = path.active & here & (medium != None)  # noqa: E711 (a Dr.Jit mask)
        σ_s, _, _ = medium.get_scattering_coefficients(mei, inside)
        scattered = dr.select(inside & (σ_s > 0), σ_s / dr.detach(σ_s), 1) * stretch

        # Transmittance up to the vertex; a ray that escapes leaves the media at the last boundary
        escapes = ~here & ~si.is_valid()
        if self.repeats:
            length = dr.select(escapes, flight.distance, length)
        within = path.active & (self.repeats | ~escapes)
        change = self._transmittance_change(
            path.medium, ray, o, length, sampler, within, path.passed
        )
        path = replace(
            path, medium=medium, β=multiply_throughput(path.β, weight * change * scattered)
        )

        # --------------------- Create the vertex ---------------------

        point = as_surface(si, mei, here)
        valid = here | si.is_valid()
        passes = self._stopped(path, flight, si)
        vertex = Vertex(
            si=point,
            length=dr.norm(point.p - o),
            valid=valid,
            in_medium=MediumPoint(mei, here),
            passes=passes,
        )
        return path, vertex

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> Transmittance:
        """Estimate the transmittance of a connection as `Media` does, with derivatives."""
        # In a single homogeneous medium, the estimate itself has derivatives
        if not self.repeats:
            return super().transmittance(path, vertex, connection, sampler)

        # Otherwise, attach a separate estimate of the derivative
        with dr.suspend_grad():
            transmittance = super().transmittance(path, vertex, connection, sampler)
        o = vertex.si.p
        ray = vertex.si.spawn_ray_to(connection.point)
        medium = self.medium_behind(path, vertex, connection.direction)
        length = connection.medium_length
        length = dr.norm(connection.point - o) if length is None else length
        change = self._transmittance_change(medium, ray, o, length, sampler, connection.active)
        return replace(transmittance, value=transmittance.value * change)

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
        """Return 1 with the derivative of the transmittance, relative to the transmittance.

        Args:
            medium: The current medium at the start of the ray.
            ray: The ray.
            o: Start of the flight, where distances are 0.
            length: Distance of the end [m].
            sampler: The sampler.
            active: Active lanes.
            start: Distance of the start [m], or None for 0.
        """
        # Sample a uniform point between start and end, and find its medium
        at = mi.Float(0)
        if self.repeats:
            with dr.suspend_grad():
                first = mi.Float(0) if start is None else start
                at = dr.fma(sampler.next_1d(), length - first, first)
                medium = self._medium_at(medium, ray, o, at, active)
            length = dr.detach(length - first)

        # The optical depth is estimated as σ_t at this point times the length
        inside = active & (medium != None)  # noqa: E711 (a Dr.Jit mask)
        mei = medium_interaction(ray, dr.fma(ray.d, dr.detach(at), o), medium)
        _, _, σ_t = medium.get_scattering_coefficients(mei, inside)
        optical_depth = σ_t * dr.select(inside, length, 0)
        return dr.select(inside, dr.exp(dr.detach(optical_depth) - optical_depth), 1)

    @dr.syntax
    def _medium_at(
        self, medium: mi.MediumPtr, ray: mi.Ray3f, o: mi.Point3f, at: mi.Float, active: mi.Bool
    ) -> mi.MediumPtr:
        """Return the medium at a distance `at` [m] along rays that only cross boundaries."""
        flight = Flight.start(ray, medium, active, mi.Bool(False))
        while flight.needs_intersection:
            flight = self._intersect(flight, o)
            before = flight.needs_intersection & flight.pi.is_valid() & (flight.end < at)
            flight, _ = self._cross_boundary(flight, before, connects=True)
        return flight.medium
