"""Interfaces of the path loop: space, endpoint, scattering and measurement.

The loop never looks at their types.

| interface | implementation | is |
|---|---|---|
| space | `space.Vacuum` | straight rays between surfaces |
| | `media.space.Media` | straight rays through participating media |
| endpoint | `endpoints.SceneLights` | the scene's emitters, by next-event estimation and hits |
| | `endpoints.EmitterHits`, `ConnectionsOnly` | one of both techniques |
| scattering | `scattering.Materials` | the BSDF of each surface, or one for all |
| | `media.phases.Phases` | phase functions in media, another scattering on surfaces |
| measurement | `films.sums.Radiance` | the sum of all light |
| | `films.sums.Weighted` | a sum weighted by path length: a gate, a correlation |
| | `films.time_bins.TimeBins` | a film's time bins |
| | `films.phasor_sum.PhasorSum` | phasors of some frequencies |
| | `rendering.arrivals.ArrivalHistogram` | energy over path length, for all pixels together |

Other endpoints stand beside what needs them: in `integrators`, `media.gated`, `bidirectional` and
`nlos.light`. Implementations have no state of their own: what they need to know of a path is stored
in it (`history`, `guide`, `medium`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import TYPE_CHECKING, Generic, Protocol, Self, TypeVar

import mitsuba as mi

from ..films.contribution import Contribution
from .records import BSDFEval, BSDFSample, Connection, Hit, Limits, Path, Vertex

if TYPE_CHECKING:
    from .motion import Velocities

H = TypeVar("H")
T = TypeVar("T", bound="Target")


class Space(ABC):
    """Finds vertices along rays, and the transmittance of connections; by default without media."""

    scatters: bool = False  # whether vertices may be points of media
    stops: bool = False  # whether rays stop at emitters on index-matched boundaries

    index: float  # index of refraction around the sensor

    def with_phase_functions(self, surfaces: Scattering, **options: bool) -> Scattering:
        """Extend scattering at surfaces to points of media; options are those of `Materials`."""
        return surfaces

    def attached(self) -> Space:
        """Return the space for attached sampling: free-flight distances have derivatives."""
        return self

    def medium_at_sensor(self, ray: mi.Ray3f) -> mi.MediumPtr | None:
        """Return the current medium of rays that start at the sensor, None without media."""
        return None

    def medium_at(self, ray: mi.Ray3f) -> mi.MediumPtr | None:
        """Find the current medium of rays that start anywhere else, None without media."""
        return None

    def medium_behind(
        self, path: Path, vertex: Vertex, direction: mi.Vector3f
    ) -> mi.MediumPtr | None:
        """Return the current medium of a path that leaves a vertex in a direction."""
        return None

    @abstractmethod
    def next_vertex(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Intersect the path's ray; of the path, only throughput and current medium may change."""

    def behind_emitter(self, path: Path, vertex: Vertex) -> Path:
        """Start the ray of a path behind the emitter at which the ray has stopped.

        The path is as `next_vertex` has returned it. Called where `Vertex.passes` is not None.
        """
        raise NotImplementedError(f"{type(self).__name__} must define behind_emitter")

    @abstractmethod
    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> mi.Spectrum:
        """Estimate the transmittance of a connection, 0 where a surface blocks it."""

    def transmittance_and_medium(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> tuple[mi.Spectrum, mi.MediumPtr | None]:
        """As `transmittance`, and the medium at the end, for MIS weights of light paths."""
        return self.transmittance(path, vertex, connection, sampler), None


class HistoryUpdates(ABC, Generic[H]):
    """Keeps what MIS weights need of a path's earlier vertices, in `Path.history`."""

    @abstractmethod
    def start(self) -> H:
        """Create the history of a path without vertices."""

    def at_vertex(self, path: Path[H], vertex: Vertex, active: mi.Bool) -> H:
        """Return the history after one more vertex, whose number is `path.depth`."""
        return path.history

    def after_sample(self, path: Path[H], vertex: Vertex, bsdf_sample: BSDFSample) -> H:
        """Return the history after the BSDF sample at that vertex."""
        return path.history


class FurtherConnections(Protocol):
    """Connections of a vertex beside its first one, such as more emitter samples."""

    def count(self, path: Path) -> mi.UInt32:
        """Return how many follow the first one at vertex number `path.depth`."""

    def sample(
        self,
        k: mi.UInt32,
        first: Connection,
        vertex: Vertex,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Sample number `k` = 0, 1, ... after the first."""


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
        """Add the emission that the rays find; returns how many were not finite.

        `path.opl` reaches up to the vertex, whose number is `path.depth`. Lanes are active whose
        vertex has a smooth lobe.
        """


class Target(Protocol):
    """Emitter sample, and length from `path.prev` to it by way of a point of a medium."""

    active: mi.Bool  # lanes in which there is such a point


class MediumConnections(Protocol[T]):
    """Connections of points of media that are sampled for a path length, along rays.

    They replace those of vertices in media, and have no MIS weight. Along the ray to the next
    vertex, `prepare` samples emitter and length, and `connect` finds the point with that length.
    From a vertex, `sample_direction` samples such a ray first.
    """

    def prepare(self, path: Path, sampler: mi.Sampler, active: mi.Bool) -> T:
        """Sample the emitter, and the length from there to the path's last vertex."""

    def sample_direction(self, target: T, sampler: mi.Sampler) -> tuple[T, mi.Vector3f, mi.Float]:
        """Sample a direction to the point; returns the target along it, and the density [1/sr]."""

    def connect(
        self, path: Path, target: T, sampler: mi.Sampler
    ) -> tuple[Path, Vertex, Connection]:
        """Connect the point of the ray; returns the path up to it, its `β` and `opl` included.

        The connection's weight is divided by the densities of emitter and length.
        """


class Endpoint(ABC):
    """Light-sampling technique, or the lens: what vertices connect to, and what rays run into.

    By default a light that only connections find, and that no ray runs into.
    """

    connects: bool = True  # whether there is next-event estimation at all
    finds_all: bool = True  # whether connections find all light but that of delta lobes
    has_hits: bool = False  # whether `hit` returns the light of emitters that rays run into
    importance: bool = False  # whether paths come from lights, and connections end on the sensor
    hide_emitters: bool = False  # whether the sensor looks through area lights
    history: HistoryUpdates | None = None  # for MIS weights that need earlier vertices
    further: FurtherConnections | None = None  # connections beside the first one of a vertex
    in_media: MediumConnections | None = None  # connections of points of media along rays

    @abstractmethod
    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Sample a connection from the vertex.

        `path.opl` reaches up to the vertex, whose number is `path.depth`; `path.ray` is the ray
        that has led to it, and `path.prev` the vertex before.
        """

    def mis_weight(
        self, path: Path, vertex: Vertex, connection: Connection, bsdf_eval: BSDFEval
    ) -> mi.Float:
        """Return a connection's MIS weight, divided by how many the vertex makes."""
        return mi.Float(1)

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """Return emission at the ray's end, and the length by which `opl` grows in all lanes."""
        black, never = mi.UnpolarizedSpectrum(0), mi.Bool(False)
        return Hit(black, mi.Float(0), vertex.length, never, mis_weight=mi.Float(0))

    def min_distance(self, p: mi.Point3f) -> mi.Float:
        """Return a lower bound of the lengths of all connections from points [m]."""
        return mi.Float(0)

    def visible_emitters(self) -> Sequence[mi.Emitter]:
        """Return emitters on surfaces that camera rays may run into, for `VisibleEmitters`."""
        return ()

    def for_bin_width(self, width_opl: float) -> Endpoint:
        """Return the endpoint for films of this resolution [m], e.g. with more emitter samples."""
        return self

    def attached(self) -> Endpoint:
        """Return the endpoint for attached sampling, with one connection, to points that move."""
        return self


class Scattering(ABC):
    """Samples and evaluates BSDFs and phase functions."""

    refracts: bool = False  # whether the index of refraction may change along paths

    def guide(self) -> mi.Float | None:
        """Return the initial `Path.guide`, None if `complete_sample` does nothing."""
        return None

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Complete `β` and `pdf` of the last sample, where they depend on the next vertex."""
        return path

    @abstractmethod
    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Return lanes whose BSDF has more than delta lobes, so that connections find light."""

    @abstractmethod
    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Evaluate BSDF or phase function for a direction."""

    def eval_connection(self, vertex: Vertex, connection: Connection | None) -> BSDFEval | None:
        """Evaluate the direction of a connection, if there is one."""
        if connection is None:
            return None
        return self.eval_pdf(vertex, connection.direction, connection.active)

    @abstractmethod
    def sample(
        self, vertex: Vertex, connection: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[BSDFEval | None, BSDFSample]:
        """Sample a direction, and evaluate that of a connection if there is one, else None."""


class ScatteringWrapper(Scattering):
    """Scattering that extends an inner one, to which it delegates by default."""

    def __init__(self, inner: Scattering) -> None:
        self.inner, self.refracts = inner, inner.refracts

    def guide(self) -> mi.Float | None:
        """Delegate to the inner scattering."""
        return self.inner.guide()

    def complete_sample(self, path: Path, vertex: Vertex) -> Path:
        """Delegate to the inner scattering."""
        return self.inner.complete_sample(path, vertex)

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Delegate to the inner scattering."""
        return self.inner.smooth(vertex)

    def eval_pdf(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> BSDFEval:
        """Delegate to the inner scattering."""
        return self.inner.eval_pdf(vertex, direction, active)


class Measurement(Protocol):
    """Accumulates contributions.

    The loop carries the fields of dataclasses as its state. Sums are such fields; one that scatters
    into a film has a function instead, since the film's arrays must stay out of the state.
    """

    def add(self, contribution: Contribution) -> None:
        """Add a contribution."""


class Parts:
    """Parts of the path loop and its limits; no dataclass, so that the loop does not carry it."""

    def __init__(
        self, space: Space, endpoint: Endpoint, scattering: Scattering, limits: Limits
    ) -> None:
        self.space, self.endpoint = space, endpoint
        self.scattering, self.limits = scattering, limits
        self.motion: Velocities | None = None  # set if rates of change are wanted
        self.caustic_rays: CausticTracer | None = None  # None if paths find caustics themselves

    @property
    def iterations(self) -> int:
        """Largest number of rays of a path, -1 if it is unlimited."""
        return -1 if self.space.stops else self.limits.iterations

    def with_endpoint(self, endpoint: Endpoint) -> Self:
        """Return the parts with another endpoint."""
        other = copy(self)
        other.endpoint = endpoint
        return other

    def with_motion(self, motion: Velocities | None) -> Self:
        """Return the parts with velocities, for contributions with rates of change."""
        other = copy(self)
        other.motion = motion
        return other
