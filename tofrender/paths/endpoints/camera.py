# pyright: reportArgumentType=false, reportCallIssue=false
"""The camera's lens, and the vertices that are kept on the way to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi

from ...signals.polarisation import sensor_frame
from ..camera import behind_emitters
from ..emission import Emission, Emitted
from ..lens import Lens
from ..phases import Scattered
from ..protocols import Scattering
from ..records import Bounce, Connection, Path, Turn, Vertex
from ..sharing import Rivals, Sharing
from ..window import Arrival
from .unseen import Unseen


@cache
def kept_type(variant: str | None, in_media: bool) -> Any:
    """The record of a kept vertex in a variant; memory of a lane asks for the very types.

    In media it has one field more.
    """

    @dataclass
    class Kept:
        """A vertex of a path from a light.

        Attributes:
            si: The surface point.
            depth: Number of surface vertices before it.
            β: Throughput, the light's own weight apart.
            η: Index of refraction that the path arrived in, relative to that at the light.
            opl: Optical length from the light [m].
            a, b: Rivals of the path when it arrived.
        """

        si: mi.SurfaceInteraction3f
        depth: mi.UInt32
        β: mi.Spectrum
        η: mi.Float
        opl: mi.Float
        a: mi.Float
        b: mi.Float

        def vertex(self, length: mi.Float, active: mi.Bool) -> Vertex:
            """It, as one that a ray has led to."""
            return Vertex(self.si, length, active)

    @dataclass
    class KeptInMedia(Kept):
        """The same where media scatter.

        Attributes:
            medium: What scatters there, null on surfaces.
        """

        medium: mi.MediumPtr

        def vertex(self, length: mi.Float, active: mi.Bool) -> Vertex:
            """It, as one that a ray has led to."""
            medium = dr.select(active, self.medium, dr.zeros(mi.MediumPtr))
            return Vertex(self.si, length, active, Scattered.again(self.si, medium))

    return KeptInMedia if in_media else Kept


@dataclass
class LightPath:
    """What a path from a light remembers.

    Attributes:
        rivals: Of the path so far.
        count: Vertices that are kept.
        vertices: These, in memory of each lane; None if nobody connects to them.
    """

    rivals: Rivals
    count: mi.UInt32
    vertices: Any


class Camera(Unseen):
    """The lens, for paths that come from the lights: all strategies with t = 1.

    A connection carries the camera's importance over the density of the lens point, whose cosine,
    and that of the area that the lens covers, have cancelled:

        1 / (A cos³θ d²)

    Args:
        scene: The scene.
        lens: The lens.
        emission: How light starts.
        emitted: What the paths started with, for their lanes.
        scattering: How they go on.
        sharing: Which strategies count.
        kept: Number of vertices that are kept for paths from the camera.
        connects: Whether they connect to the lens at all.
        unwarp: Whether the segment to the lens does not count in lengths.
        hide_emitters: Whether the lens sees through area lights.
        in_media: Whether vertices may be points of media.
    """

    importance = True
    finds_all = False

    def __init__(
        self,
        scene: mi.Scene,
        lens: Lens,
        emission: Emission,
        emitted: Emitted,
        scattering: Scattering,
        sharing: Sharing,
        kept: int = 0,
        connects: bool = True,
        unwarp: bool = False,
        hide_emitters: bool = False,
        in_media: bool = False,
    ) -> None:
        super().__init__(scene, hide_emitters)
        self.connects, self.in_media = connects, in_media
        self.lens, self.emission, self.emitted = lens, emission, emitted
        self.scattering, self.sharing, self.kept = scattering, sharing, kept
        self.unwarp = unwarp

    def memory(self) -> LightPath:
        """Of a path without vertices."""
        vertices = None
        if self.kept:
            vertices = dr.alloc_local(kept_type(mi.variant(), self.in_media), self.kept)
        return LightPath(self.sharing.none(), mi.UInt32(0), vertices)

    def remember(self, path: Path, vertex: Vertex, active: mi.Bool) -> LightPath:
        """With a vertex: the rivals there, and the vertex if it is kept."""
        memory = path.memory
        if not self.sharing.exponent and not self.kept:
            return memory
        rivals, count = self._arrive(path, vertex), memory.count
        if self.kept:
            keep = active & self.scattering.smooth(vertex) & (count < self.kept)
            here = [vertex.si, path.depth, path.β, path.η, path.opl, rivals.a, rivals.b]
            if self.in_media:
                here.append(vertex.inside.medium)
            place = dr.select(keep, count, 0)
            memory.vertices.write(kept_type(mi.variant(), self.in_media)(*here), place, keep)
            count = count + dr.select(keep, mi.UInt32(1), 0)
        return LightPath(rivals, count, memory.vertices)

    def _arrive(self, path: Path, vertex: Vertex) -> Rivals:
        """The rivals at a vertex; the first one's are about where the light started."""
        start, si, power = self.emitted, vertex.si, self.sharing.power
        cos = vertex.cosine(path.ray.d)
        later = self.sharing.arrive(path.memory.rivals, path, vertex)
        first = path.depth == 0
        ds: Any = dr.zeros(mi.DirectionSample3f, dr.width(path.depth))
        ds.p, ds.n, ds.uv, ds.emitter = start.origin, start.normal, start.uv, start.emitter
        ds.d, ds.dist = -start.ray.d, vertex.length
        pdf = self.scene.pdf_emitter_direction(si, ds, first & ~start.delta)
        ratio = self.emission.ratio(start.emitter, ds, pdf, vertex.length)
        across = dr.select(cos > 0, dr.rcp(cos), 0)
        never = start.delta | (not self.sharing.hits)
        hit = dr.select(never, 0, power(start.cos * across / start.density))
        return Rivals(
            dr.select(first, power(ratio * across), later.a), dr.select(first, hit, later.b)
        )

    def leave(self, path: Path, vertex: Vertex, bounce: Bounce) -> LightPath:
        """With the direction that the path goes on in."""
        memory = path.memory
        if not self.sharing.exponent:
            return memory
        rivals = self.sharing.leave(memory.rivals, vertex, bounce)
        return LightPath(rivals, memory.count, memory.vertices)

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """A point on the lens."""
        si = vertex.si
        arrival = self._arrival(vertex, self.lens.sample(sampler))
        active = active & arrival.seen
        end = arrival.near
        if self.hide_emitters:
            active &= ~si.shape.is_emitter()
            end = behind_emitters(self.scene, mi.Ray3f(end, -arrival.direction)).o
        light = self.emitted.weight * (arrival.density / dr.square(arrival.distance))
        return Connection(
            point=end,
            direction=arrival.direction,
            weight=dr.select(active, light, 0),
            pdf=arrival.density,
            delta=mi.Bool(True),
            length=mi.Float(0) if self.unwarp else arrival.distance,
            active=active,
            clear=mi.Bool(False),
            position=arrival.position,
            rival=arrival,
            frame=sensor_frame(self.lens.sensor, mi.Ray3f(si.p, -arrival.direction)),
            reach=arrival.distance,
        )

    def _arrival(self, vertex: Vertex, lens: mi.Point3f) -> Arrival:
        """Where a vertex is connected to the lens: no clip hides a point of a medium."""
        p = vertex.si.p
        if vertex.inside is None:
            return self.lens.arrive(p, lens)
        arrival = self.lens.arrive(p, lens, vertex.inside.here)
        before = dr.norm(arrival.near - lens) > arrival.distance
        arrival.near = dr.select(before, lens, arrival.near)
        return arrival

    def share_of_link(self, path: Path, vertex: Vertex, link: Connection, turn: Turn) -> mi.Float:
        """Share of the strategy (s, 1)."""
        x, arrival = mi.Float(0), link.rival
        if self.sharing.exponent:
            cos = vertex.cosine(link.direction)
            density = arrival.density * cos / dr.square(arrival.distance)
            x = self.sharing.power(density) * self.sharing.sum(path.memory.rivals, turn.back)
        return self.sharing.share(x, path.depth + 2, 1)
