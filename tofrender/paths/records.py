# pyright: reportOperatorIssue=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportArgumentType=false
"""The records of the path loop: a path, a vertex, what leaves it, and how far paths go.

Masks that a loop carries are stored as integers, floats are all as wide as the loop: Dr.Jit could
not differentiate the loop in reverse otherwise.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import multiply_throughput, unit_throughput


@dataclass
class Path:
    """A path up to its last vertex: the state of the loop.

    Attributes:
        ray: The ray that leads onwards.
        depth: Vertices so far.
        β: Throughput, of type `mi.UnpolarizedSpectrum`, in polarised variants a Mueller matrix, of
            type `mi.Spectrum`; `extend` multiplies it.
        η: Index of refraction around the ray; of paths from lights, over that around the light.
        opl: Optical length up to the last vertex [m].
        prev: The last vertex; at first the point that lengths are measured from.
        pdf: Density of the ray's direction [1/sr].
        memory: What the endpoint remembers of the vertices, None if nothing.
        guide: What the scattering remembers of how it chose the direction, None if nothing.
        place: What the space knows of where the ray is, None if it is the same everywhere.
        not_finite: Contributions that were left out because they were not finite.
        alive: `active` as an integer.
        met: `covered` as an integer.
        mirrored: `specular` as an integer.
    """

    ray: mi.Ray3f
    depth: mi.UInt32
    β: Any
    η: mi.Float
    opl: mi.Float
    prev: mi.Interaction3f
    pdf: mi.Float
    memory: Any
    guide: Any
    place: Any
    not_finite: mi.UInt32
    alive: mi.UInt32
    met: mi.UInt32
    mirrored: mi.UInt32

    @classmethod
    def start(
        cls,
        ray: mi.Ray3f,
        origin: Any = None,
        active: Any = True,
        memory: Any = None,
        guide: Any = None,
        place: Any = None,
        frame: Any = None,
        η: float = 1.0,
    ) -> Path:
        """A path that has no vertex yet.

        Args:
            ray: Where it goes.
            origin: Point from which its length is measured, the lens; by default the ray's start.
            active: Lanes that have a path.
            memory: As the endpoint's `memory()` gives it.
            guide: As the scattering's `guide()` gives it.
            place: As the space's `place(ray)` gives it.
            frame: Matrix that turns polarised light of the ray, None to leave it as it is.
            η: Index of refraction around the ray, if it starts on the sensor.
        """
        lanes = dr.width(ray)
        nothing = dr.zeros(mi.Float, lanes)
        ray = mi.Ray3f(ray)
        ray.o, ray.d = ray.o + nothing, ray.d + nothing
        ray.time, ray.maxt = ray.time + nothing, ray.maxt + nothing
        prev: Any = dr.zeros(mi.Interaction3f, lanes)
        prev.p = mi.Point3f(ray.o if origin is None else origin) + nothing
        return cls(
            ray=ray,
            depth=dr.zeros(mi.UInt32, lanes),
            β=_filled(unit_throughput() if frame is None else frame, nothing),
            η=η + nothing,
            opl=mi.Float(nothing),
            prev=prev,
            pdf=1 + nothing,
            memory=memory,
            guide=guide,
            place=place,
            not_finite=dr.zeros(mi.UInt32, lanes),
            alive=dr.select(mi.Bool(active), mi.UInt32(1), dr.zeros(mi.UInt32, lanes)),
            met=dr.zeros(mi.UInt32, lanes),
            mirrored=1 + dr.zeros(mi.UInt32, lanes),
        )

    @property
    def active(self) -> mi.Bool:
        """Lanes that still walk."""
        return self.alive != 0

    @active.setter
    def active(self, mask: mi.Bool) -> None:
        self.alive = dr.select(mask, mi.UInt32(1), 0)

    @property
    def covered(self) -> mi.Bool:
        """Lanes whose first ray met a surface."""
        return self.met != 0

    @covered.setter
    def covered(self, mask: mi.Bool) -> None:
        self.met = dr.select(mask, mi.UInt32(1), 0)

    @property
    def specular(self) -> mi.Bool:
        """Lanes in which nothing but the path itself finds what the ray runs into."""
        return self.mirrored != 0

    @specular.setter
    def specular(self, mask: mi.Bool) -> None:
        self.mirrored = dr.select(mask, mi.UInt32(1), 0)


def extend(throughput: Any, factor: Any, importance: bool = False) -> Any:
    """Throughput of a path after one more factor (a BSDF's, a transmittance).

    The one place that multiplies: a path from the sensor puts new factors on the right, one from a
    light, with `importance`, on the left, which matters where they are Mueller matrices.
    """
    return multiply_throughput(throughput, factor, importance)


def _filled(throughput: Any, nothing: mi.Float) -> Any:
    """A throughput as wide as the paths."""
    if not mi.is_polarized:
        return throughput + nothing
    return mi.Spectrum(*[throughput[i, j] + nothing for i in range(4) for j in range(4)])


@dataclass
class Vertex:
    """Where a ray leads.

    Attributes:
        si: The surface point; a point in a medium has no shape and no normal there.
        length: Distance from the last vertex, point to point [m].
        valid: Whether there is a surface, or a point that scatters.
        inside: What the space knows of such a point, None where there are surfaces only.
    """

    si: mi.SurfaceInteraction3f
    length: mi.Float
    valid: mi.Bool
    inside: Any = None

    def cosine(self, d: mi.Vector3f) -> mi.Float:
        """Cosine between a direction and the normal, unsigned; 1 in a medium, which has none."""
        cos = dr.abs(dr.dot(self.si.n, d))
        return cos if self.inside is None else dr.select(self.inside.here, 1, cos)


@dataclass
class Hit:
    """Light that a ray runs into.

    Attributes:
        radiance: Radiance towards the last vertex.
        pdf: Solid-angle density with which a connection from there would have found it [1/sr].
        length: Distance to where it was emitted [m].
        active: Lanes in which it counts.
    """

    radiance: Any
    pdf: mi.Float
    length: mi.Float
    active: mi.Bool


@dataclass
class Connection:
    """One sample of next-event estimation, before anything is known of what lies between.

    Attributes:
        point: Where the connection ends [m].
        direction: Unit vector from the vertex towards it, world space.
        weight: Radiance over density.
        pdf: Density of `direction` [1/sr].
        delta: Whether nothing else finds this light (point lights, lasers), so that it counts in
            full; with an endpoint that `finds_all`, every connection does.
        length: Geometric length of the connection, which may start beyond `point` [m].
        active: Lanes in which there is a connection.
        clear: Lanes in which nothing can be in the way.
        position: Where on the film the connection lands, if it ends on the sensor [pixels].
        rival: What the endpoint wants to know again when it tells the connection's share, or makes
            further connections.
        frame: Matrix that turns polarised light at the connection's end, if it ends on the sensor.
        reach: Length of the connection in which media count, if it goes on behind `point` where no
            surface does [m].
    """

    point: mi.Point3f
    direction: mi.Vector3f
    weight: Any
    pdf: mi.Float
    delta: mi.Bool
    length: mi.Float
    active: mi.Bool
    clear: mi.Bool
    position: Any = None
    rival: Any = None
    frame: Any = None
    reach: Any = None

    @classmethod
    def plain(
        cls,
        point: mi.Point3f,
        direction: mi.Vector3f,
        length: mi.Float,
        active: mi.Bool,
        reach: Any = None,
    ) -> Connection:
        """A connection that asks only what of light comes through: to a point of radiance 1."""
        return cls(
            point=point,
            direction=direction,
            weight=mi.UnpolarizedSpectrum(1),
            pdf=mi.Float(1),
            delta=mi.Bool(True),
            length=length,
            active=mi.Bool(active),
            clear=mi.Bool(False),
            reach=reach,
        )

    def only(self, mask: mi.Bool) -> Connection:
        """The same in some of its lanes."""
        other = copy(self)
        other.active = self.active & mask
        return other


@dataclass
class Turn:
    """What a vertex makes of one direction.

    Attributes:
        f: BSDF times cosine.
        pdf: Density with which the path would have gone there [1/sr].
        η: Index of refraction on that side, over that on the path's side.
        back: Density with which a path from there would go where this one has come from [1/sr],
            where scattering knows both ways; else None.
    """

    f: Any
    pdf: mi.Float
    η: mi.Float
    back: Any = None


@dataclass
class Bounce:
    """Where a vertex sends the path.

    Attributes:
        ray: The ray onwards.
        weight: BSDF times cosine over the density of the ray's direction.
        pdf: That density [1/sr].
        η: Index of refraction around the ray onwards, over that before.
        specular: Whether the direction was the only one possible.
        guide: What the scattering remembers of how it chose.
        back: As in `Turn`.
        straight: Whether the surface has let the path straight through (a null lobe).
    """

    ray: mi.Ray3f
    weight: Any
    pdf: mi.Float
    η: mi.Float
    specular: mi.Bool
    guide: Any = None
    back: Any = None
    straight: Any = False


class Limits:
    """What of a path counts. No dataclass, so that the loop does not carry it as state.

    Args:
        max_depth: Longest path in segments, camera's included: 1 shows emitters only, 2 adds
            direct light; -1 means no limit.
        rr_depth: Number of surface vertices from which on Russian roulette may end a path.
        last_opl: Length at which paths may end, because longer ones count for nothing [m].
        unwarp: Leave out the segment from the sensor to the first vertex, so that time is the
            scene's own ("camera unwarping").
        skips_first: Leave out light of the first surface, which is then found apart.
        straight: Whether surfaces that let a path straight through are no vertices of it, as in
            Mitsuba's `volpath`: neither depth nor shares know of them. The space and the endpoint
            then must not, either.
    """

    def __init__(
        self,
        max_depth: int,
        rr_depth: int = 5,
        last_opl: Any = None,
        unwarp: bool = False,
        skips_first: bool = False,
        straight: bool = False,
    ) -> None:
        self.max_depth, self.rr_depth = max_depth, rr_depth
        self.last_opl, self.unwarp, self.skips_first = last_opl, unwarp, skips_first
        self.straight = straight

    def without_first(self) -> Limits:
        """The same, but light of the first surface does not count."""
        other = copy(self)
        other.skips_first = True
        return other

    @property
    def bounded(self) -> bool:
        """Whether paths have a longest one."""
        return self.max_depth >= 0

    @property
    def iterations(self) -> int:
        """Bound on the rays of a path, -1 if there is none."""
        return self.max_depth if self.bounded and not self.straight else -1
