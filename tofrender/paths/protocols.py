"""The four parts that vary between renderers. The loop asks none of them what it is.

| part | kind | is |
|---|---|---|
| space | `space.Vacuum` | straight rays, nothing lost on the way |
| | `media.Media` | straight rays through fog, smoke and milk |
| endpoint | `endpoints.SceneLights` | the scene's emitters, by connections and by hits |
| | `endpoints.scene_lights.LightsStraightAhead` | the same, behind panes and masks too |
| | `endpoints.EmitterHits` | the scene's emitters where paths run into them |
| | `endpoints.ConnectionsOnly` | the scene's emitters by connections, mirrors and glass apart |
| | `endpoints.OneSampleLights` | an emitter or, as often, what the material's sampling finds |
| | `endpoints.GatedLights` | points on emitters whose light comes when a gate is open |
| | `endpoints.GatedFog` | the same, from points of media along rays |
| | `endpoints.PointSource`, `endpoints.OpenSky` | a light that is not part of the scene |
| | `endpoints.camera.Camera` | the lens, for paths that come from lights |
| | `endpoints.light_paths.LightPaths` | the scene's emitters, and the vertices of a light path |
| | `nlos.light.laser_spot.LaserSpot` | the point of a wall that a laser lights |
| | `nlos.light.transient_nlos.LaserItself` | the laser, for the paths that count |
| scattering | `scattering.Materials` | each surface's own material, or one for all |
| | `phases.Phases` | phase functions in media, another scattering on surfaces |
| | `guided.Guided` | another scattering, mixed with directions to target surfaces |
| measurement | `films.sums.Radiance` | the plain sum |
| | `films.sums.Weighted` | a sum weighted by length: a gate, a correlation |
| | `films.deposit.FilmDeposit` | a film's time bins |
| | `films.phasor_sum.PhasorSum` | phasors of some frequencies |
| | `rendering.arrivals.ArrivalHistogram` | energy over length, for all pixels together |

A part is a plain object. What it has to remember of a path it keeps in the path (`memory`,
`guide`), never in itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import mitsuba as mi

from ..films.contribution import Contribution
from .records import Bounce, Connection, Hit, Path, Turn, Vertex


class Space(Protocol):
    """How the next vertex is found, how long the way is, and what is lost on it.

    Attributes:
        scatters: Whether vertices may be points of media.
        index: Index of refraction around the sensor.
    """

    scatters: bool
    index: float

    def scattering(
        self,
        surfaces: Scattering,
        importance: bool = False,
        both_ways: bool = False,
        connects: bool = False,
    ) -> Scattering:
        """How paths go on from all points of the space, where it is known for surfaces.

        `importance` says that paths come from lights, `both_ways` that densities of the way back
        are asked for, `connects` that all media connect, whatever their `sample_emitters` says.
        """
        ...

    def attached(self) -> Space:
        """The same as derivatives follow it."""
        ...

    def place(self, ray: mi.Ray3f) -> Any:
        """What is known of where a sensor's rays start, None if it is the same everywhere."""
        ...

    def around(self, ray: mi.Ray3f) -> Any:
        """The same of rays that start at a light."""
        ...

    def leave(self, path: Path, vertex: Vertex, direction: mi.Vector3f) -> Any:
        """What is known of where a path is that goes on from a vertex."""
        ...

    def next(self, path: Path, sampler: mi.Sampler) -> tuple[Path, Vertex]:
        """Where the path's ray leads, and the path with what was lost on the way."""
        ...

    def transmittance(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> Any:
        """What of a connection's light arrives at the vertex: 0 where something is in the way."""
        ...

    def through(
        self, path: Path, vertex: Vertex, connection: Connection, sampler: mi.Sampler
    ) -> tuple[Any, Any]:
        """The same, and what is known of where the connection ends, before what it meets there."""
        ...


class Endpoint(Protocol):
    """What a vertex connects to, and what a ray may run into.

    Attributes:
        connects: Whether next-event estimation happens at all.
        finds_all: Whether connections find all light on their own, mirrors apart.
        importance: Whether paths come from a light, and connections end on the sensor.
        looks_ahead: Whether points of media that rays pass connect in the place of those where
            they are scattered.
    """

    connects: bool
    finds_all: bool
    importance: bool
    looks_ahead: bool

    def resolving(self, width_opl: float) -> Endpoint:
        """The same for light whose lengths are told apart by `width_opl` [m]."""
        ...

    def attached(self) -> Endpoint:
        """The same as derivatives follow it: one connection a vertex, to points that move."""
        ...

    def begin(self, ray: mi.Ray3f) -> mi.Ray3f:
        """The sensor's ray, past whatever the sensor does not see of this endpoint."""
        ...

    def in_view(self) -> Sequence[mi.Emitter]:
        """Emitters on surfaces that the sensor's rays may run into."""
        ...

    def memory(self) -> Any:
        """What is remembered before the first vertex, None if nothing ever is."""
        ...

    def remember(self, path: Path, vertex: Vertex, active: mi.Bool) -> Any:
        """The path's memory with one more vertex."""
        ...

    def leave(self, path: Path, vertex: Vertex, bounce: Bounce) -> Any:
        """The path's memory with the direction that it goes on in."""
        ...

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """A connection from the vertex. The path's length reaches it, `path.prev` is before it."""
        ...

    def more_links(self, path: Path, first: Connection) -> mi.UInt32 | None:
        """How many connections follow the first one, by `link`; None if none ever do."""
        ...

    def link(
        self,
        k: mi.UInt32,
        first: Connection,
        vertex: Vertex,
        path: Path,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """Number `k` of the connections that follow the first one."""
        ...

    def wait(self, path: Path, sampler: mi.Sampler, active: mi.Bool) -> Any:
        """How long light may take to the path's last vertex by way of a point of a medium."""
        ...

    def towards(self, wait: Any, sampler: mi.Sampler) -> tuple[Any, mi.Vector3f, mi.Float]:
        """A direction to look for such a point in, the wait in it, and its density [1/sr]."""
        ...

    def ahead(
        self, path: Path, wait: Any, space: Any, sampler: mi.Sampler
    ) -> tuple[Path, Vertex, Connection]:
        """Such a point along the path's ray, the path up to there, and its connection."""
        ...

    def hit(self, vertex: Vertex, path: Path) -> Hit:
        """Light that the path's ray runs into."""
        ...

    def share_of_hit(self, path: Path, vertex: Vertex, hit: Hit) -> mi.Float:
        """The hit's share of the light, where other ways may find the same."""
        ...

    def share_of_link(self, path: Path, vertex: Vertex, link: Connection, turn: Turn) -> mi.Float:
        """A connection's share; `turn` is what the vertex makes of it."""
        ...

    def nearest(self, p: mi.Point3f) -> mi.Float:
        """Length that no connection from p falls below [m]."""
        ...


class Scattering(Protocol):
    """How a path goes on from a vertex."""

    @property
    def refracts(self) -> bool:
        """Whether the index of refraction may change: a length may be shorter than the way is."""
        ...

    def guide(self) -> Any:
        """The path's guide before the first vertex, None if there never is one."""
        ...

    def arrive(self, path: Path, vertex: Vertex) -> Path:
        """What the new vertex tells of the direction that was chosen at the last one."""
        ...

    def smooth(self, vertex: Vertex) -> mi.Bool:
        """Whether connections can find light here: a delta lobe reflects none of them."""
        ...

    def turn(self, vertex: Vertex, direction: mi.Vector3f, active: mi.Bool) -> Turn:
        """What is made of a direction."""
        ...

    def scatter(
        self, vertex: Vertex, link: Connection | None, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, Bounce]:
        """Towards a connection, if there is one, and onwards."""
        ...


class Measurement(Protocol):
    """What becomes of light that arrives.

    One that accumulates in variables is a dataclass of Dr.Jit arrays, which the loop carries as its
    state; one that scatters into a film hides the film in a function. Films want its `total`, the
    plain sum.
    """

    def add(self, contribution: Contribution) -> None:
        """Take in a contribution."""
        ...
