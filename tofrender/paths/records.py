"""Records of the path loop: paths, vertices, connections, BSDF samples, and limits.

Masks that a loop carries are stored as integers, floats are all as wide as the loop: Dr.Jit could
not differentiate the loop in reverse otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import unit_throughput
from .kinds import Kind, Lobes

H = TypeVar("H")  # history that an endpoint keeps of a path


def _mask(flag: str, doc: str) -> property:
    """Return a property for a mask that is stored as an integer."""

    def read(path: Path) -> mi.Bool:
        return getattr(path, flag) != 0

    def write(path: Path, mask: mi.Bool) -> None:
        setattr(path, flag, dr.select(mask, mi.UInt32(1), 0))

    return property(read, write, doc=doc)


@dataclass
class Path(Generic[H]):
    """A path up to its last vertex: the state of the loop."""

    ray: mi.Ray3f  # the ray to the next vertex
    depth: mi.UInt32  # number of vertices so far
    # path throughput, a Mueller matrix in polarised variants; `multiply_throughput` multiplies it
    β: mi.Spectrum
    # index of refraction around the ray; for paths from lights, relative to that around the light
    η: mi.Float
    opl: mi.Float  # optical path length up to the last vertex [m]
    prev: mi.Interaction3f  # the last vertex; at first the point that lengths are measured from
    pdf: mi.Float  # solid-angle density of the ray's direction [1/sr]
    history: H  # what the endpoint's MIS weights need of earlier vertices, None if nothing
    # distance to the target that guiding has sent the ray to, on which the density of that
    # direction depends, see `nlos.light.guided`; else None
    guide: mi.Float | None
    medium: mi.MediumPtr | None  # the current medium, null in vacuum; None in scenes without media
    not_finite: mi.UInt32  # number of contributions dropped because they were not finite
    active_flag: mi.UInt32  # masks as integers, see the properties of the same names
    valid_ray_flag: mi.UInt32
    specular_flag: mi.UInt32
    # rate of change of `opl`, and velocity of the last vertex [m/s]; None where no rates are wanted
    rate: mi.Float | None = None
    velocity: mi.Vector3f | None = None
    # distance from the last vertex to where `ray` starts, if the ray has passed an emitter on an
    # index-matched boundary, otherwise 0 [m]; None if rays do not stop at such emitters
    passed: mi.Float | None = None
    # lobes that have scattered the path, for its kind; None if all kinds of paths count
    lobes: Lobes | None = None

    @classmethod
    def start(
        cls,
        ray: mi.Ray3f,
        origin: mi.Point3f | None = None,
        active: mi.Bool | bool = True,
        history: H = None,
        guide: mi.Float | None = None,
        medium: mi.MediumPtr | None = None,
        frame: mi.Spectrum | None = None,
        η: float = 1.0,
        velocity: mi.Vector3f | None = None,
        stops: bool = False,
        records_lobes: bool = False,
    ) -> Path[H]:
        """Create a path that has no vertex yet.

        Lengths are measured from `origin`, e.g. on the lens, by default the ray's origin. History,
        guide and medium are as from `HistoryUpdates.start`, `Scattering.guide` and
        `Space.medium_at`, `frame` is the Mueller matrix into the sensor's frame; `velocity` that of
        the origin [m/s], if rates are wanted. With `stops`, rays stop at emitters on index-matched
        boundaries, so that their light is added. With `records_lobes`, the path knows its kind.
        """
        zero, no = dr.zeros(mi.Float, dr.width(ray)), dr.zeros(mi.UInt32, dr.width(ray))
        ray = mi.Ray3f(ray)
        ray.o, ray.d = ray.o + zero, ray.d + zero
        ray.time, ray.maxt = ray.time + zero, ray.maxt + zero
        prev = dr.zeros(mi.Interaction3f, dr.width(ray))
        prev.p = mi.Point3f(ray.o if origin is None else origin) + zero
        return cls(
            ray=ray,
            depth=mi.UInt32(no),
            β=_widened(unit_throughput() if frame is None else frame, zero),
            η=η + zero,
            opl=mi.Float(zero),
            prev=prev,
            pdf=1 + zero,
            history=history,
            guide=guide,
            medium=medium,
            not_finite=mi.UInt32(no),
            active_flag=dr.select(mi.Bool(active), mi.UInt32(1), no),
            valid_ray_flag=mi.UInt32(no),
            specular_flag=1 + no,
            rate=None if velocity is None else mi.Float(zero),
            velocity=None if velocity is None else velocity + zero,
            passed=mi.Float(zero) if stops else None,
            lobes=Lobes.none(no) if records_lobes else None,
        )

    active = _mask("active_flag", "lanes whose path goes on")
    # With `hide_emitters`, null interactions do not count, as in Mitsuba
    valid_ray = _mask("valid_ray_flag", "lanes whose first ray met a surface")
    # No connection competes with such a ray
    specular = _mask("specular_flag", "lanes whose ray comes from a delta lobe or the sensor")


def _widened(throughput: mi.Spectrum, zero: mi.Float) -> mi.Spectrum:
    """Broadcast a throughput to the width of the paths."""
    if not mi.is_polarized:
        return throughput + zero
    return mi.Spectrum(*[throughput[i, j] + zero for i in range(4) for j in range(4)])


@dataclass
class MediumPoint:
    """A point where a medium scatters: the `in_medium` of a vertex."""

    mei: mi.MediumInteraction3f  # the medium interaction
    here: mi.Bool  # lanes whose vertex is such a point; the others are on surfaces

    @property
    def medium(self) -> mi.MediumPtr:
        """The medium that scatters, null on surfaces."""
        return dr.select(self.here, self.mei.medium, dr.zeros(mi.MediumPtr))


@dataclass
class Vertex:
    """A vertex of a path: where a ray ends."""

    # the surface interaction; a point in a medium has no shape and no normal there
    si: mi.SurfaceInteraction3f
    length: mi.Float  # distance from the last vertex, point to point [m]
    valid: mi.Bool  # lanes that met a surface, or a point that scatters
    in_medium: MediumPoint | None = None  # the medium interaction, None in scenes without media
    # lanes in which the ray has stopped at an emitter on an index-matched boundary. The path adds
    # the emission and follows the same ray. None if rays do not stop there
    passes: mi.Bool | None = None

    @property
    def medium_point(self) -> MediumPoint:
        """The medium interaction, in scenes with media."""
        assert self.in_medium is not None
        return self.in_medium

    def cosine(self, d: mi.Vector3f) -> mi.Float:
        """Unsigned cosine between a direction and the geometric normal; 1 in a medium."""
        cos = dr.abs(dr.dot(self.si.n, d))
        return cos if self.in_medium is None else dr.select(self.in_medium.here, 1, cos)


@dataclass
class Hit:
    """Emission that a ray runs into."""

    radiance: mi.UnpolarizedSpectrum  # emitted radiance towards the last vertex
    # solid-angle density of next-event estimation for the same direction, for `mis_weight` [1/sr]
    pdf: mi.Float
    length: mi.Float  # length of the ray's segment, also in lanes without emission [m]
    active: mi.Bool  # lanes in which it counts
    mis_weight: mi.Float  # MIS weight against the other techniques that find the same light


@dataclass
class Connection:
    """A sample of next-event estimation, before visibility is known.

    Endpoints whose MIS weights need more than this return a subclass.
    """

    point: mi.Point3f  # where the connection ends [m]
    direction: mi.Vector3f  # unit vector from the vertex towards it, world space
    weight: mi.Spectrum  # radiance over density
    # geometric length; longer than the distance to `point` if the light itself starts further away
    length: mi.Float
    active: mi.Bool  # lanes in which there is a connection
    # solid-angle density of `direction` [1/sr]
    pdf: mi.Float = field(default_factory=lambda: mi.Float(1))
    # lanes whose light no ray can run into (point lights, lasers)
    delta: mi.Bool = field(default_factory=lambda: mi.Bool(True))
    # lanes that need no shadow ray
    unoccluded: mi.Bool = field(default_factory=lambda: mi.Bool(False))
    # position on the film where it arrives, if it ends on the sensor [pixels]
    position: mi.Point2f | None = None
    frame: mi.Spectrum | None = None  # Mueller matrix at the connection's end, None for none
    # length over which media attenuate, if not the distance to `point` [m]
    medium_length: mi.Float | None = None
    emitter: mi.EmitterPtr | None = None  # where it ends; None for the sensor
    rate: mi.Float | None = None  # of `length` [m/s], if it is not that of its two ends

    @classmethod
    def to_point(
        cls,
        point: mi.Point3f,
        direction: mi.Vector3f,
        length: mi.Float,
        active: mi.Bool,
        medium_length: mi.Float | None = None,
    ) -> Connection:
        """Create a connection to a point of radiance 1, of which only the transmittance counts."""
        weight, active = mi.UnpolarizedSpectrum(1), mi.Bool(active)
        return cls(point, direction, weight, length, active, medium_length=medium_length)


@dataclass
class BSDFEval:
    """BSDF or phase function evaluated for one direction."""

    f: mi.Spectrum  # BSDF times cosine, or phase function
    pdf: mi.Float  # solid-angle density with which the path would have gone there [1/sr]
    η: mi.Float  # index of refraction on that side, relative to the path's side
    # density of the opposite way, from that direction to where the path came from [1/sr]; None
    # unless the scattering is `both_ways`
    pdf_reverse: mi.Float | None = None


@dataclass
class BSDFSample:
    """Sampled direction in which a path goes on."""

    ray: mi.Ray3f  # the next ray
    weight: mi.Spectrum  # BSDF times cosine over the density of the ray's direction
    pdf: mi.Float  # that density [1/sr]
    η: mi.Float  # index of refraction around the next ray, relative to that before
    specular: mi.Bool  # lanes that sampled a delta lobe
    guide: mi.Float | None = None  # new value of `Path.guide`
    pdf_reverse: mi.Float | None = None  # as in `BSDFEval`
    # lanes that sampled a null lobe: the path goes straight through the surface
    null: mi.Bool = field(default_factory=lambda: mi.Bool(False))


class Limits:
    """Which contributions of a path count. No dataclass, so that the loop does not carry it.

    Args:
        max_depth: Longest path in segments, camera's included: 1 shows emitters only, 2 adds
            direct light; -1 means no limit.
        rr_depth: Number of vertices from which on Russian roulette may end a path.
        max_opl: Optical path length beyond which no contribution counts [m], None if all do.
        camera_unwarp: Leave out the segment from the sensor to the first vertex.
        left_out: Kinds of paths that another technique renders, see `paths.kinds`.
        min_depth: Shortest path in segments: 3 leaves out emitters and direct light.
        ignore_null: Null interactions change neither depth nor MIS weights, as in Mitsuba's
            `volpath`. Space and endpoint must pass through null surfaces (`transient_volpath`).
    """

    def __init__(
        self,
        max_depth: int,
        rr_depth: int = 5,
        max_opl: mi.Float | float | None = None,
        camera_unwarp: bool = False,
        ignore_null: bool = False,
        min_depth: int = 0,
        left_out: frozenset[Kind] = frozenset(),
    ) -> None:
        self.min_depth = min_depth
        self.max_depth, self.rr_depth, self.max_opl = max_depth, rr_depth, max_opl
        self.camera_unwarp, self.left_out = camera_unwarp, left_out
        self.ignore_null = ignore_null

    def long_enough(self, segments: mi.UInt32) -> mi.Bool | bool:
        """Return where paths are not too short to count."""
        return segments >= self.min_depth if self.min_depth > 0 else True

    @property
    def bounded(self) -> bool:
        """Whether `max_depth` limits paths."""
        return self.max_depth >= 0

    @property
    def iterations(self) -> int:
        """Bound on the rays of a path, -1 if there is none."""
        return self.max_depth if self.bounded and not self.ignore_null else -1
