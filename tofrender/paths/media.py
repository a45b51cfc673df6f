# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
# pyright: reportAttributeAccessIssue=false, reportReturnType=false
"""Space that is not empty: fog, smoke, milk.

A path flies through media and through boundaries of equal index (BSDF `null`) to its next real
vertex: a surface, or a point where a medium scatters. Null collisions and such boundaries move
nothing: the length of a flight is the distance of its ends, times the index that the path carries.

**Flights** are sampled in one channel that is drawn anew for each, in proportion to what the path
still carries in it, and weighed by the density of all channels together (balance heuristic, Veach
1997):

    weight_c = P_c / Σ_k q_k P_k,     q_k = β_k / Σβ,

where P_c is the chance of the flight, were it sampled in channel c. So a path brings as much after
a flight as before, but for what is absorbed. In grids, distances come from the majorant, and
collisions are real with the chance σ_t / majorant (Woodcock et al. 1965). **Connections** multiply
what they lose: exp(-∫σ_t) where a medium is homogeneous, σ_n / majorant at each tentative collision
in a grid (ratio tracking, Novák et al. 2014).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..scenes.media import media_of
from ..signals.polarisation import bsdf_to_world, intensity
from .channels import drawn_from, shares_of, value_in
from .flight import Flight
from .phases import Phases, Scattered, as_surface
from .protocols import Scattering
from .records import Connection, Path, Vertex, extend
from .surfaces import Boundaries, lets_straight_through

FARTHEST = 1e30
"""Distance that stands for infinity where it is multiplied [m]."""


@dataclass
class Place:
    """Where a path is: its `place`.

    Attributes:
        medium: What is around its ray, null in vacuum.
    """

    medium: mi.MediumPtr


class Media:
    """Straight flights through homogeneous media and grids.

    Args:
        scene: The scene.
        outside: What is around a sensor, where its rays start; None for vacuum.
        beyond: What is infinitely far away, which paths from lights must know.
        hide_emitters: Whether a sensor looks through area lights behind boundaries, too.
        straight: Whether connections go through surfaces that let light straight through, as in
            Mitsuba's `volpath`: panes, masks, polarisers.
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
        self.scene, self.outside, self.beyond, self.index = scene, outside, beyond, index
        self.media = media_of(scene) + ([] if outside is None else [outside])
        self.has_grids = any(not medium.is_homogeneous() for medium in self.media)
        self.boundaries = Boundaries(scene)
        self.straight = straight and lets_straight_through(scene)
        self.has_boundaries = self.boundaries.exist or self.straight
        self.repeats = self.has_grids or self.has_boundaries
        self.hides = hide_emitters and any(shape.is_emitter() for shape in scene.shapes())

    def scattering(
        self,
        surfaces: Scattering,
        importance: bool = False,
        both_ways: bool = False,
        connects: bool = False,
    ) -> Scattering:
        """Phase functions in media, and what is given on surfaces."""
        if not self.media:
            return surfaces
        return Phases(surfaces, importance, both_ways, connects, self.media)

    def place(self, ray: mi.Ray3f) -> Place:
        """What is around the start of a sensor's rays."""
        return Place(_everywhere(self.outside, dr.width(ray)))

    @dr.syntax
    def around(self, ray: mi.Ray3f) -> Place:
        """What is around the start of other rays: what the first shape says that has a medium."""
        ray = mi.Ray3f(ray)
        ray.maxt = mi.Float(dr.inf)  # What tells may be behind the end of a connection
        medium = _everywhere(self.beyond, dr.width(ray))
        looking = mi.Bool(True)
        while looking:
            si = self.scene.ray_intersect(ray, mi.RayFlags.Minimal, False, looking)
            looking &= si.is_valid()
            tells = looking & si.is_medium_transition()
            medium = dr.select(tells, si.target_medium(-ray.d), medium)
            looking &= ~tells
            ray = dr.select(looking, si.spawn_ray(ray.d), ray)
        return Place(medium)

    def attached(self) -> Any:
        """The same as derivatives follow it."""
        from .attached_media import AttachedMedia

        return AttachedMedia(self)

    def next(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """The next surface that is no boundary of equal index, or a point that scatters before."""
        flight, weight = self.fly(path, sampler)
        o, here = path.prev.p, flight.here
        path = copy(path)
        path.place = Place(flight.medium)
        path.β = extend(path.β, weight)
        si = flight.found.compute_surface_interaction(
            flight.ray, mi.RayFlags.All, path.active & ~here
        )
        mei = point_of(path.ray, dr.fma(path.ray.d, flight.at, o), flight.medium)
        point = as_surface(si, mei, here)
        valid = here | si.is_valid()
        return path, Vertex(point, dr.norm(point.p - o), valid, Scattered(mei, here))

    @dr.syntax
    def fly(self, path: Path, sampler: mi.Sampler) -> tuple[Flight, Any]:
        """The flights along the paths' rays, and what they leave of the throughputs."""
        q, o = shares_of(intensity(path.β)), path.prev.p
        channel = drawn_from(q, sampler.next_1d())
        hidden = self.hides & (path.depth == 0)
        flight = Flight.start(path.ray, path.place.medium, path.active, hidden)
        flight = self._look(flight, o, path.depth == 0)
        flight = self._fly(flight, o, channel, sampler)
        if self.repeats:
            while flight.going:
                if self.has_boundaries:
                    flight = self._look(flight, o)
                flight = self._fly(flight, o, channel, sampler)
        weight = flight.left / dr.sum(q * flight.left)
        return flight, dr.select(flight.here, weight * flight.albedo, weight)

    def _look(self, flight: Flight, o: mi.Point3f, coherent: Any = False) -> Flight:
        """Find the next surface in lanes that do not know it."""
        flight = copy(flight)
        found = self.scene.ray_intersect_preliminary(flight.ray, coherent, active=flight.looking)
        away = dr.norm(dr.fma(flight.ray.d, found.t, flight.ray.o) - o)
        away = dr.select(found.is_valid(), away, dr.inf)
        flight.found = dr.select(flight.looking, found, flight.found)
        flight.end = dr.select(flight.looking, away, flight.end)
        return flight

    def _fly(
        self, flight: Flight, o: mi.Point3f, channel: mi.UInt32, sampler: mi.Sampler
    ) -> Flight:
        """A flight up to its next collision, real or null, or through its next boundary."""
        flight = copy(flight)
        inside, tried = self._try(flight, o, channel, sampler)
        left = flight.end - flight.at
        step = dr.minimum(dr.minimum(tried.t, left), FARTHEST)
        majorant = tried.combined_extinction
        hero = value_in(majorant, channel)
        flight.left *= dr.select(inside, dr.exp((hero - majorant) * step), 1)
        meets = inside & (tried.t < left)
        real = meets
        if self.has_grids:
            real = meets & (sampler.next_1d() * hero < value_in(tried.sigma_t, channel))
        kind = dr.select(real, tried.sigma_t, tried.sigma_n)
        flight.left *= dr.select(meets, kind / value_in(kind, channel), 1)
        flight.albedo = dr.select(
            real & (tried.sigma_t > 0), tried.sigma_s / tried.sigma_t, flight.albedo
        )
        flight.here = real
        flight.at = dr.select(meets, flight.at + tried.t, flight.at)
        through = flight.going & ~meets
        if self.has_boundaries:
            flight, through = self._pass(flight, through)
            flight.going = (meets & ~real) | through
        else:
            flight.going = meets & ~real
        return flight

    def _try(
        self, flight: Flight, o: mi.Point3f, channel: mi.UInt32, sampler: mi.Sampler
    ) -> tuple[mi.Bool, mi.MediumInteraction3f]:
        """Draw a tentative collision, in lanes that are in a medium."""
        inside = flight.going & (flight.medium != None)  # noqa: E711
        ray = mi.Ray3f(flight.ray)
        ray.o = dr.fma(ray.d, flight.at, o)
        ray.maxt = mi.Float(dr.largest(mi.Float))
        xi = sampler.next_1d()
        return inside, flight.medium.sample_interaction(ray, xi, channel, inside)

    def _pass(
        self, flight: Flight, arrives: mi.Bool, connects: bool = False
    ) -> tuple[Flight, mi.Bool]:
        """Go on behind a boundary of equal index, or what lets connections through; lanes that do.

        Those lose there what is not let through.
        """
        arrives &= flight.found.is_valid()
        straight = connects and self.straight
        flags = mi.RayFlags.All if straight else mi.RayFlags.Minimal
        si = flight.found.compute_surface_interaction(flight.ray, flags, arrives)
        through = self.boundaries.hold(si, arrives)
        if straight:
            left = si.bsdf().eval_null_transmission(si, arrives)
            passes = dr.any(intensity(left) > 0)
            if flight.turned is None:
                flight.left *= dr.select(arrives & passes, left, 1)
            else:
                left = bsdf_to_world(si, mi.Spectrum(left), -si.wi, si.wi)
                turned = extend(flight.turned, left)
                flight.turned = dr.select(arrives & passes, turned, flight.turned)
            through |= arrives & passes
        if self.hides:
            through |= arrives & flight.through_lamps & si.shape.is_emitter()
        d = flight.ray.d
        flight.medium = dr.select(
            through & si.is_medium_transition(), si.target_medium(d), flight.medium
        )
        flight.at = dr.select(through, flight.end, flight.at)
        # Along the ray, not along the normal: many boundaries would move it sideways
        off = dr.norm(si.spawn_ray(d).o - si.p)
        start = flight.found.t + off / dr.maximum(dr.abs(dr.dot(si.n, d)), 0.1)
        flight.ray.o = dr.select(through, dr.fma(d, start, flight.ray.o), flight.ray.o)
        flight.ray.maxt = dr.select(through, flight.ray.maxt - start, flight.ray.maxt)
        flight.looking = through
        return flight, through

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> Any:
        """What media leave of a connection's light; 0 where a surface is in the way."""
        return self.through(path, vertex, connection, sampler)[0]

    def through(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> tuple[Any, Place]:
        """The same, and what is around the connection's end."""
        medium = self._behind(path.place.medium, vertex, connection.direction)
        o = vertex.si.p
        hidden = self.hides and connection.position is not None  # It ends on the sensor
        ray = vertex.si.spawn_ray_to(connection.point)
        flight = Flight.start(ray, medium, connection.active, hidden)
        whole = dr.norm(connection.point - o) if connection.reach is None else connection.reach
        if self.straight and mi.is_polarized:
            flight.turned = mi.Spectrum(1) + dr.zeros(mi.Float, dr.width(ray))
        flight = self._arrive(flight, o, whole, sampler, mi.Bool(connection.clear))
        if flight.turned is not None:
            connection.frame = flight.turned
        return flight.left, Place(flight.medium)

    def ahead(
        self, path: Path, distance: mi.Float, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Path, Vertex]:
        """The points of media so far along rays, and paths with what is scattered there [1/m]."""
        o, ray = path.prev.p, mi.Ray3f(path.ray)
        ray.maxt = mi.Float(distance)
        hidden = self.hides & (path.depth == 0)
        flight = Flight.start(ray, path.place.medium, active, hidden)
        flight = self._arrive(flight, o, distance, sampler)
        ray.o = o
        mei = point_of(ray, dr.fma(ray.d, distance, o), flight.medium)
        here = active & (flight.medium != None) & dr.any(flight.left > 0)  # noqa: E711
        within, first, last = flight.medium.intersect_aabb(ray)
        here &= within & (distance >= first) & (distance <= last)
        σ_s, _, _ = flight.medium.get_scattering_coefficients(mei, here)
        path = copy(path)
        path.place = Place(flight.medium)
        path.β = extend(path.β, dr.select(here, flight.left * σ_s, 0))
        path.opl = dr.fma(path.η, distance, path.opl)
        point = as_surface(dr.zeros(mi.SurfaceInteraction3f, dr.width(mei)), mei, here)
        return path, Vertex(point, distance, here, Scattered(mei, here))

    def _arrive(
        self,
        flight: Flight,
        o: mi.Point3f,
        whole: mi.Float,
        sampler: mi.Sampler,
        clear: mi.Bool | None = None,
    ) -> Flight:
        """What is left of light that flies to the end of a ray, 0 where a surface is in the way.

        In `clear` lanes only boundaries can be.
        """
        clear = mi.Bool(False) if clear is None else clear
        if self.has_boundaries:
            return self._lost_behind(flight, o, whole, sampler, clear)
        flight.looking &= ~clear
        shadow = flight.looking & self.scene.ray_test(flight.ray, flight.looking)
        flight.going &= ~shadow
        flight.left = dr.select(shadow, 0, flight.left)
        flight.end = mi.Float(whole)
        return self._lost(flight, o, sampler)

    @dr.syntax
    def _lost(self, flight: Flight, o: mi.Point3f, sampler: mi.Sampler) -> Flight:
        """The same where nothing is in the way, in one medium."""
        flight = self._lose(flight, o, sampler)
        if self.has_grids:
            while flight.going:
                flight = self._lose(flight, o, sampler)
        return flight

    @dr.syntax
    def _lost_behind(
        self, flight: Flight, o: mi.Point3f, whole: mi.Float, sampler: mi.Sampler, clear: Any
    ) -> Flight:
        """The same through boundaries."""
        while flight.going:
            flight = self._look(flight, o)
            flight.end = dr.minimum(flight.end, whole)
            went = flight.going
            flight = self._lose(flight, o, sampler)
            meets = flight.going
            surface = went & ~meets & flight.found.is_valid()
            flight, through = self._pass(flight, surface, connects=True)
            flight.left = dr.select(surface & ~through & ~clear, 0, flight.left)
            flight.going = (meets | through) & dr.any(flight.left > 0)
        return flight

    def _lose(self, flight: Flight, o: mi.Point3f, sampler: mi.Sampler) -> Flight:
        """What a connection loses up to its next tentative collision, or the end of its medium."""
        flight = copy(flight)
        inside, tried = self._try(flight, o, mi.UInt32(0), sampler)
        left, majorant = flight.end - flight.at, tried.combined_extinction
        loss = dr.exp(-majorant * dr.minimum(left, FARTHEST))
        meets = mi.Bool(False)
        if self.has_grids:
            even = flight.medium.is_homogeneous()
            meets = inside & ~even & (tried.t < left)
            null = mi.UnpolarizedSpectrum(dr.select(majorant > 0, tried.sigma_n / majorant, 1))
            loss = dr.select(even, loss, dr.select(meets, null, 1))
        flight.left *= dr.select(inside, loss, 1)
        flight.at = dr.select(meets, flight.at + tried.t, flight.at)
        flight.going = mi.Bool(meets)
        return flight

    def leave(self, path: Path, vertex: Vertex, direction: mi.Vector3f) -> Place:
        """What is around a path that goes on from a vertex."""
        return Place(self._behind(path.place.medium, vertex, direction))

    def _behind(self, medium: Any, vertex: Vertex, d: mi.Vector3f) -> Any:
        """The medium on the side of a vertex that a direction leads to."""
        on_surface = True if vertex.inside is None else ~vertex.inside.here
        changes = on_surface & vertex.si.is_valid() & vertex.si.is_medium_transition()
        return dr.select(changes, vertex.si.target_medium(d), medium)


def _everywhere(medium: mi.Medium | None, lanes: int) -> mi.MediumPtr:
    """A medium in all lanes, null for vacuum."""
    if medium is None:
        return dr.zeros(mi.MediumPtr, lanes)
    return dr.full(mi.MediumPtr, medium, lanes)


def point_of(ray: mi.Ray3f, p: mi.Point3f, medium: mi.MediumPtr) -> mi.MediumInteraction3f:
    """A point of a medium that a ray has come to."""
    mei: Any = dr.zeros(mi.MediumInteraction3f, dr.width(ray))
    mei.p, mei.t, mei.wi = p, dr.norm(p - ray.o), -ray.d
    mei.time, mei.wavelengths = ray.time, ray.wavelengths
    mei.sh_frame, mei.medium = mi.Frame3f(-ray.d), medium
    return mei
