"""Interfaces of the path loop: space, endpoint, scattering and measurement.

The loop calls these interfaces only, and does not check the types of their implementations.

| interface | implementation | meaning |
|---|---|---|
| space | `space.Vacuum` | straight rays between surfaces |
| | `media.participating.Media` | straight rays through participating media |
| endpoint | `endpoints.SceneLights` | emitters of the scene, by next-event estimation and hits |
| | `endpoints.EmitterHits`, `ConnectionsOnly` | one of both techniques |
| scattering | `scattering.Materials` | the BSDF of each surface, or one BSDF for all surfaces |
| | `media.phases.Phases` | phase functions in media, another scattering on surfaces |
| measurement | `films.sums.Radiance` | sum of all light |
| | `films.sums.Weighted` | sum weighted by path length: a gate or a correlation |
| | `films.time_bins.TimeBins` | time bins of a film |
| | `films.phasor_sum.PhasorSum` | phasors of some frequencies |
| | `rendering.arrivals.ArrivalHistogram` | energy over path length, summed over all pixels |

More endpoints are in the packages that need them: `integrators`, `media.ellipsoidal`,
`bidirectional` and `nlos.light`. Space, endpoint and scattering do not change while paths are
traced. If they need data about a path, these data are fields of the path (`history`, `guide`,
`medium`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import copy
from typing import TYPE_CHECKING, Generic, Protocol, Self, TypeVar

import mitsuba as mi

from ..films.contribution import Contribution
from .records import BSDFEval, BSDFSample, Connection, Hit, Limits, Path, Transmittance, Vertex

if TYPE_CHECKING:
    from .velocities import Velocities

H = TypeVar("H")

LeaveVertex = Callable[[mi.Vector3f, mi.Float, mi.Bool], Path]
"""Function that returns the path along a sampled ray from its last vertex. Its arguments are the
direction in world space, the density of the direction [1/sr], and the active lanes.
"""


class Space(ABC):
    """Finds vertices along rays, and computes the transmittance of connections.

    The default methods are for scenes without media.
    """

    # Whether vertices may be scattering points in media
    scatters: bool = False

    # Whether rays stop at emitters on index-matched boundaries
    stops: bool = False

    # Index of refraction around the sensor
    index: float

    def with_phase_functions(self, surfaces: Scattering, **options: bool) -> Scattering:
        """Return a scattering that adds the phase functions of media to `surfaces`.

        Args:
            surfaces: Scattering at surfaces.
            options: Arguments of `Materials` that also matter for phase functions.
        """
        return surfaces

    def attached(self) -> Space:
        """Return the space for attached sampling, in which free-flight distances have derivatives.

        The default is for spaces without free-flight distances.
        """
        return self

    def medium_at_sensor(self, ray: mi.Ray3f) -> mi.MediumPtr | None:
        """Return the current medium of rays from the sensor, None in scenes without media."""
        return None

    def medium_at(self, ray: mi.Ray3f) -> mi.MediumPtr | None:
        """Find the current medium of rays with any origin, None in scenes without media."""
        return None

    def medium_behind(
        self, path: Path, vertex: Vertex, direction: mi.Vector3f
    ) -> mi.MediumPtr | None:
        """Return the current medium of a path that leaves a vertex in a direction.

        Args:
            path: The path. Its `ray` and `medium` lead to the vertex.
            vertex: The vertex.
            direction: Unit vector in world space.
        """
        return None

    @abstractmethod
    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Find the next vertex along the path's ray.

        Returns a path and the vertex. Only the throughput `β` and the current `medium` of the
        returned path may differ from the argument.
        """

    def behind_emitter(self, path: Path, vertex: Vertex) -> Path:
        """Return the path with its ray continued behind the emitter where the ray has stopped.

        The loop calls this method only if `Vertex.passes` is not None.

        Args:
            path: The path that `next_vertex` has returned.
            vertex: The vertex that `next_vertex` has returned.
        """
        raise NotImplementedError(f"{type(self).__name__} must define behind_emitter")

    @abstractmethod
    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> Transmittance:
        """Estimate the transmittance of a connection, and find the medium at its end.

        MIS weights of paths from lights need the medium. The connection is not changed.

        Args:
            path: The path up to `vertex`, before its update.
            vertex: The vertex that is connected.
            connection: The connection.
            sampler: The sampler.
        """


