"""Records of the path loop: paths, vertices, connections, BSDF samples, and limits.

Masks that a loop carries are stored as integers, floats are all as wide as the loop: Dr.Jit could
not differentiate the loop in reverse otherwise.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import drjit as dr
import mitsuba as mi

from ..signals.polarisation import multiply_throughput, unit_throughput

H = TypeVar("H")
"""History that an endpoint keeps of a path."""


@dataclass
class Path(Generic[H]):
    """A path up to its last vertex: the state of the loop.

    Attributes:
        ray: The ray to the next vertex.
        depth: Number of vertices so far.
        β: Path throughput, an `mi.UnpolarizedSpectrum`, in polarised variants a Mueller matrix
            (`mi.Spectrum`); `extend` multiplies it.
        η: Index of refraction around the ray; for paths from lights, relative to that around the
            light.
        opl: Optical path length up to the last vertex [m].
        prev: The last vertex; at first the point that lengths are measured from.
        pdf: Solid-angle density of the ray's direction [1/sr].
        history: What the endpoint's MIS weights need of earlier vertices, None if nothing.
        guide: Distance to the target that guiding has sent the ray to, see `guided`; else None.
        medium: The current medium, null in vacuum; None in scenes without media.
        not_finite: Number of contributions dropped because they were not finite.
        active_flag, valid_ray_flag, specular_flag: Masks as integers, see the properties.
    """

    ray: mi.Ray3f
    depth: mi.UInt32
    β: Any
    η: mi.Float
    opl: mi.Float
    prev: mi.Interaction3f
    pdf: mi.Float
    history: H
    guide: mi.Float | None
    medium: mi.MediumPtr | None
    not_finite: mi.UInt32
    active_flag: mi.UInt32
    valid_ray_flag: mi.UInt32
    specular_flag: mi.UInt32

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
    ) -> Path[H]:
        """Create a path that has no vertex yet.

        Args:
            ray: The first ray.
            origin: Point that lengths are measured from, e.g. on the lens; by default the ray's
                origin.
            active: Lanes that have a path.
            history: As from the endpoint's `history.start()`.
            guide: As from the scattering's `guide()`.
            medium: As from the space's `medium_at_sensor(ray)` or `medium_at(ray)`.
            frame: Mueller matrix into the sensor's frame, None for none.
            η: Index of refraction around the ray, if it starts on the sensor.
        """
        lanes = dr.width(ray)
        zero = dr.zeros(mi.Float, lanes)
        ray = mi.Ray3f(ray)
        ray.o, ray.d = ray.o + zero, ray.d + zero
        ray.time, ray.maxt = ray.time + zero, ray.maxt + zero
        prev = dr.zeros(mi.Interaction3f, lanes)
        prev.p = mi.Point3f(ray.o if origin is None else origin) + zero
        return cls(
            ray=ray,
            depth=dr.zeros(mi.UInt32, lanes),
            β=_widened(unit_throughput() if frame is None else frame, zero),
            η=η + zero,
            opl=mi.Float(zero),
            prev=prev,
            pdf=1 + zero,
            history=history,
            guide=guide,
            medium=medium,
            not_finite=dr.zeros(mi.UInt32, lanes),
            active_flag=dr.select(mi.Bool(active), mi.UInt32(1), dr.zeros(mi.UInt32, lanes)),
            valid_ray_flag=dr.zeros(mi.UInt32, lanes),
            specular_flag=1 + dr.zeros(mi.UInt32, lanes),
        )

    @property
    def active(self) -> mi.Bool:
        """Lanes whose path goes on."""
        return self.active_flag != 0

    @active.setter
    def active(self, mask: mi.Bool) -> None:
        self.active_flag = dr.select(mask, mi.UInt32(1), 0)

    @property
    def valid_ray(self) -> mi.Bool:
        """Lanes whose first ray met a surface."""
        return self.valid_ray_flag != 0

    @valid_ray.setter
    def valid_ray(self, mask: mi.Bool) -> None:
        self.valid_ray_flag = dr.select(mask, mi.UInt32(1), 0)

    @property
    def specular(self) -> mi.Bool:
        """Lanes whose ray comes from a delta lobe or the sensor: no connection competes with it."""
        return self.specular_flag != 0

    @specular.setter
    def specular(self, mask: mi.Bool) -> None:
        self.specular_flag = dr.select(mask, mi.UInt32(1), 0)


def extend(throughput: Any, factor: Any, importance: bool = False) -> Any:
    """Multiply a path throughput by a factor (a BSDF value, a transmittance).

    A path from the sensor puts new factors on the right, one from a light (`importance`) on the
    left, which matters where they are Mueller matrices.
    """
    return multiply_throughput(throughput, factor, importance)


def _widened(throughput: Any, zero: mi.Float) -> Any:
    """Broadcast a throughput to the width of the paths."""
    if not mi.is_polarized:
        return throughput + zero
    return mi.Spectrum(*[throughput[i, j] + zero for i in range(4) for j in range(4)])


@dataclass
class MediumPoint:
    """A point where a medium scatters: the `in_medium` of a vertex.

    Attributes:
        mei: The medium interaction.
        here: Lanes whose vertex is such a point; the others are on surfaces.
    """

    mei: mi.MediumInteraction3f
    here: mi.Bool

    @property
    def medium(self) -> mi.MediumPtr:
        """The medium that scatters, null on surfaces."""
        return dr.select(self.here, self.mei.medium, dr.zeros(mi.MediumPtr))


@dataclass
class Vertex:
    """A vertex of a path: where a ray ends.

    Attributes:
        si: The surface interaction; a point in a medium has no shape and no normal there.
        length: Distance from the last vertex, point to point [m].
        valid: Lanes that met a surface, or a point that scatters.
        in_medium: The medium interaction, None in scenes without media.
    """

    si: mi.SurfaceInteraction3f
    length: mi.Float
    valid: mi.Bool
    in_medium: MediumPoint | None = None

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
    """Emission that a ray runs into.

    Attributes:
        radiance: Emitted radiance towards the last vertex.
        pdf: Solid-angle density of next-event estimation for the same direction [1/sr].
        length: Distance to where it was emitted [m].
        active: Lanes in which it counts.
        mis_weight: MIS weight against the other techniques that find the same light.
    """

    radiance: Any
    pdf: mi.Float
    length: mi.Float
    active: mi.Bool
    mis_weight: mi.Float


@dataclass
class Connection:
    """A sample of next-event estimation, before visibility is known.

    Endpoints whose MIS weights need more than this return a subclass.

    Attributes:
        point: Where the connection ends [m].
        direction: Unit vector from the vertex towards it, world space.
        weight: Radiance over density.
        pdf: Solid-angle density of `direction` [1/sr].
        delta: Lanes whose light no ray can run into (point lights, lasers).
        length: Geometric length of the connection, which may start beyond `point` [m].
        active: Lanes in which there is a connection.
        unoccluded: Lanes that need no shadow ray.
        position: Position on the film where it arrives, if it ends on the sensor [pixels].
        frame: Mueller matrix at the connection's end, None for none.
        medium_length: Length over which media attenuate, if not the distance to `point` [m].
    """

    point: mi.Point3f
    direction: mi.Vector3f
    weight: Any
    pdf: mi.Float
    delta: mi.Bool
    length: mi.Float
    active: mi.Bool
    unoccluded: mi.Bool
    position: mi.Point2f | None = None
    frame: mi.Spectrum | None = None
    medium_length: mi.Float | None = None

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
        return cls(
            point=point,
            direction=direction,
            weight=mi.UnpolarizedSpectrum(1),
            pdf=mi.Float(1),
            delta=mi.Bool(True),
            length=length,
            active=mi.Bool(active),
            unoccluded=mi.Bool(False),
            medium_length=medium_length,
        )

    def masked(self, mask: mi.Bool) -> Connection:
        """Copy the connection, active only where `mask` is set."""
        other = copy(self)
        other.active = self.active & mask
        return other


@dataclass
class BSDFEval:
    """BSDF or phase function evaluated for one direction.

    Attributes:
        f: BSDF times cosine, or phase function.
        pdf: Solid-angle density with which the path would have gone there [1/sr].
        η: Index of refraction on that side, relative to the path's side.
        pdf_reverse: Density of the opposite way, from that direction to where the path came from
            [1/sr]; None unless the scattering was asked for it.
    """

    f: Any
    pdf: mi.Float
    η: mi.Float
    pdf_reverse: mi.Float | None = None


@dataclass
class BSDFSample:
    """Sampled direction in which a path goes on.

    Attributes:
        ray: The next ray.
        weight: BSDF times cosine over the density of the ray's direction.
        pdf: That density [1/sr].
        η: Index of refraction around the next ray, relative to that before.
        specular: Lanes that sampled a delta lobe.
        guide: New value of `Path.guide`.
        pdf_reverse: As in `BSDFEval`.
        null: Lanes that sampled a null lobe: the path goes straight through the surface.
    """

    ray: mi.Ray3f
    weight: Any
    pdf: mi.Float
    η: mi.Float
    specular: mi.Bool
    guide: mi.Float | None = None
    pdf_reverse: mi.Float | None = None
    null: mi.Bool | bool = False


class Limits:
    """Which contributions of a path count. No dataclass, so that the loop does not carry it.

    Args:
        max_depth: Longest path in segments, camera's included: 1 shows emitters only, 2 adds
            direct light; -1 means no limit.
        rr_depth: Number of vertices from which on Russian roulette may end a path.
        max_opl: Optical path length beyond which no contribution counts [m], None if all do.
        camera_unwarp: Leave out the segment from the sensor to the first vertex.
        skip_first_hit: Drop emission at the first surface, which is sampled apart.
        ignore_null: Null interactions are no vertices, as in Mitsuba's `volpath`: they change
            neither depth nor MIS weights. Space and endpoint must be made for it.
    """

    def __init__(
        self,
        max_depth: int,
        rr_depth: int = 5,
        max_opl: Any = None,
        camera_unwarp: bool = False,
        skip_first_hit: bool = False,
        ignore_null: bool = False,
    ) -> None:
        self.max_depth, self.rr_depth, self.max_opl = max_depth, rr_depth, max_opl
        self.camera_unwarp, self.skip_first_hit = camera_unwarp, skip_first_hit
        self.ignore_null = ignore_null

    def without_first_hit(self) -> Limits:
        """Copy the limits, with emission at the first surface dropped."""
        other = copy(self)
        other.skip_first_hit = True
        return other

    @property
    def bounded(self) -> bool:
        """Whether `max_depth` limits paths."""
        return self.max_depth >= 0

    @property
    def iterations(self) -> int:
        """Bound on the rays of a path, -1 if there is none."""
        return self.max_depth if self.bounded and not self.ignore_null else -1
