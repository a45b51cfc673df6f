"""Records of the path loop: paths, vertices, connections, BSDF samples, and limits.

The state of the loop stores masks as integers, and all of its floats are as wide as the loop.
Otherwise Dr.Jit could not differentiate the loop in reverse.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

import drjit as dr
import mitsuba as mi

from ..signals.polarization import unit_throughput
from .path_kinds import Kind, Lobes

H = TypeVar("H")  # Type of the history that an endpoint keeps of a path


def _mask(flag: str, doc: str) -> property:
    """Return a property of `Path` that reads and sets a mask.

    The field `flag` stores the mask as an integer, 1 in lanes where the mask is true and otherwise
    0.

    Args:
        flag: Name of the field.
        doc: Docstring of the property.
    """

    def read(path: Path) -> mi.Bool:
        return getattr(path, flag) != 0

    def write(path: Path, mask: mi.Bool) -> None:
        setattr(path, flag, dr.select(mask, mi.UInt32(1), 0))

    return property(read, write, doc=doc)


@dataclass
class Path(Generic[H]):
    """A path up to its last vertex: the state of the loop. `walk` has a table of the fields."""

    # Ray to the next vertex
    ray: mi.Ray3f

    # Number of vertices so far
    depth: mi.UInt32

    # Path throughput. In polarized variants, a Mueller matrix, see `multiply_throughput`
    β: mi.Spectrum

    # Index of refraction around the ray. For paths from lights, relative to the index around the
    # light
    η: mi.Float

    # Optical path length up to the last vertex [m]
    opl: mi.Float

    # Last vertex. Before the first vertex, the point where path lengths start
    prev: mi.Interaction3f

    # Solid-angle density of the ray's direction [1/sr]
    pdf: mi.Float

    # Data of earlier vertices for the endpoint's MIS weights, None if the weights need no such data
    history: H

    # Distance to the target of a guided ray [m]. The density of the ray's direction depends on this
    # distance, see `nlos.light.guided`. None without guiding
    guide: mi.Float | None

    # Current medium, null in vacuum. None in scenes without media
    medium: mi.MediumPtr | None

    # Number of contributions dropped because they were not finite
    not_finite: mi.UInt32

    # Masks as integers 0 or 1, see the properties `active`, `valid_ray` and `specular`
    active_flag: mi.UInt32
    valid_ray_flag: mi.UInt32
    specular_flag: mi.UInt32

    # Rate of change of `opl` [m/s], None if rates are not computed
    rate: mi.Float | None = None

    # Velocity of the last vertex [m/s], None if rates are not computed
    velocity: mi.Vector3f | None = None

    # Distance from the last vertex to the start of `ray` [m]: not 0 if the ray has passed an
    # emitter on an index-matched boundary. None if rays do not stop at such emitters
    passed: mi.Float | None = None

    # Lobes that have scattered the path, None if the path need not know its kind
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
        """Create a path without vertices.

        Args:
            ray: First ray.
            origin: Point where path lengths start, e.g. on the lens. The default is the ray's
                origin.
            active: Active lanes.
            history: Result of `HistoryUpdates.start`.
            guide: Result of `Scattering.guide`.
            medium: Current medium, see `Space.medium_at` and `Space.medium_at_sensor`.
            frame: Mueller matrix that rotates the Stokes frame of the ray to the frame of the
                sensor.
            η: Index of refraction around the ray.
            velocity: Velocity of the origin [m/s], None if rates are not computed.
            stops: Whether rays stop at emitters on index-matched boundaries, to add their light.
            records_lobes: Whether to record lobes, so that the path knows its kind.
        """
        # Constants as wide as the loop
        zero = dr.zeros(mi.Float, dr.width(ray))
        zero_int = dr.zeros(mi.UInt32, dr.width(ray))

        # Widen all fields of the ray
        ray = mi.Ray3f(ray)
        ray.o = ray.o + zero
        ray.d = ray.d + zero
        ray.time = ray.time + zero
        ray.maxt = ray.maxt + zero

        # Lengths start here
        prev = dr.zeros(mi.Interaction3f, dr.width(ray))
        prev.p = mi.Point3f(ray.o if origin is None else origin) + zero
        return cls(
            ray=ray,
            depth=mi.UInt32(zero_int),
            β=_widened(unit_throughput() if frame is None else frame, zero),
            η=η + zero,
            opl=mi.Float(zero),
            prev=prev,
            pdf=1 + zero,
            history=history,
            guide=guide,
            medium=medium,
            not_finite=mi.UInt32(zero_int),
            active_flag=dr.select(mi.Bool(active), mi.UInt32(1), zero_int),
            valid_ray_flag=mi.UInt32(zero_int),
            specular_flag=1 + zero_int,
            rate=None if velocity is None else mi.Float(zero),
            velocity=None if velocity is None else velocity + zero,
            passed=mi.Float(zero) if stops else None,
            lobes=Lobes.none(zero_int) if records_lobes else None,
        )

    active = _mask("active_flag", "Lanes in which the path continues.")

    # With `hide_emitters`, null interactions do not count, as in Mitsuba
    valid_ray = _mask("valid_ray_flag", "Lanes in which the path has met a surface.")

    # Next-event estimation does not compete with such a ray
    specular = _mask("specular_flag", "Lanes with a ray from a delta lobe or from the sensor.")


def _widened(throughput: mi.Spectrum, zero: mi.Float) -> mi.Spectrum:
    """Broadcast a throughput to the width of the paths."""
    if not mi.is_polarized:
        return throughput + zero
    return mi.Spectrum(*[throughput[i, j] + zero for i in range(4) for j in range(4)])


@dataclass
class MediumPoint:
    """Scattering point in a medium: the field `in_medium` of a vertex."""

    mei: mi.MediumInteraction3f  # Medium interaction
    here: mi.Bool  # Lanes with a scattering point. In other lanes, the vertex is on a surface

    @property
    def medium(self) -> mi.MediumPtr:
        """The medium that scatters, null on surfaces."""
        return dr.select(self.here, self.mei.medium, dr.zeros(mi.MediumPtr))


@dataclass
class Vertex:
    """A vertex of a path: the point where a ray ends."""

    # Surface interaction. Scattering points in media have neither shape nor normal
    si: mi.SurfaceInteraction3f

    # Distance from the last vertex, from point to point [m]
    length: mi.Float

    # Lanes in which the ray has reached a surface or a scattering point
    valid: mi.Bool

    # Scattering points in media, None in scenes without media
    in_medium: MediumPoint | None = None

    # Lanes in which the ray has stopped at an emitter on an index-matched boundary. The path adds
    # the emission and follows the same ray. None if rays do not stop at such emitters
    passes: mi.Bool | None = None

    @property
    def medium_point(self) -> MediumPoint:
        """The scattering points, in scenes with media."""
        assert self.in_medium is not None
        return self.in_medium

    def cosine(self, d: mi.Vector3f) -> mi.Float:
        """Return the unsigned cosine between a direction and the geometric normal, 1 in a medium.

        Args:
            d: Unit vectors in world space.
        """
        cos = dr.abs(dr.dot(self.si.n, d))
        return cos if self.in_medium is None else dr.select(self.in_medium.here, 1, cos)


@dataclass
class Hit:
    """Emission at the end of a ray."""

    # Emitted radiance towards the last vertex
    radiance: mi.UnpolarizedSpectrum

    # Solid-angle density of next-event estimation for the same direction [1/sr], for `mis_weight`
    pdf: mi.Float

    # Length of the ray's segment [m], also in lanes without emission
    length: mi.Float

    # Lanes in which the emission counts
    active: mi.Bool

    # MIS weight against the other techniques that find the same light
    mis_weight: mi.Float


@dataclass
class Transmittance:
    """Fraction of light that arrives at the end of a connection."""

    # Transmittance, 0 if a surface blocks the connection
    value: mi.Spectrum

    # Medium at the end of the connection, None in scenes without media
    medium: mi.MediumPtr | None = None

    # Mueller matrix at the end of the connection, None for the matrix of the connection
    frame: mi.Spectrum | None = None


@dataclass
class Connection:
    """A sample of next-event estimation, before its visibility is known.

    Endpoints may return a subclass with more fields for their MIS weights.
    """

    # Point where the connection ends [m]
    point: mi.Point3f

    # Unit vector from the vertex to `point`, in world space
    direction: mi.Vector3f

    # Radiance over density
    weight: mi.Spectrum

    # Geometric length [m]. Longer than the distance to `point` if the light starts behind `point`
    length: mi.Float

    # Lanes with a connection
    active: mi.Bool

    # Solid-angle density of `direction` [1/sr]
    pdf: mi.Float = field(default_factory=lambda: mi.Float(1))

    # Lanes with an emitter that rays cannot hit (point light, laser)
    delta: mi.Bool = field(default_factory=lambda: mi.Bool(True))

    # Lanes that need no shadow ray
    unoccluded: mi.Bool = field(default_factory=lambda: mi.Bool(False))

    # Position on the film [pixels] if the connection ends on the sensor, otherwise None
    position: mi.Point2f | None = None

    # Mueller matrix at the end of the connection, None for the identity
    frame: mi.Spectrum | None = None

    # Length over which media attenuate [m], None for the distance to `point`
    medium_length: mi.Float | None = None

    # Emitter where the connection ends, None for the sensor
    emitter: mi.EmitterPtr | None = None

    # Rate of change of `length` [m/s], None for the rate given by the velocities of both ends
    rate: mi.Float | None = None

    @classmethod
    def to_point(
        cls,
        point: mi.Point3f,
        direction: mi.Vector3f,
        length: mi.Float,
        active: mi.Bool,
        medium_length: mi.Float | None = None,
    ) -> Connection:
        """Create a connection with radiance 1, which is used for its transmittance only.

        Args:
            point: Point where the connection ends [m].
            direction: Unit vector to this point, in world space.
            length: Geometric length [m].
            active: Active lanes.
            medium_length: Length over which media attenuate [m], None for the distance to `point`.
        """
        return cls(
            point=point,
            direction=direction,
            weight=mi.UnpolarizedSpectrum(1),
            length=length,
            active=mi.Bool(active),
            medium_length=medium_length,
        )


@dataclass
class BSDFEval:
    """BSDF or phase function, evaluated for one direction."""

    # BSDF times cosine, or phase function [1/sr]
    f: mi.Spectrum

    # Solid-angle density of this direction in `Scattering.sample` [1/sr]
    pdf: mi.Float

    # Index of refraction on the side of this direction, relative to the side of the path
    η: mi.Float

    # Solid-angle density of the reverse path [1/sr]: from this direction to the direction where
    # the path came from. None unless the scattering is `both_ways`
    pdf_reverse: mi.Float | None = None


@dataclass
class BSDFSample:
    """Sampled direction in which a path continues."""

    # Next ray
    ray: mi.Ray3f

    # BSDF times cosine over the density of the ray's direction
    weight: mi.Spectrum

    # Solid-angle density of the ray's direction [1/sr]
    pdf: mi.Float

    # Index of refraction around the next ray, relative to the index around the last ray
    η: mi.Float

    # Lanes that sampled a delta lobe
    specular: mi.Bool

    # New value of `Path.guide`
    guide: mi.Float | None = None

    # Solid-angle density of the reverse path [1/sr], see `BSDFEval.pdf_reverse`
    pdf_reverse: mi.Float | None = None

    # Lanes that sampled a null lobe: the path passes straight through the surface
    null: mi.Bool = field(default_factory=lambda: mi.Bool(False))


class Limits:
    """Limits that decide which contributions of a path count.

    This class is not a dataclass, so that the loop does not carry its fields as state.

    Args:
        max_depth: Longest path in segments, including the camera's segment: 1 shows emitters only,
            2 adds direct light, -1 means no limit.
        rr_depth: Number of vertices before Russian roulette may end a path.
        max_opl: Longest optical path length that counts [m], None for no limit.
        camera_unwarp: Whether to leave out the length from the sensor to the first vertex.
        ignore_null: Whether null interactions change neither depth nor MIS weights, as in Mitsuba's
            `volpath`. Space and endpoint must pass through null surfaces (`transient_volpath`).
        min_depth: Shortest path in segments that counts: 3 leaves out emitters and direct light.
        left_out: Kinds of paths that another technique renders, see `paths.path_kinds`.
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
        self.max_depth = max_depth
        self.rr_depth = rr_depth
        self.max_opl = max_opl
        self.camera_unwarp = camera_unwarp
        self.left_out = left_out
        self.ignore_null = ignore_null

    def long_enough(self, segments: mi.UInt32) -> mi.Bool | bool:
        """Return lanes in which paths with this number of segments reach `min_depth`."""
        return segments >= self.min_depth if self.min_depth > 0 else True

    @property
    def bounded(self) -> bool:
        """Whether `max_depth` limits the paths."""
        return self.max_depth >= 0

    @property
    def iterations(self) -> int:
        """Largest number of rays of a path, -1 without a limit."""
        return self.max_depth if self.bounded and not self.ignore_null else -1