class HistoryUpdates(ABC, Generic[H]):
    """Updates `Path.history`, the data of earlier vertices that MIS weights need."""

    @abstractmethod
    def start(self) -> H:
        """Create the history of a path without vertices."""

    def at_vertex(self, path: Path[H], vertex: Vertex, active: mi.Bool) -> H:
        """Return the history after one more vertex. `path.depth` is the index of this vertex."""
        return path.history

    def after_sample(self, path: Path[H], vertex: Vertex, bsdf_sample: BSDFSample) -> H:
        """Return the history after the BSDF sample at the same vertex."""
        return path.history


class FurtherConnections(Protocol):
    """Additional connections of a vertex after its first connection, e.g. more emitter samples."""

    def count(self, path: Path) -> mi.UInt32:
        """Return the number of additional connections at the vertex with index `path.depth`."""

    def sample(
        self,
        k: mi.UInt32,
        first: Connection,
        vertex: Vertex,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Sample an additional connection.

        Args:
            k: Index of the additional connection: 0, 1, ...
            first: First connection of the vertex, from `Endpoint.connect`.
            vertex: The vertex.
            path: The path up to the vertex, before its update.
            sampler: The sampler.
            active: Active lanes.
        """


class CausticTracer(Protocol):
    """Rays from a vertex that follow delta lobes to an emitter, see `paths.caustic_rays`."""

    def trace(
        self,
        path: Path,
        vertex: Vertex,
        sampler: mi.Sampler,
        measurement: Measurement,
        active: mi.Bool,
    ) -> mi.UInt32:
        """Add the emission that the rays hit to the measurement.

        Returns the number of contributions that were not finite.

        Args:
            path: The path up to the vertex. `path.opl` is the length up to the vertex, and
                `path.depth` is the index of the vertex.
            vertex: The vertex.
            sampler: The sampler.
            measurement: Measurement that receives the contributions.
            active: Lanes with a vertex that has a smooth lobe.
        """


class MediumConnections(Protocol):
    """Connections of points in media that are sampled along rays, for a given path length.

    These connections replace the connections of vertices in media, and their MIS weight is 1.
    """

    def connect(
        self,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
        leave: LeaveVertex | None = None,
    ) -> tuple[Path, Vertex, Connection]:
        """Sample an emitter and a path length, and connect the point with this length.

        Args:
            path: The path up to its last vertex, with the ray from this vertex.
            sampler: The sampler.
            active: Active lanes.
            leave: None to connect a point of the path's ray. Otherwise the direction of the ray is
                sampled, and this function returns the path along it.

        Returns:
            A path up to the point, with updated `β` and `opl`, the point as a vertex, and the
            connection. The weight of the connection is divided by the densities of emitter and
            length.
        """


class Endpoint(ABC):
    """Target of next-event estimation: the emitters, or the lens for paths that start at emitters.

    The default methods describe a light that connections can find, but that rays cannot hit.
    """

    # Whether the loop calls `connect`, i.e. uses next-event estimation
    connects: bool = True

    # Whether connections find all light that smooth lobes scatter
    finds_all: bool = True

    # Whether `hit` returns the light of emitters
    has_hits: bool = False

    # Whether paths start at lights, and connections end on the sensor
    importance: bool = False

    # Whether the sensor looks through area lights
    hide_emitters: bool = False

    # Data of earlier vertices for MIS weights, None if the weights need no such data
    history: HistoryUpdates | None = None

    # Additional connections of each vertex, None for one connection per vertex
    further: FurtherConnections | None = None

    # Connections of points in media along rays, None to connect the vertices in media
    in_media: MediumConnections | None = None

    @abstractmethod
    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample a connection from a vertex.

        Args:
            vertex: The vertex.
            path: The path up to the vertex, before its update: `path.opl` is the length up to the
                vertex, `path.depth` is the index of the vertex, `path.ray` is the ray that leads to
                the vertex, and `path.prev` is the vertex before.
            sampler: The sampler.
            active: Lanes that need a connection.
        """

    def mis_weight(
        self, path: Path, vertex: Vertex, connection: Connection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return a connection's MIS weight, divided by the number of connections of the vertex.

        Args:
            path: The path up to `vertex`, before its update.
            vertex: The vertex that is connected.
            connection: The connection.
            bsdf_eval: BSDF or phase function at the vertex for the connection's direction.
        """
        return mi.Float(1)

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """Return the emission at the end of the path's ray, and the length of the ray.

        The length [m] is valid in all lanes, also in lanes without emission. By default, rays hit
        no emitter.
        """
        return Hit(
            radiance=mi.UnpolarizedSpectrum(0),
            pdf=mi.Float(0),
            length=vertex.length,
            active=mi.Bool(False),
            mis_weight=mi.Float(0),
        )

    def min_distance(self, p: mi.Point3f) -> mi.Float:
        """Return a lower bound for the lengths of all connections from points `p` [m]."""
        return mi.Float(0)

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """Return the emitters on surfaces that camera rays may hit, for `VisibleEmitters`."""
        return ()

    def for_bin_width(self, width_opl: float) -> Endpoint:
        """Return the endpoint for films with time bins of a given width.

        Narrow bins may need more emitter samples. The default does not depend on the width.

        Args:
            width_opl: Bin width as optical path length [m].
        """
        return self

    def attached(self) -> Endpoint:
        """Return the endpoint for attached sampling.

        The result makes one connection per vertex. Points on moving emitters have derivatives.
        """
        return self


class Scattering(ABC):
    """Samples and evaluates BSDFs and phase functions."""

    # Whether the index of refraction may change along paths
    refracts: bool = False

    def guide(self) -> mi.Float | None:
        """Return the initial `Path.guide`, None if `complete_sample` does nothing."""
        return None

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Return the path with complete `β` and `pdf` of the last BSDF sample.

        Guided samples depend on the vertex at the end of the sampled ray. Other samples are
        complete from the start.
        """
        return path

    @abstractmethod
    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Return lanes with a smooth lobe, which reflects light of connections."""

    @abstractmethod
    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the BSDF or the phase function for a direction.

        Args:
            vertex: The vertex.
            direction: Unit vector away from the vertex, in world space.
            active: Active lanes.
        """

    def eval_connection(self, vertex: Vertex, connection: Connection | None) -> BSDFEval | None:
        """Evaluate the BSDF for a connection's direction. Without a connection, return None."""
        if connection is None:
            return None
        return self.eval_pdf(vertex, connection.direction, connection.active)

    @abstractmethod
    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample the next direction, and evaluate the BSDF for the direction of a connection.

        Returns the evaluation for the connection, None without a connection, and the sample.
        """


class ScatteringWrapper(Scattering):
    """Abstract base of scattering that extends another scattering.

    The default methods call the inner scattering. A subclass must define `sample`.

    Args:
        inner: The inner scattering.
    """

    def __init__(self, inner: Scattering) -> None:
        self.inner = inner
        self.refracts = inner.refracts

    def guide(self) -> mi.Float | None:
        """Return the initial `Path.guide` of the inner scattering."""
        return self.inner.guide()

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Return the path as the inner scattering completes its sample."""
        return self.inner.complete_sample(path, vertex)

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Return lanes with a smooth lobe of the inner scattering."""
        return self.inner.smooth(vertex)

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate the inner scattering for a direction."""
        return self.inner.eval_pdf(vertex, direction, active)


class Measurement(Protocol):
    """Accumulates contributions.

    If a measurement is a dataclass, the loop carries its fields as state: sums are such fields.
    However, the arrays of a film must stay out of the state. Therefore a measurement that splats
    into a film has a function as its field.
    """

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""


class Parts:
    """Parts of the path loop, and its limits.

    This class is not a dataclass, so that the loop does not carry its fields as state.

    Args:
        space: Finds vertices along rays.
        endpoint: Target of next-event estimation, and emission where rays end.
        scattering: BSDFs and phase functions.
        limits: Limits that decide which contributions count.
    """

    def __init__(
        self, space: Space, endpoint: Endpoint, scattering: Scattering, limits: Limits
    ) -> None:
        self.space = space
        self.endpoint = endpoint
        self.scattering = scattering
        self.limits = limits

        # Velocities for rates of change of path lengths, None if rates are not computed
        self.motion: Velocities | None = None

        # Additional rays for caustics, None if the paths themselves find caustics
        self.caustic_rays: CausticTracer | None = None

    @property
    def iterations(self) -> int:
        """Largest number of rays of a path, -1 without a limit."""
        return -1 if self.space.stops else self.limits.iterations

    def with_endpoint(self, endpoint: Endpoint) -> Self:
        """Return a copy with another endpoint."""
        other = copy(self)
        other.endpoint = endpoint
        return other

    def with_motion(self, motion: Velocities | None) -> Self:
        """Return a copy with velocities, or without velocities for None.

        With velocities, contributions have rates of change.
        """
        other = copy(self)
        other.motion = motion
        return other
