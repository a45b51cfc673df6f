"""Participating media: free flights and transmittance in fog, smoke and milk.

The next vertex of a path is a surface, or a point where a medium scatters. On the way, the path
passes media, null collisions and index-matched boundaries (BSDF `null`). They are not vertices. The
length of a segment is the distance between its two vertices, times the path's index of refraction.

**Free flights** are sampled in one channel, which is chosen in proportion to throughput. The
weight of a flight accounts for the densities of all channels (balance heuristic, Veach 1997):

    weight_c = P_c / Σ_k q_k P_k,     q_k = β_k / Σβ,

where P_c is the density of the flight if it is sampled in channel c. Therefore only absorption
changes the sum of the throughput. In grids, tentative collisions are sampled from the majorant.
They are real with the probability σ_t / majorant (Woodcock et al. 1965).

**Connections** are multiplied by the transmittance. It is exp(-∫σ_t) in homogeneous media, and the
product of σ_n / majorant over all tentative collisions in grids (ratio tracking, Novák et al.
2014).
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import drjit as dr
import mitsuba as mi

from ..paths.protocols import Scattering, Space
from ..paths.records import Connection, MediumPoint, Path, Transmittance, Vertex
from ..paths.surfaces import Boundaries, is_boundary, lets_straight_through, spawn_ray
from ..scenes.media import media_of
from ..signals.polarization import bsdf_to_world, intensity, multiply_throughput
from .flight import Flight, channel_probabilities, sample_channel, value_in
from .phases import Phases, as_surface

FARTHEST = 1e30  # Replaces infinite distances in products [m]


class MediaTransport(Space):
    """Straight rays through homogeneous media and grids; `Media` adds its attached variant.

    Args:
        scene: The scene.
        outside: Medium around the sensor, None for vacuum.
        beyond: Medium at infinite distance, where light of distant emitters starts.
        hide_emitters: Whether rays from the sensor pass area lights, also behind boundaries.
        straight: Whether connections pass surfaces with null transmission (thin panes, masks,
            polarizers), as in Mitsuba's `volpath`.
        index: Index of refraction around the sensor.
    """

    scatters = True

    def __init__(
        self,
        scene: mi.Scene,
        outside: mi.Medium | None = None,
        beyond: mi.Medium | None = None,
        hide_emitters: bool = False,
        straight: bool = False,
        index: float = 1.0,
    ) -> None:
        self.scene = scene
        self.outside = outside
        self.beyond = beyond
        self.index = index

        # Flights need a loop for null collisions in grids, and for boundaries
        self.media = media_of(scene) + ([] if outside is None else [outside])
        self.has_grids = any(not medium.is_homogeneous() for medium in self.media)
        self.boundaries = Boundaries(scene)
        self.straight = straight and lets_straight_through(scene)
        self.has_boundaries = self.boundaries.exist or self.straight
        self.repeats = self.has_grids or self.has_boundaries

        # Rays pass hidden emitters, and stop at emitters on boundaries
        area_lights = [shape for shape in scene.shapes() if shape.is_emitter()]
        self.hides = hide_emitters and bool(area_lights)
        self.stops = any(is_boundary(shape.bsdf()) for shape in area_lights)

    def with_phase_functions(self, surfaces: Scattering, **options: bool) -> Scattering:
        """Return scattering by phase functions in media, and by `surfaces` on surfaces."""
        return Phases(surfaces, self.media, **options) if self.media else surfaces

    def medium_at_sensor(self, ray: mi.Ray3f) -> mi.MediumPtr:
        """Return the medium around the sensor."""
        return _everywhere(self.outside, dr.width(ray))

    @dr.syntax
    def medium_at(self, ray: mi.Ray3f) -> mi.MediumPtr:
        """Find the medium at the start of rays, from the first medium transition along each ray."""
        # The transition may be farther away than the end of a connection
        ray = mi.Ray3f(ray)
        ray.maxt = mi.Float(dr.inf)
        medium = _everywhere(self.beyond, dr.width(ray))
        active = mi.Bool(True)
        while active:
            si = self.scene.ray_intersect(ray, mi.RayFlags.Minimal, False, active)
            active &= si.is_valid()
            found = active & si.is_medium_transition()
            medium = dr.select(found, si.target_medium(-ray.d), medium)
            active &= ~found
            ray = dr.select(active, si.spawn_ray(ray.d), ray)
        return medium

    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Sample the next vertex: a scattering point, or a surface that is not a boundary."""
        # Sample a free flight
        flight, weight = self.sample_flight(path, sampler)
        o = path.prev.p
        scattered = flight.scattered
        path = replace(path, medium=flight.medium, β=multiply_throughput(path.β, weight))

        # Create the vertex at the surface or the scattering point
        si = flight.pi.compute_surface_interaction(
            flight.ray, mi.RayFlags.All, path.active & ~scattered
        )
        mei = medium_interaction(path.ray, dr.fma(path.ray.d, flight.distance, o), flight.medium)
        point = as_surface(si, mei, scattered)
        valid = scattered | si.is_valid()
        passes = self._stopped(path, flight, si)
        vertex = Vertex(
            si=point,
            length=dr.norm(point.p - o),
            valid=valid,
            in_medium=MediumPoint(mei, scattered),
            passes=passes,
        )
        return path, vertex

    def _stopped(self, path: Path, flight: Flight, si: mi.SurfaceInteraction3f) -> mi.Bool | None:
        """Return the lanes where a flight ends at an emitter on a boundary, for `Vertex.passes`."""
        if path.passed is None:
            return None
        at_surface = path.active & ~flight.scattered & si.is_valid()
        return self.boundaries.contain(si, at_surface) & si.shape.is_emitter()

    def behind_emitter(self, path: Path, vertex: Vertex) -> Path:
        """Start the ray of a path behind the emitter where the ray has stopped."""
        ray = spawn_ray(vertex.si, path.ray.d, mi.Bool(True))
        ray.maxt = path.ray.maxt - dr.norm(ray.o - path.ray.o)
        medium = self.medium_behind(path, vertex, path.ray.d)
        return replace(path, ray=ray, medium=medium, passed=dr.detach(vertex.length))

    @dr.syntax
    def sample_flight(
        self, path: Path, sampler: mi.Sampler
    ) -> tuple[Flight, mi.UnpolarizedSpectrum]:
        """Sample free flights along the rays of paths.

        The loop carries a `Flight`:

        | state | meaning |
        |---|---|
        | `distance` | distance reached so far [m] |
        | `end` | distance of the next surface [m] |
        | `medium` | current medium |
        | `weight` | density in each channel, relative to the sampled channel |
        | `active` | lanes after a null collision or a boundary |

        Returns:
            The flights, and the factors of the paths' throughput.
        """
        # --------------------- Sample a channel ---------------------

        q = channel_probabilities(intensity(path.β))
        o = path.prev.p
        channel = sample_channel(q, sampler.next_1d())

        # --------------------- Fly to the first collision or surface ---------------------

        passes_emitters = self.hides & (path.depth == 0)
        flight = Flight.start(path.ray, path.medium, path.active, passes_emitters)
        if path.passed is not None:
            flight.stops = ~flight.passes_emitters
            flight.distance = mi.Float(path.passed)
        flight = self._intersect(flight, o, path.depth == 0)
        flight = self._fly(flight, o, channel, sampler)

        # --------------------- Continue after null collisions and boundaries ---------------------

        if self.repeats:
            while flight.active:
                if self.has_boundaries:
                    flight = self._intersect(flight, o)
                flight = self._fly(flight, o, channel, sampler)

        # --------------------- Weight by the balance heuristic over channels ---------------------

        weight = flight.weight / dr.sum(q * flight.weight)
        return flight, dr.select(flight.scattered, weight * flight.albedo, weight)

    def _intersect(self, flight: Flight, o: mi.Point3f, coherent: mi.Bool | bool = False) -> Flight:
        """Find the next surface of the lanes in `needs_intersection`."""
        flight = copy(flight)
        pi = self.scene.ray_intersect_preliminary(
            flight.ray, coherent, active=flight.needs_intersection
        )
        distance = dr.norm(dr.fma(flight.ray.d, pi.t, flight.ray.o) - o)
        distance = dr.select(pi.is_valid(), distance, dr.inf)
        flight.pi = dr.select(flight.needs_intersection, pi, flight.pi)
        flight.end = dr.select(flight.needs_intersection, distance, flight.end)
        return flight

    def _fly(
        self, flight: Flight, o: mi.Point3f, channel: mi.UInt32, sampler: mi.Sampler
    ) -> Flight:
        """Trace rays to the next collision (real or null) or surface, and cross boundaries."""
        flight = copy(flight)

        # Sample a tentative collision with the majorant of the chosen channel
        inside, mei = self._tentative_collision(flight, o, channel, sampler)
        remaining = flight.end - flight.distance
        step = dr.minimum(dr.minimum(mei.t, remaining), FARTHEST)
        majorant = mei.combined_extinction
        majorant_c = value_in(majorant, channel)
        flight.weight *= dr.select(inside, dr.exp((majorant_c - majorant) * step), 1)

        # Is there a collision before the next surface, and is it real or null?
        collides = inside & (mei.t < remaining)
        real = collides
        if self.has_grids:
            real = collides & (sampler.next_1d() * majorant_c < value_in(mei.sigma_t, channel))
        σ = dr.select(real, mei.sigma_t, mei.sigma_n)
        flight.weight *= dr.select(collides, σ / value_in(σ, channel), 1)
        albedo = mei.sigma_s / mei.sigma_t
        flight.albedo = dr.select(real & (mei.sigma_t > 0), albedo, flight.albedo)
        flight.scattered = real
        flight.distance = dr.select(collides, flight.distance + mei.t, flight.distance)

        # Continue after null collisions, and behind boundaries
        crosses = flight.active & ~collides
        null = collides & ~real
        if self.has_boundaries:
            flight, crosses = self._cross_boundary(flight, crosses)
            flight.active = null | crosses
        else:
            flight.active = null
        return flight

    def _tentative_collision(
        self, flight: Flight, o: mi.Point3f, channel: mi.UInt32, sampler: mi.Sampler
    ) -> tuple[mi.Bool, mi.MediumInteraction3f]:
        """Sample a tentative collision, and return the lanes in a medium and the collision."""
        inside = flight.active & (flight.medium != None)  # noqa: E711
        ray = mi.Ray3f(flight.ray)
        ray.o = dr.fma(ray.d, flight.distance, o)
        ray.maxt = mi.Float(dr.largest(mi.Float))
        xi = sampler.next_1d()
        return inside, flight.medium.sample_interaction(ray, xi, channel, inside)

    def _cross_boundary(
        self, flight: Flight, at_surface: mi.Bool, connects: bool = False
    ) -> tuple[Flight, mi.Bool]:
        """Cross boundaries between media.

        Args:
            flight: The flight.
            at_surface: Lanes that have reached the next surface.
            connects: Whether connections also cross surfaces with null transmission.

        Returns:
            The flight, and the lanes that have crossed a surface.
        """
        # Is the surface an index-matched boundary?
        at_surface &= flight.pi.is_valid()
        null_transmission = connects and self.straight
        flags = mi.RayFlags.All if null_transmission else mi.RayFlags.Minimal
        si = flight.pi.compute_surface_interaction(flight.ray, flags, at_surface)
        crosses = self.boundaries.contain(si, at_surface)

        # Does the surface transmit light without refraction?
        if null_transmission:
            factor = si.bsdf().eval_null_transmission(si, at_surface)
            transmits = dr.any(intensity(factor) > 0)
            if flight.mueller is None:
                flight.weight *= dr.select(at_surface & transmits, factor, 1)
            else:
                factor = bsdf_to_world(si, mi.Spectrum(factor), -si.wi, si.wi)
                product = multiply_throughput(flight.mueller, factor)
                flight.mueller = dr.select(at_surface & transmits, product, flight.mueller)
            crosses |= at_surface & transmits

        # Stop at emitters on boundaries, and pass hidden emitters
        if flight.stops is not None:
            crosses &= ~(flight.stops & si.shape.is_emitter())
        if self.hides:
            crosses |= at_surface & flight.passes_emitters & si.shape.is_emitter()

        # Update the current medium
        d = flight.ray.d
        changes = crosses & si.is_medium_transition()
        flight.medium = dr.select(changes, si.target_medium(d), flight.medium)
        flight.distance = dr.select(crosses, flight.end, flight.distance)

        # Continue behind the surface. The offset is along the ray, because offsets along normals
        # of many boundaries would shift the ray to the side
        offset = dr.norm(si.spawn_ray(d).o - si.p)
        start = flight.pi.t + offset / dr.maximum(dr.abs(dr.dot(si.n, d)), 0.1)
        flight.ray.o = dr.select(crosses, dr.fma(d, start, flight.ray.o), flight.ray.o)
        flight.ray.maxt = dr.select(crosses, flight.ray.maxt - start, flight.ray.maxt)
        flight.needs_intersection = crosses
        return flight, crosses

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> Transmittance:
        """Estimate the transmittance of a connection, and find the medium at its end."""
        # Start a flight to the end of the connection
        medium = self.medium_behind(path, vertex, connection.direction)
        o = vertex.si.p
        length = connection.medium_length
        ends_on_sensor = connection.position is not None
        passes_emitters = self.hides and ends_on_sensor
        ray = vertex.si.spawn_ray_to(connection.point)
        flight = Flight.start(ray, medium, connection.active, passes_emitters)
        length = dr.norm(connection.point - o) if length is None else length

        # Attenuate along the flight
        if self.straight and mi.is_polarized:
            flight.mueller = mi.Spectrum(1) + dr.zeros(mi.Float, dr.width(ray))
        flight = self._fly_to(flight, o, length, sampler, connection.unoccluded)
        return Transmittance(flight.weight, flight.medium, flight.mueller)

    def scattering_point(
        self, path: Path, distance: mi.Float, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Path, Vertex]:
        """Continue paths to points of media at given distances along their rays.

        Args:
            path: The paths.
            distance: Distances of the points from the last vertices [m].
            sampler: The sampler.
            active: Active lanes.

        Returns:
            The paths, with throughput multiplied by transmittance and by σ_s [1/m], and the points
            as vertices.
        """
        # Estimate the transmittance up to the point
        o = path.prev.p
        ray = mi.Ray3f(path.ray)
        ray.maxt = mi.Float(distance)
        passes_emitters = self.hides & (path.depth == 0)
        flight = Flight.start(ray, path.medium, active, passes_emitters)
        flight = self._fly_to(flight, o, distance, sampler)

        # Is the point in a medium, and inside of the medium's grid?
        ray.o = o
        mei = medium_interaction(ray, dr.fma(ray.d, distance, o), flight.medium)
        here = active & (flight.medium != None) & dr.any(flight.weight > 0)  # noqa: E711
        within, first, last = flight.medium.intersect_aabb(ray)
        here &= within & (distance >= first) & (distance <= last)

        # Multiply by the scattering coefficient
        σ_s, _, _ = flight.medium.get_scattering_coefficients(mei, here)
        path = replace(
            path,
            medium=flight.medium,
            β=multiply_throughput(path.β, dr.select(here, flight.weight * σ_s, 0)),
            opl=dr.fma(path.η, distance, path.opl),
        )
        point = as_surface(dr.zeros(mi.SurfaceInteraction3f, dr.width(mei)), mei, here)
        return path, Vertex(point, distance, here, MediumPoint(mei, here))

    @dr.syntax
    def _fly_to(
        self,
        flight: Flight,
        o: mi.Point3f,
        length: mi.Float,
        sampler: mi.Sampler,
        unoccluded: mi.Bool | bool = False,
    ) -> Flight:
        """Estimate the transmittance up to a distance.

        Args:
            flight: A new flight. Its weight becomes the transmittance.
            o: Start of the flight, where distances are 0.
            length: Distance of the end [m].
            sampler: The sampler.
            unoccluded: Lanes where surfaces do not block the flight. In other lanes, the
                transmittance behind a surface is 0.
        """
        unoccluded = mi.Bool(unoccluded)
        if self.has_boundaries:
            while flight.active:
                # Fly to the next tentative collision, the next surface or the end
                flight = self._intersect(flight, o)
                flight.end = dr.minimum(flight.end, length)
                active = flight.active
                flight = self._attenuate(flight, o, sampler)
                null = flight.active

                # Cross a boundary, or stop at another surface
                at_surface = active & ~null & flight.pi.is_valid()
                flight, crosses = self._cross_boundary(flight, at_surface, connects=True)
                blocked = at_surface & ~crosses & ~unoccluded
                flight.weight = dr.select(blocked, 0, flight.weight)
                flight.active = (null | crosses) & dr.any(flight.weight > 0)
        else:
            # Without boundaries, one shadow ray is enough
            flight.needs_intersection &= ~unoccluded
            tested = flight.needs_intersection
            blocked = tested & self.scene.ray_test(flight.ray, tested)
            flight.active &= ~blocked
            flight.weight = dr.select(blocked, 0, flight.weight)

            # Attenuate along the whole flight; grids need several tentative collisions
            flight.end = mi.Float(length)
            flight = self._attenuate(flight, o, sampler)
            if self.has_grids:
                while flight.active:
                    flight = self._attenuate(flight, o, sampler)
        return flight

    def _attenuate(self, flight: Flight, o: mi.Point3f, sampler: mi.Sampler) -> Flight:
        """Multiply by the transmittance up to the next tentative collision, or to `flight.end`."""
        flight = copy(flight)
        inside, mei = self._tentative_collision(flight, o, mi.UInt32(0), sampler)

        # Homogeneous media: the exact transmittance up to the end
        remaining = flight.end - flight.distance
        majorant = mei.combined_extinction
        factor = dr.exp(-majorant * dr.minimum(remaining, FARTHEST))

        # Grids: ratio tracking, one factor at each tentative collision
        collides = mi.Bool(False)
        if self.has_grids:
            homogeneous = flight.medium.is_homogeneous()
            collides = inside & ~homogeneous & (mei.t < remaining)
            ratio = mi.UnpolarizedSpectrum(dr.select(majorant > 0, mei.sigma_n / majorant, 1))
            factor = dr.select(homogeneous, factor, dr.select(collides, ratio, 1))

        # Continue after a collision
        flight.weight *= dr.select(inside, factor, 1)
        flight.distance = dr.select(collides, flight.distance + mei.t, flight.distance)
        flight.active = mi.Bool(collides)
        return flight

    def medium_behind(self, path: Path, vertex: Vertex, direction: mi.Vector3f) -> mi.MediumPtr:
        """Return the medium on the side of a vertex where a direction points."""
        on_surface = True if vertex.in_medium is None else ~vertex.in_medium.here
        changes = on_surface & vertex.si.is_valid() & vertex.si.is_medium_transition()
        return dr.select(changes, vertex.si.target_medium(direction), path.medium)


def _everywhere(medium: mi.Medium | None, lanes: int) -> mi.MediumPtr:
    """Return pointers to a medium in all lanes, null pointers for vacuum."""
    if medium is None:
        return dr.zeros(mi.MediumPtr, lanes)
    return dr.full(mi.MediumPtr, medium, lanes)


def medium_interaction(
    ray: mi.Ray3f, p: mi.Point3f, medium: mi.MediumPtr
) -> mi.MediumInteraction3f:
    """Create the medium interaction at a point on a ray."""
    mei = dr.zeros(mi.MediumInteraction3f, dr.width(ray))
    mei.p = p
    mei.t = dr.norm(p - ray.o)
    mei.wi = -ray.d
    mei.time = ray.time
    mei.wavelengths = ray.wavelengths
    mei.sh_frame = mi.Frame3f(-ray.d)
    mei.medium = medium
    return mei
